"""The command `handsight`: parse, call, print."""

import contextlib
import json
import math
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from typer.core import TyperCommand

from handsight.errors import HandsightError, MissingExtra

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
        Path | None,
        typer.Option("--output", "-o", help="Where the answers go, a line each; default: stdout."),
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
    progress = _progress(problems, show=output is not None)
    with _source(problems) as source, _sink(output, problems) as sink, progress as advance:
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


class _WithColumns(TyperCommand):
    """A command whose help ends with what it reads and writes, laid out as it stands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Prints the help."""
        from handsight.contact import COLUMNS_HELP, FINGERTIP_HELP

        super().format_help(ctx, formatter)
        print(f"Fingertip: {FINGERTIP_HELP}\n{COLUMNS_HELP}")


@app.command(cls=_WithColumns)
def contact(
    wrenches: Annotated[str, typer.Argument(help="A .csv or .jsonl file of wrenches, or - for stdin.")],
    fingertip: Annotated[str, typer.Option(help="Shape of the tip, as below.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="CSV, or JSON lines by its name; default: CSV on stdout."),
    ] = None,
    sigma_force: Annotated[float, typer.Option(help="Noise of the force, per axis [N].")] = 0.01,
    sigma_torque: Annotated[float, typer.Option(help="Noise of the torque, per axis [N m].")] = 5e-5,
) -> None:
    """Where the object touches a fingertip, from the wrench its six-axis sensor reads (eq. 7 of the paper).

    Readings are what the object exerts on the tip, without bias and weight: `handsight.calibrate_wrench` and
    `handsight.compensate` remove those.
    """
    from handsight.contact import convert, parse_fingertip

    shape = parse_fingertip(fingertip)
    source = sys.stdin if wrenches == "-" else wrenches
    counts = convert(
        source,
        sys.stdout if output is None or str(output) == "-" else output,
        shape,
        sigma_force=sigma_force,
        sigma_torque=sigma_torque,
    )
    said = ", ".join(f"{count} {reason}" for reason, count in counts.items() if count) or "no rows"
    messages.print(f"{'' if output is None else f'wrote {output}: '}{said}", markup=False)


@app.command()
def demo(
    plot: Annotated[Path, typer.Option(help="Where the picture goes: PNG, PDF or SVG by its name.")] = Path(
        "handsight-demo.png"
    ),
) -> None:
    """Correct the built-in example: a can and a box held by five fingers, vision 8 cm off (synthetic)."""
    from rich.table import Table

    from handsight.demo import examples

    table = Table(title="Error against the truth, vision → corrected (synthetic example)")
    for column in (
        "object",
        "position",
        "of it, seen by touch",
        "rotation",
        "contacts off the surface",
        "open",
    ):
        table.add_column(column, justify="left" if column == "object" else "right")
    found = list(examples())
    for row in found:
        table.add_row(
            row.name,
            *(f"{1e3 * a:.1f} → {1e3 * b:.1f} mm" for a, b in (row.shift, row.shift_seen)),
            "{:.1f} → {:.1f}°".format(*map(math.degrees, row.turn)),
            f"{1e3 * row.gap[0]:.1f} → {1e3 * row.gap[1]:.2f} mm",
            f"{len(row.answered['unobservable'])} of 6",
        )
    out = Console(width=None if sys.stdout.isatty() else 110)
    out.print(table)
    out.print(
        "open: directions that these contacts cannot see (a can slides along its axis and spins about it);\n"
        "there the answer is vision's, and the estimate says so.",
        highlight=False,
    )
    try:
        from handsight.plot import draw_corrections

        draw_corrections([(row.problem, row.answered) for row in found], plot)
    except MissingExtra as error:
        out.print(f"no picture: {error}", highlight=False, markup=False)
        return
    out.print(f"wrote {plot}", highlight=False, markup=False)


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


if __name__ == "__main__":
    main()
