"""The command `handsight`: parse, call, print."""

import contextlib
import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from handsight.errors import HandsightError

if TYPE_CHECKING:
    from handsight.problems import Problem

app = typer.Typer(
    help="Know where the object is in the robot's hand, by touch and sight.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
messages = Console(stderr=True, soft_wrap=True, highlight=False)
MOST_PANELS = 6


def main() -> None:
    """Runs the command; wrong input is one sentence on stderr and exit code 2, never a traceback."""
    warnings.showwarning = _one_line_warning
    try:
        app()
    except HandsightError as error:
        messages.print(f"handsight: {error}", markup=False)
        sys.exit(2)
    except BrokenPipeError:
        # Whoever read the answers has gone; there is nobody to tell.
        sys.stderr.close()
        sys.exit(141)


def _one_line_warning(message: Any, *_: Any, **__: Any) -> None:
    messages.print(f"handsight: {message}", markup=False)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"handsight {version('handsight')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def correct(
    problems: Annotated[str, typer.Argument(help="A .jsonl file, a single .json, or - for stdin.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Where the answers go, a line each; default: stdout.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help=f"Draw the first {MOST_PANELS} problems: PNG, PDF or SVG by its name.")
    ] = None,
) -> None:
    """Correct an object's pose by what the fingertips touch.

    One problem a line (one line here; everything in metres and the palm's frame):

    ```
    {"object": {"box": [0.06, 0.09, 0.14]},
     "contacts": [{"point": [0.031, 0.01, 0.1], "normal": [1, 0, 0], "sigma_point": 0.001, "sigma_normal_deg": 5}],
     "vision": {"position": [0.02, 0, 0.1], "quaternion_xyzw": [0, 0, 0, 1],
                "sigma_position": 0.03, "sigma_rotation_deg": 15}}
    ```

    * **object**: `{"box": [x, y, z]}`, `{"cylinder": {"radius": r, "height": h}}` or
      `{"mesh": "file.ply", "scale": 0.001}`; the file is looked for beside the problem file.
    * **contacts**: `normal` is the object's outward normal. Sigmas are one standard deviation per axis
      (default 1 mm, 0.1 rad); or `covariance`, 6x6 of point and normal.
    * **vision** (absent: blind): sigmas per axis, or `covariance`, 6x6 of position and rotation.
    * **outside**: points on the hand, `[[x, y, z], ...]`, that cannot be inside the object.
    * **samples**: above 0, answer with the posterior's mean (say 4000).
    * **method**: `handsight`, or the paper's: `paper-lm`, `paper-gd`, `paper-lm-distance`, `paper-gd-distance`.

    Each line is answered in its place: pose, covariance, information, residuals, directions that touch leaves
    open, wrong contacts, other hypotheses. A line that cannot be read is answered `{"error": ...}`; the exit
    code is then 1.
    """
    from handsight.problems import Reader, answer_line

    if plot is not None:
        from handsight.plot import require_matplotlib

        require_matplotlib()
    reader = Reader(Path.cwd() if problems == "-" else Path(problems).parent)
    failed = done = 0
    drawn: list[tuple[Problem, dict[str, Any]]] = []
    with _source(problems) as source, _sink(output, problems) as sink:
        with _progress(problems, show=output is not None) as advance:
            try:
                for line in _lines(source, whole=problems.endswith(".json")):
                    answered, problem = answer_line(reader, line)
                    sink.write(json.dumps(answered, allow_nan=False) + "\n")
                    sink.flush()
                    done += 1
                    failed += problem is None
                    if plot is not None and problem is not None and len(drawn) < MOST_PANELS:
                        drawn.append((problem, answered))
                    advance(len(line))
            except KeyboardInterrupt:
                messages.print(f"handsight: stopped after {done} answers; they are written", markup=False)
                raise typer.Exit(130) from None
    if plot is not None and drawn:
        from handsight.plot import draw_corrections

        draw_corrections(drawn, plot)
        messages.print(f"wrote {plot}", markup=False)
    if output is not None:
        messages.print(f"wrote {output}: {done} answers, {failed} of them errors", markup=False)
    if failed:
        raise typer.Exit(1)


@contextlib.contextmanager
def _source(name: str) -> Iterator[IO[bytes]]:
    if name == "-":
        yield sys.stdin.buffer
        return
    try:
        handle = open(name, "rb")  # noqa: SIM115
    except OSError as error:
        raise HandsightError(f"{name}: {error.strerror}") from None
    with handle:
        yield handle


@contextlib.contextmanager
def _sink(output: Path | None, source: str) -> Iterator[IO[str]]:
    if output is None or str(output) == "-":
        yield sys.stdout
        return
    if source != "-" and output.exists() and output.samefile(source):
        raise HandsightError(f"{output}: the answers would overwrite the problems")
    try:
        handle = open(output, "w", encoding="utf-8")  # noqa: SIM115
    except OSError as error:
        raise HandsightError(f"{output}: {error.strerror}") from None
    with handle:
        yield handle


def _lines(source: IO[bytes], *, whole: bool) -> Iterator[bytes]:
    if whole:
        yield source.read()
        return
    for line in source:
        if line.strip():
            yield line


@contextlib.contextmanager
def _progress(name: str, *, show: bool) -> Iterator[Any]:
    """A call that advances a bar on the terminal by bytes read; silent where nobody looks."""
    if not show or name == "-" or not messages.is_terminal:
        yield lambda size: None
        return
    columns = (TextColumn("correcting"), BarColumn(), TextColumn("{task.fields[count]}"), TimeElapsedColumn())
    with Progress(*columns, console=messages, transient=True) as progress:
        task = progress.add_task("", total=Path(name).stat().st_size, count=0)

        def advance(size: int) -> None:
            progress.update(task, advance=size, count=progress.tasks[0].fields["count"] + 1)

        yield advance
