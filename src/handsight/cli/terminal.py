"""What a person at the terminal sees."""

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


INTERRUPTED, NOBODY_READS = 130, 141
"""Exit codes, as a shell gives them for SIGINT and SIGPIPE."""


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


def announce_compiling() -> None:
    """On a terminal, has it said when a kernel is about to be compiled, once: nothing else would be for long."""
    if not sys.stderr.isatty():
        return
    from handsight._kernels.compiled import on_compile

    on_compile.append(lambda: say("compiling handsight's kernels, once on this machine ..."))


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
