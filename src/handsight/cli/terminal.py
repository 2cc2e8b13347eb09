"""Output for a person at a terminal (messages, progress, tables), and exit codes."""

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

from handsight.errors import HandsightError, InvalidInput, NotFound, NotWritten, printable
from handsight.files import STREAMS, write_errors

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

FAILED, WRONG_INPUT, CANNOT_WRITE, INTERRUPTED, NOBODY_READS = 1, 2, 74, 130, 141
"""Exit codes; the last two are those that a shell reports for SIGINT and SIGPIPE."""


@cache
def _messages() -> "Console":
    from rich.console import Console

    return Console(stderr=True, soft_wrap=True, highlight=False)


def say(*messages: str) -> None:
    """Prints each message as one line on stderr, with control characters escaped."""
    for line in map(printable, messages):
        try:
            if sys.stderr.isatty():  # above a progress bar, if there is one
                _messages().print(line, markup=False)
            else:
                print(line, file=sys.stderr, flush=True)
        except OSError:  # stderr is closed or full; there is no other place for a message
            discard(sys.stderr)


@cache
def warn(message: str) -> None:
    """Prints a warning on one line; the same warning again, such as from another worker, is not repeated."""
    say(f"handsight: {message}")


def reopen_closed_streams() -> None:
    """Opens the standard streams that the calling process has closed, so that no other file gets their numbers.

    Reading from or writing to such a stream is then an ordinary error.
    """
    for number, name in enumerate(STREAMS):
        if getattr(sys, name) is None:
            # The lowest free number is this one. Stdin is opened unreadable, stdout unwritable.
            os.open(os.devnull, (os.O_WRONLY, os.O_RDONLY, os.O_RDWR)[number])
            stream = open(number, "w" if number else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def discard(stream: IO[str]) -> None:
    """Discards the content of a stream's buffer, which would otherwise cause an error when Python exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def announce_compiling() -> None:
    """Makes a terminal show which kernel is being compiled, a line that goes again; all take minutes."""
    if sys.stderr.isatty():
        from handsight._kernels.runtime.kernel_cache import on_compile

        text = "compiling handsight's kernels, once on this machine: "
        on_compile[:] = [lambda name: os.write(2, f"\r\x1b[2K{name and text + name}".encode())]


def check_plots(plot: Path | None) -> None:
    """Raises MissingExtra where a picture is wanted without matplotlib, and InvalidInput for a format that it lacks."""
    if plot is not None:
        from handsight.viewer.correction_figures import new_figure

        known = new_figure().canvas.get_supported_filetypes()
        if plot.suffix[1:].lower() not in known:
            raise InvalidInput(f"--plot: expected a name that ends in .png, .pdf or .svg, got {plot.name}")


@contextlib.contextmanager
def bar(what: str, *, show: bool = True) -> Iterator[Callable[..., None]]:
    """Yields a function `(share, message="")` that moves a progress bar; without a terminal it does nothing.

    `share`: the share of the work that is done, 0 to 1; None: unknown. `message`: the progress in words.
    """
    if not show or not sys.stderr.isatty():
        yield lambda share, message="": None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.fields[message]}"), TimeRemainingColumn())
    with Progress(*columns, console=_messages(), transient=True) as progress:
        task = progress.add_task("", total=None, message="")
        yield lambda share, message="": progress.update(
            task, total=None if share is None else 1.0, completed=share, message=message
        )


@contextlib.contextmanager
def live_rows(title: str, rows: Callable[..., list[tuple[str, str]]]) -> Iterator[Callable[..., None]]:
    """Yields a function that shows the names and values that `rows` returns for its arguments.

    It refreshes them at most five times a second; without a terminal it does nothing.
    """
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.live import Live

    shown_at, refresh_seconds = -math.inf, 0.2
    with Live(console=_messages(), auto_refresh=False, transient=True) as live:

        def show(*now: Any) -> None:
            """Replaces the rows, unless that happened less than `refresh_seconds` ago."""
            nonlocal shown_at
            if time.monotonic() - shown_at >= refresh_seconds:
                shown_at = time.monotonic()
                style = {"title": title, "title_justify": "left", "show_header": False, "box": None}
                live.update(table(("", ""), rows(*now), texts=2, **style), refresh=True)

        yield show


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1, **style: Any) -> "Table":
    """Returns a table whose first `texts` columns are left-aligned, as texts, and whose others are right-aligned.

    `style`: keyword arguments of rich's `Table`.
    """
    from rich.table import Table

    built = Table(**style)
    for k, column in enumerate(columns):
        built.add_column(column, justify="left" if k < texts else "right", overflow="fold")
    for row in rows:
        built.add_row(*map(printable, row))
    return built


def plain_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int, **style: Any
) -> "Table":
    """Returns a `table` without borders, for output that a program may read."""
    return table(columns, rows, texts=texts, box=None, pad_edge=False, padding=(0, 2, 0, 0), **style)


def print_out(*parts: "str | Table", **options: Any) -> None:
    """Prints texts and tables on stdout literally: [mm] is not markup, and numbers are not coloured."""
    from rich.console import Console

    Console(markup=False, highlight=False).print(*parts, **options)


@contextlib.contextmanager
def output_stream(path: Path | None) -> Iterator[IO[str]]:
    """Yields a new text file, or stdout where the path is None or `-`; raises NotWritten.

    The file is `part_of(path)` while it grows. It gets its name at the end, whatever the reason, unless it could not be
    written: its last line may be cut.
    """
    if path is None or str(path) == "-":
        yield sys.stdout
        return
    growing, final, complete = part_of(path), Path(os.path.realpath(path)), True
    with write_errors(path):
        try:
            with open(growing, "w", encoding="utf-8") as file:
                yield file
        except (OSError, NotWritten):
            complete = False
            raise
        finally:
            if complete and growing != final:
                growing.replace(final)


def part_of(path: Path) -> Path:
    """Returns the name of a file while it grows: PATH.part; a pipe or a device has no other name."""
    real = Path(os.path.realpath(path))
    return real if real.exists() and not real.is_file() else real.with_name(f"{real.name}.part")


@dataclass(slots=True)
class End:
    """An `End` says how a part of a command ended: normally if the exit code is 0."""

    exit_code: int = 0
    error: Exception | None = None
    message: str = ""
    """The message about the error for the user; empty after Ctrl-C."""


@contextlib.contextmanager
def kept_going() -> Iterator[End]:
    """Yields an `End`, and ends the block, but not the command, at Ctrl-C or any error.

    So the command can still write its results. It prints the message of the `End`, and finally exits with its code.
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
        fault = f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"
        end.exit_code, end.error, end.message = FAILED, error, f"handsight: internal error: {fault}"


def exit_code(error: HandsightError) -> int:
    """Returns the exit code of a command that ends with an error."""
    if isinstance(error, NotFound):
        return FAILED
    return CANNOT_WRITE if isinstance(error, NotWritten) else WRONG_INPUT
