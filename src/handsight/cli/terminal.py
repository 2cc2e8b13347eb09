"""What a person at the terminal sees, and the files a command reads and writes."""

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from handsight.errors import InvalidFile

if TYPE_CHECKING:
    from rich.console import Console


@cache
def _messages() -> "Console":
    from rich.console import Console

    return Console(stderr=True, soft_wrap=True, highlight=False)


def say(message: str) -> None:
    """Prints a line on stderr, as it stands."""
    _messages().print(message, markup=False)


@cache
def warn(message: str) -> None:
    """Prints a warning in one line, the first time only: workers and we may have the same to say."""
    say(f"handsight: {message}")


def one_line_warning(message: Any, *_: Any, **__: Any) -> None:
    """A warning in one line, for `warnings.showwarning`."""
    warn(str(message))


def opened_input(name: str) -> IO[bytes]:
    """The problems; stdin as a file of its own, so that no thread holds the interpreter's when it ends."""
    try:
        return open(sys.stdin.fileno(), "rb", closefd=False) if name == "-" else open(name, "rb")
    except OSError as error:
        raise InvalidFile(f"{name}: {error.strerror}") from None


@contextlib.contextmanager
def opened_output(output: Path | None, source: str) -> Iterator[IO[str]]:
    """Where answers go: a file, or stdout; never the file they answer."""
    if output is None or str(output) == "-":
        yield sys.stdout
        return
    if source != "-" and output.exists() and output.samefile(source):
        raise InvalidFile(f"{output}: the answers would overwrite the problems")
    try:
        handle = open(output, "w", encoding="utf-8")  # noqa: SIM115
    except OSError as error:
        raise InvalidFile(f"{output}: {error.strerror}") from None
    with handle:
        yield handle


@contextlib.contextmanager
def progress(name: str, *, show: bool) -> Iterator[Callable[[int, int], None]]:
    """A call that moves a bar on the terminal by answers and bytes read; silent where nobody looks."""
    if not show or not _messages().is_terminal:
        yield lambda answers, size: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    said = "{task.fields[count]} answers, {task.fields[rate]:.0f}/s"
    columns = (TextColumn("correcting"), BarColumn(), TextColumn(said), TimeElapsedColumn())
    began = time.monotonic()
    with Progress(*columns, console=_messages(), transient=True) as progress:
        # Pipes have no size.
        total = (None if name == "-" else os.path.getsize(name)) or None
        task = progress.add_task("", total=total, count=0, rate=0.0)

        def advance(answers: int, size: int) -> None:
            count = progress.tasks[0].fields["count"] + answers
            rate = count / (time.monotonic() - began)
            progress.update(task, advance=size, count=count, rate=rate)

        yield advance


@contextlib.contextmanager
def bar(what: str) -> Iterator[Callable[[float], None]]:
    """A call that moves a bar on the terminal to a share of the work, 0 to 1; silent where nobody looks."""
    if not _messages().is_terminal:
        yield lambda share: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    with Progress(
        TextColumn(what), BarColumn(), TimeRemainingColumn(), console=_messages(), transient=True
    ) as progress:
        task = progress.add_task("", total=1.0)
        yield lambda share: progress.update(task, completed=share)


@contextlib.contextmanager
def live_rows(title: str) -> Iterator[Callable[[list[tuple[str, str]]], None]]:
    """A call that replaces a small table of names and values on the terminal; silent where nobody looks."""
    if not _messages().is_terminal:
        yield lambda rows: None
        return
    from rich.live import Live
    from rich.table import Table

    with Live(console=_messages(), auto_refresh=False, transient=True) as live:

        def show(rows: list[tuple[str, str]]) -> None:
            """These rows in place of the last ones."""
            table = Table(title=title, title_justify="left", show_header=False, box=None)
            for row in rows:
                table.add_row(*row)
            live.update(table, refresh=True)

        yield show
