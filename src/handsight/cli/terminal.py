"""Output for a person at a terminal (messages, progress, tables), and exit codes."""

import contextlib
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from handsight.errors import HandsightError, InvalidInput, NotFound, NotWritten, printable
from handsight.files import check_not_overwritten, growing_file, part_of, stream_name, write_errors

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from rich.console import Console
    from rich.table import Table

FAILED = 1
WRONG_INPUT = 2
CANNOT_WRITE = 74
INTERRUPTED = 130
NOBODY_READS = 141
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
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # The lowest free number is this one. Stdin is opened unreadable, stdout unwritable.
            os.open(os.devnull, (os.O_WRONLY, os.O_RDONLY, os.O_RDWR)[number])
            stream = open(number, "w" if number else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def discard(stream: IO[str]) -> None:
    """Discards the content of a stream's buffer, which would otherwise cause an error when Python exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def announce_compiling(*, aloud: bool = False) -> None:
    """Makes a terminal show which kernel is being compiled, a line that goes again; all take minutes.

    `aloud`: without a terminal, that kernels are being compiled is said once.
    """
    on_terminal = sys.stderr.isatty()
    if not (on_terminal or aloud):
        return
    from handsight._compiled.jit import on_compile

    text = "compiling handsight's kernels, once on this machine"
    if on_terminal:
        on_compile[:] = [lambda name: os.write(2, f"\r\x1b[2K{name and f'{text}: {name}'}".encode())]
    else:
        on_compile[:] = [lambda _: warn(f"{text}; this takes a minute or two")]


def check_outputs(answers: Path | None, picture: Path | None, *read: object) -> None:
    """Raises InvalidFile where an output would overwrite another one or what is read, and for a picture as which
    matplotlib does not write it InvalidInput, MissingExtra."""
    place = sys.stdout if is_stdout(answers) else answers
    growing = None if answers is None else part_of(answers)
    for source in read:
        for output, what in (
            (place, "the answers"),
            (growing, "the first answers"),
            (picture, "the picture"),
        ):
            check_not_overwritten(output, what, source, "what is read")
    check_not_overwritten(picture, "the picture", place, "the answers")
    if picture is not None:
        from handsight.viewer.figures import new_figure

        known = new_figure().canvas.get_supported_filetypes()
        if picture.suffix[1:].lower() not in known:
            raise InvalidInput(f"--plot: expected a name that ends in .png, .pdf or .svg, got {picture.name}")


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


def millimetres(lengths: "ArrayLike", digits: int = 1) -> str:
    """Returns lengths [m] as text in millimetres, a comma between them."""
    import numpy as np

    rounded = np.round(1000 * np.atleast_1d(lengths), digits) + 0.0  # no -0
    return ", ".join(f"{value:.{digits}f}" for value in rounded)


def plain_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int, **style: Any
) -> "Table":
    """Returns a `table` without borders, for output that a program may read."""
    return table(columns, rows, texts=texts, box=None, pad_edge=False, padding=(0, 2, 0, 0), **style)


def print_out(*parts: "str | Table", **options: Any) -> None:
    """Prints texts and tables on stdout literally: [mm] is not markup, and numbers are not coloured."""
    from rich.console import Console

    Console(markup=False, highlight=False).print(*parts, **options)


def is_stdout(path: Path | None) -> bool:
    """Returns whether a path stands for stdout."""
    return path is None or str(path) == "-"


@contextlib.contextmanager
def output_lines(path: Path | None) -> Iterator[Callable[[Iterable[str]], None]]:
    """Yields a function that writes lines at once, to a `growing_file` or to stdout; raises NotWritten."""
    to_file = path is not None and not is_stdout(path)
    opened = growing_file(path) if path is not None and to_file else contextlib.nullcontext(sys.stdout)
    with opened as stream:
        name = str(path) if to_file else stream_name(stream)

        def write(lines: Iterable[str]) -> None:
            with write_errors(name):
                stream.writelines(f"{line}\n" for line in lines)
                stream.flush()

        yield write


def kept_in(path: Path | None) -> str:
    """Returns the end of a sentence about lines that are not complete: where those are that were written."""
    if path is None or is_stdout(path):
        return "; they are written"
    part = part_of(path)
    return f"; they are in {part}" if part.exists() else ""


@dataclass(slots=True)
class End:
    """How a part of a command ended: normally if the exit code is 0."""

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
        end.exit_code = exit_code(error)
        end.error = error
        end.message = f"handsight: {error}"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"
        end.exit_code = FAILED
        end.error = error
        end.message = f"handsight: internal error: {fault}"


def exit_code(error: HandsightError) -> int:
    """Returns the exit code of a command that ends with an error."""
    if isinstance(error, NotFound):
        return FAILED
    return CANNOT_WRITE if isinstance(error, NotWritten) else WRONG_INPUT
