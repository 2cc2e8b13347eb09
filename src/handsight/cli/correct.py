"""`handsight correct`: a file of problems, each answered with a line of JSON."""

import json
import os
import stat
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from handsight.cli import terminal
from handsight.cli.terminal import announce_compiling
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import stream_name

if TYPE_CHECKING:
    from handsight.batch.blocks import Source
    from handsight.batch.problems import Problem

MOST_PANELS = 6
"""Number of problems in the picture."""


def correct(
    problems: Annotated[str, Argument(help="A .jsonl file, a .json file of one problem, or - for stdin.")],
    output: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            help="File for the answers, one per line; OUTPUT.part until they are complete. Default: stdout.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        Option(help=f"File for a picture of the first {MOST_PANELS} problems: PNG, PDF or SVG by its name."),
    ] = None,
    workers: Annotated[
        int | None,
        Option(
            min=0, show_default="1", help="Number of worker processes on this machine. 0: one for each core."
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        Option(
            metavar="ADDRESS",
            help="Address of a Dask scheduler whose workers answer, such as tcp://127.0.0.1:8786. They read meshes at "
            "the same absolute path, so the problem file's folder must be shared, and look names up in the library "
            "of their own environment. One thread per worker is best.",
        ),
    ] = None,
) -> None:
    """Correct an object's pose by the contacts of the fingertips.

    Each line is a problem. Lengths are in metres, positions in the palm's frame:

    ```
    {"object": {"box": [0.06, 0.09, 0.14]},
     "contacts": [{"point": [0.031, 0.01, 0.1], "normal": [1, 0, 0], "sigma_point": 0.001, "sigma_normal_deg": 5}],
     "vision": {"position": [0.02, 0, 0.1], "quaternion_xyzw": [0, 0, 0, 1],
                "sigma_position": 0.03, "sigma_rotation_deg": 15}}
    ```

    * **object**: `{"box": [x, y, z]}`, `{"cylinder": {"radius": r, "height": h}}`,
      `{"mesh": "file.ply", "scale": 0.001}` with a path relative to the problem file, or `{"name": "mustard"}` of the
      library (`handsight objects --help`).
    * **contacts**: `normal` is the object's outward normal. Sigmas are standard deviations per axis (default 1 mm,
      0.1 rad); or give `covariance`, 6x6 of point and normal. Up to 20 000, a third of which may be wrong. With
      `"group": 0`, 1, ... contacts of one link share the error of its place.
    * **shared_covariance**: of a group's shift and turn about its contacts' centroid, 6x6, or one for each group.
    * **vision** (optional): a pose with sigmas per axis, or with `covariance`, 6x6 of position and rotation.
    * **outside**: points on the hand, `[[x, y, z], ...]`, that cannot be inside the object.
    * **planes**: `[{"point": [x, y, z], "normal": [x, y, z], "sigma": 0.003}]`, which the object cannot cross; the
      normal points to the object's side.
    * **weight**: `{"center_object": [x, y, z], "center_palm": [x, y, z], "sigma": 0.003}`: where the object's centre of
      mass is, in the object's and in the palm's frame; or `"covariance"`, 3x3.
    * **skin**: of tactile arrays, `contacts`, the pressed taxels; `untouched_palm`, points above the other taxels; and
      `sigmas`, six standard deviations of the pose of an entire array [m, rad].
    * **method**: `handsight` (default), or one of the paper's: `paper-lm`, `paper-gd`, `paper-lm-distance`,
      `paper-gd-distance`.

    Each answer has the pose, which is the mean where contacts bound a slide but do not fix it, the `maximum` of the
    density, the pose's covariance and information, the residuals, the directions that are unobservable by
    touch, the outliers among the contacts, the conflicts (which evidence contradicts the rest), and other hypotheses. A
    wrong line is answered with `{"error": ...}` in its place, and the exit code is then 1; it is 2 if problems cannot
    be read, and 74 if answers cannot be written. After Ctrl-C or an error the answers until then are in OUTPUT.part,
    and OUTPUT is as it was, but a shell's `> FILE` is cut under its own name. Lines are answered as they are read, so
    there may be any number of them. A byte order mark at the beginning is ignored.

    ```
    handsight correct grasps.jsonl --output answers.jsonl --plot first.png
    handsight correct grasps.jsonl --output answers.jsonl --workers 0
    handsight correct grasps.jsonl --output answers.jsonl --cluster tcp://10.0.0.5:8786
    producer | handsight correct - | consumer
    ```
    """
    if workers is not None and cluster is not None:
        raise InvalidInput("--workers: expected without --cluster, which has its own workers, got both")
    from handsight.batch.run import answering
    from handsight.tracking import warm

    workers = 1 if workers is None else workers
    folder = Path.cwd() if problems == "-" else Path(problems).parent.absolute()
    done = failed = 0
    first = list[tuple[bytes, str]]()  # lines and their answers, for the picture
    try:
        if cluster is None:
            announce_compiling()
            if workers != 1:
                warm.correct_near()  # kernels are compiled once, before the workers look for them
        given = sys.stdin if problems == "-" else problems
        terminal.check_outputs(output, plot, given)
        source = _open(problems)
        size = os.fstat(source.fileno()).st_size  # 0 for a pipe
        single = problems.endswith(".json")
        started = time.monotonic()
        read = 0
        run = answering(source, folder, single=single, workers=workers, cluster=cluster)
        with (
            run as answered,
            terminal.output_lines(output) as write,
            terminal.bar("correcting", show=output is not None) as move,
        ):
            for lines, answers in answered:
                for warning in answers.warnings:
                    terminal.warn(warning)
                pairs = zip(lines, answers.texts, strict=True)
                good = [pair for pair in pairs if not pair[1].startswith('{"error"')]
                write(answers.texts)
                done += len(lines)
                failed += len(lines) - len(good)
                first += good[: MOST_PANELS - len(first)]
                read += sum(len(line) + 1 for line in lines)
                rate = done / (time.monotonic() - started)
                move(read / size if size else None, f"{done} answers, {rate:.0f}/s")
        if plot is not None and first:
            from handsight.batch.problems import Reader

            reader = Reader(folder)
            terminal.say(draw(((reader.read(line), json.loads(text)) for line, text in first), plot))
    except KeyboardInterrupt:
        terminal.say(f"handsight: stopped after {done} answers{terminal.kept_in(output)}")
        raise typer.Exit(terminal.INTERRUPTED) from None
    except BrokenPipeError:
        raise typer.Exit(terminal.NOBODY_READS) from None
    if output is not None:
        terminal.say(f"wrote {output}: {done} answers, {failed} of them errors")
    if failed:
        raise typer.Exit(1)


def _open(problems: str) -> "Source":
    """Returns the stream of the problems; raises InvalidFile."""
    name = "stdin" if problems == "-" else problems
    try:
        # Stdin is opened again, as the reading thread must not hold Python's own when the program ends.
        place = sys.stdin.fileno() if problems == "-" else problems
        source = open(place, "rb", closefd=problems != "-")  # noqa: SIM115
        found = os.fstat(source.fileno())
        nothing = os.stat(os.devnull)
    except OSError as error:
        raise InvalidFile(f"{name}: {error.strerror or error}") from None
    if stat.S_ISCHR(found.st_mode) and not source.isatty() and found.st_rdev != nothing.st_rdev:
        source.close()  # such as /dev/zero, a line without an end
        raise InvalidFile(f"{stream_name(source)}: expected a file, a pipe or a terminal, got a device")
    return source


def draw(answered: "Iterable[tuple[Problem, dict[str, Any]]]", plot: Path) -> str:
    """Writes a picture of problems and their answers, and returns a sentence that names it."""
    from handsight.viewer.figures import CorrectionPanel, draw_corrections

    panels = [CorrectionPanel(of.model, of.contacts, of.vision, answer) for of, answer in answered]
    draw_corrections(panels, plot)
    return f"wrote {plot}"
