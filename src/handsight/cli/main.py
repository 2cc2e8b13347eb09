"""The command `handsight`: parse, call, print."""

import json
import os
import sys
import time
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from handsight.batch.job import MOST_PANELS, Tally, answered

# Help and version are to be there at once: what computes is imported by the command that needs it.
from handsight.cli import demo, robot
from handsight.cli.terminal import one_line_warning, opened_output, progress, say
from handsight.errors import HandsightError, InvalidInput

app = typer.Typer(
    help="Know where the object is in the robot's hand, by touch and sight.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
demo.register(app)
robot.register(app)
INTERRUPTED, NOBODY_READS = 130, 141
"""Exit codes, as a shell gives them for SIGINT and SIGPIPE."""


def main() -> None:
    """Runs the command; wrong input is one sentence on stderr and exit code 2, never a traceback."""
    warnings.showwarning = one_line_warning
    try:
        app()
    except HandsightError as error:
        say(f"handsight: {error}")
        sys.exit(2)


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
    workers: Annotated[
        int | None,
        typer.Option(min=0, show_default="1", help="Worker processes on this machine; 0: one for each core."),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Dask scheduler whose workers answer, such as tcp://127.0.0.1:8786. They look for meshes in the "
            "problem file's folder under its absolute path, so share it. One thread per worker is best.",
        ),
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
    code is then 1. Any number of lines fits: they are read as they are answered.

    ```
    handsight correct grasps.jsonl --output answers.jsonl --plot first.png
    handsight correct grasps.jsonl --output answers.jsonl --workers 0
    handsight correct grasps.jsonl --output answers.jsonl --cluster tcp://10.0.0.5:8786
    producer | handsight correct - | consumer
    ```
    """
    if workers is not None and cluster is not None:
        raise InvalidInput("--workers: expected without --cluster, whose workers are its own, got both")
    tally = Tally()
    try:
        if plot is not None:
            from handsight.viewer.corrections import require_matplotlib

            require_matplotlib()
        folder = Path.cwd() if problems == "-" else Path(problems).parent.absolute()
        with (
            answered(problems, str(folder), 1 if workers is None else workers, cluster) as answers,
            opened_output(output, problems) as sink,
            progress(problems, show=output is not None) as advance,
        ):
            tally.write(answers, sink, advance)
        if plot is not None and tally.first:
            _draw(tally.first, folder, plot)
    except KeyboardInterrupt:
        say(f"handsight: stopped after {tally.done} answers; they are written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # Whoever read the answers has gone; there is nobody to tell, nor to flush to at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(NOBODY_READS) from None
    if output is not None:
        say(f"wrote {output}: {tally.done} answers, {tally.failed} of them errors")
    if tally.failed:
        raise typer.Exit(1)


def _draw(pairs: list[tuple[bytes, str]], folder: Path, plot: Path) -> None:
    from handsight.batch.problems import Reader
    from handsight.viewer.corrections import draw_corrections

    reader = Reader(folder)
    draw_corrections([(reader.read(line), json.loads(text)) for line, text in pairs], plot)
    say(f"wrote {plot}")


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
    say(f"{'' if output is None else f'wrote {output}: '}{said}")


@app.command()
def warmup() -> None:
    """Compile what computes, ahead of the first problem; done once for each version and machine.

    Without it the first command that computes does so. `HANDSIGHT_CACHE` names another folder.
    """
    from handsight._kernels.compiled import folder
    from handsight._kernels.warm import warm

    began = time.monotonic()
    warm(lambda name, seconds: say(f"{seconds:6.1f} s  {name}"))
    print(f"compiled in {time.monotonic() - began:.1f} s; kept in {folder()}")
