"""What a person at the terminal sees."""

import contextlib
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from handsight.errors import HandsightError, InvalidFile, NotWritten, printable
from handsight.files import STREAMS, write_errors

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

REFRESH = 0.2
"""Seconds between two updates of what is shown."""

FAILED, WRONG_INPUT, CANNOT_WRITE, INTERRUPTED, NOBODY_READS = 1, 2, 74, 130, 141
"""Exit codes; the last two as a shell gives them for SIGINT and SIGPIPE."""


@cache
def _messages() -> "Console":
    from rich.console import Console

    return Console(stderr=True, soft_wrap=True, highlight=False)


def say(message: str) -> None:
    """Prints a line on stderr, as it stands but for what the terminal would obey."""
    try:
        _messages().print(printable(message), markup=False)
    except OSError:  # there is nobody to tell
        _abandon(sys.stderr)


def hold_streams() -> None:
    """Has stdin, stdout and stderr be there: a file that is opened must not get the number of one that was closed.

    To read or to write one is then the error that it always was, said as any other; what is said is lost.
    """
    for number, name in enumerate(STREAMS):
        try:
            os.fstat(number)
        except OSError:
            # The lowest number that is free is this one; stdin cannot be read, nor stdout be written.
            os.open(os.devnull, (os.O_WRONLY, os.O_RDONLY, os.O_RDWR)[number])
            stream = open(number, "w" if number else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def flush_stdout() -> None:
    """Brings what was printed to where it goes: at exit nothing could be said. Raises InvalidFile; ends the command
    where nobody reads."""
    try:
        with write_errors("stdout"):
            sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read it has gone; there is nobody to tell.
        _abandon(sys.stdout)
        sys.exit(NOBODY_READS)
    except InvalidFile:
        _abandon(sys.stdout)
        raise


def _abandon(stream: IO[str]) -> None:
    """Has what a stream still holds go nowhere at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@cache
def warn(message: str) -> None:
    """Prints a warning in one line, the first time only: workers and we may have the same to say."""
    say(f"handsight: {message}")


def announce_compiling() -> None:
    """On a terminal, has it said when a kernel is about to be compiled, once: nothing else would be for long."""
    if not sys.stderr.isatty():
        return
    from handsight._kernels.runtime.kernel_cache import on_compile

    on_compile.append(lambda: say("compiling handsight's kernels, once on this machine ..."))


@contextlib.contextmanager
def bar(what: str, *, show: bool = True) -> Iterator[Callable[..., None]]:
    """A call `(share, said="")` that moves a bar on the terminal; silent where nobody looks.

    `share`: of the work, 0 to 1, or None where nobody knows; `message`: how far it is, in words.
    """
    if not show or not _messages().is_terminal:
        yield lambda share, message="": None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.fields[said]}"), TimeRemainingColumn())
    with Progress(*columns, console=_messages(), transient=True) as progress:
        task = progress.add_task("", total=None, message="")
        yield lambda share, message="": progress.update(
            task, total=None if share is None else 1.0, completed=share, message=message
        )


@contextlib.contextmanager
def live_rows(title: str, rows: Callable[..., list[tuple[str, str]]]) -> Iterator[Callable[..., None]]:
    """A call that shows `rows` of its arguments, names and values, on the terminal a few times a second.

    Silent where nobody looks.
    """
    if not _messages().is_terminal:
        yield lambda *_: None
        return
    from rich.live import Live
    from rich.table import Table

    last = -math.inf
    with Live(console=_messages(), auto_refresh=False, transient=True) as live:

        def show(*now: Any) -> None:
            """These rows in place of the last ones, unless those were shown a moment ago."""
            nonlocal last
            if time.monotonic() - last < REFRESH:
                return
            last = time.monotonic()
            shown = Table(title=title, title_justify="left", show_header=False, box=None)
            for row in rows(*now):
                shown.add_row(*row)
            live.update(shown, refresh=True)

        yield show


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1, **style: Any) -> "Table":
    """Returns rows under their names, numbers on the right; the first `texts` columns are none."""
    from rich.table import Table

    built = Table(**style)
    for k, column in enumerate(columns):
        built.add_column(column, justify="left" if k < texts else "right", overflow="fold")
    for row in rows:
        built.add_row(*row)
    return built


@dataclass(slots=True)
class End:
    """An `End` says how a part of a command ended: as it should, unless it has an exit code."""

    exit_code: int = 0
    error: Exception | None = None
    message: str = ""
    """What is to be said of the error."""


@contextlib.contextmanager
def kept_going() -> Iterator[End]:
    """Ctrl-C or an error, whatever it is, ends what is within, not the command: what was done by then is kept.

    The command is to say what the `End` says, and to exit with its code in the end.
    """
    end = End()
    try:
        yield end
    except KeyboardInterrupt:
        end.exit_code = INTERRUPTED
    except HandsightError as error:
        end.exit_code, end.error, end.message = exit_code(error), error, f"handsight: {error}"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}, line {place.lineno}"
        message = (
            f"handsight: ended early by what should not happen: {type(error).__name__} in {where}: {error}"
        )
        end.exit_code, end.error, end.message = FAILED, error, message


def exit_code(error: HandsightError) -> int:
    """Of a command that ends with it."""
    return CANNOT_WRITE if isinstance(error, NotWritten) else WRONG_INPUT


@contextlib.contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """What the system refuses within is an InvalidFile that says which file, and why."""
    try:
        yield
    except OSError as error:
        raise InvalidFile(f"{path}: {error.strerror or error}") from None


@contextlib.contextmanager
def writing(path: Path) -> Iterator[IO[str]]:
    """A new text file; closed at the end, of which an error within says more than one in closing."""
    with write_errors(path):
        file = open(path, "w", encoding="utf-8")  # noqa: SIM115
    try:
        yield file
    except BaseException:
        with contextlib.suppress(OSError):
            file.close()
        raise
    with write_errors(path):
        file.close()
