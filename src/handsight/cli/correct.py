"""`handsight correct`: a file of problems, answered a line each."""

import contextlib
import json
import os
import stat
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import (
    INTERRUPTED,
    NOBODY_READS,
    announce_compiling,
    bar,
    naming,
    say,
    warn,
    writing,
)
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import check_not_overwritten, stream_name, write_errors

if TYPE_CHECKING:
    from handsight.batch.lines import Source
    from handsight.batch.problems import Problem
    from handsight.batch.workers import Answers

MOST_PANELS = 6
"""Problems that a picture has room for."""


@dataclass(slots=True)
class Written:
    """A `Written` is what has been written."""

    done: int = 0
    failed: int = 0
    first: list[tuple[bytes, str]] = field(default_factory=list)
    """Lines and answers that a picture can show."""

    def write(self, lines: list[bytes], answers: "Answers", sink: IO[str]) -> None:
        """Writes answers, and says what workers warned of."""
        for warning in answers.warnings:
            warn(warning)
        good = [pair for pair in zip(lines, answers.texts, strict=True) if not pair[1].startswith('{"error"')]
        with write_errors(stream_name(sink)):
            sink.write("".join(f"{text}\n" for text in answers.texts))
            # Before the flush: once in the buffer, answers are written whatever interrupts us.
            self.done += len(lines)
            self.failed += len(lines) - len(good)
            sink.flush()
        self.first += good[: MOST_PANELS - len(self.first)]


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
            "problem file's folder under its absolute path, so share it, and for names in the library that their own "
            "environment names. One thread per worker is best.",
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

    * **object**: `{"box": [x, y, z]}`, `{"cylinder": {"radius": r, "height": h}}`,
      `{"mesh": "file.ply", "scale": 0.001}`, looked for beside the problem file, or `{"name": "mustard"}`, in the
      library (`handsight objects --help`).
    * **contacts**: `normal` is the object's outward normal. Sigmas are one standard deviation per axis
      (default 1 mm, 0.1 rad); or `covariance`, 6x6 of point and normal.
    * **contacts_of_residual**: `true` if these are of all that parts contacts from the model, as measured at known
      poses; by default they are of the finger, and what the model adds is added.
    * **vision** (absent: blind): sigmas per axis, or `covariance`, 6x6 of position and rotation.
    * **outside**: points on the hand, `[[x, y, z], ...]`, that cannot be inside the object.
    * **planes**: `[{"point": [x, y, z], "normal": [x, y, z], "sigma": 0.003}]`, which the object cannot cross; the
    normal
      is to the object's side.
    * **weight**: `{"center_object": [x, y, z], "center_palm": [x, y, z], "sigma": 0.003}`: where the object's centre of
      mass is, in the object and in the palm; or `"covariance"` (3, 3).
    * **answer**: `best` (default) is the mean where contacts bound a slide and do not fix it, else the maximum; or
      `maximum`, or `mean`.
    * **samples**: above 0, answer with the mean of so many posterior samples instead (at most 1000000): a slow check.
    * **budget**: seconds after which no search for a better pose or a wrong contact goes on; "converged" is false
      where it cut one short.
    * **method**: `handsight`, or the paper's: `paper-lm`, `paper-gd`, `paper-lm-distance`, `paper-gd-distance`.

    Each line is answered in its place: pose, covariance, information, residuals, directions that touch leaves
    open, wrong contacts, other hypotheses. A line that cannot be read is answered `{"error": ...}`; the exit
    code is then 1; it is 2 where problems cannot be read, 74 where answers cannot be written. Any number of lines
    fits: they are read as they are answered. A byte order mark at the beginning is dropped.

    ```
    handsight correct grasps.jsonl --output answers.jsonl --plot first.png
    handsight correct grasps.jsonl --output answers.jsonl --workers 0
    handsight correct grasps.jsonl --output answers.jsonl --cluster tcp://10.0.0.5:8786
    producer | handsight correct - | consumer
    ```
    """
    if workers is not None and cluster is not None:
        raise InvalidInput("--workers: expected without --cluster, whose workers are its own, got both")
    workers = 1 if workers is None else workers
    written = Written()
    try:
        if plot is not None:
            from handsight.viewer.correction_figures import require_matplotlib

            require_matplotlib()
        if workers == 1 and cluster is None:
            announce_compiling()
        _answer(problems, (output, plot), workers, cluster, written)
        if plot is not None and written.first:
            from handsight.batch.problems import Reader

            reader = Reader(_folder(problems))
            draw(((reader.read(line), json.loads(text)) for line, text in written.first), plot)
            say(f"wrote {plot}")
    except KeyboardInterrupt:
        say(f"handsight: stopped after {written.done} answers; they are written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        raise typer.Exit(NOBODY_READS) from None
    if output is not None:
        say(f"wrote {output}: {written.done} answers, {written.failed} of them errors")
    if written.failed:
        raise typer.Exit(1)


def _answer(
    problems: str,
    outputs: tuple[Path | None, Path | None],
    workers: int,
    cluster: str | None,
    written: Written,
) -> None:
    """Answers and writes line by line; `written` tells how far it came. `outputs`: of answers and of a picture."""
    from handsight.batch.run import answering

    output, plot = outputs
    given = sys.stdin if problems == "-" else problems
    place = sys.stdout if output is None or str(output) == "-" else output
    check_not_overwritten(place, "the answers", given, "the problems")
    check_not_overwritten(plot, "the picture", given, "the problems")
    check_not_overwritten(plot, "the picture", place, "the answers")
    source = _source(problems)
    size = os.fstat(source.fileno()).st_size  # a pipe has none
    single, folder = problems.endswith(".json"), _folder(problems)
    run = answering(source, folder, single=single, workers=workers, cluster=cluster, first=announce_compiling)
    began, read = time.monotonic(), 0
    with (
        run as answered,
        writing(place) if isinstance(place, Path) else contextlib.nullcontext(place) as sink,
        bar("correcting", show=output is not None) as move,
    ):
        for lines, answers in answered:
            written.write(lines, answers, sink)
            read += sum(len(line) + 1 for line in lines)
            rate = written.done / (time.monotonic() - began)
            move(read / size if size else None, f"{written.done} answers, {rate:.0f}/s")


def _source(problems: str) -> "Source":
    """Returns where problems come from; raises InvalidFile."""
    with naming("stdin" if problems == "-" else problems):
        # Stdin as a file of its own, so that no thread holds the interpreter's when it ends.
        place = sys.stdin.fileno() if problems == "-" else problems
        source = open(place, "rb", closefd=problems != "-")  # noqa: SIM115
        found, nothing = os.fstat(source.fileno()), os.stat(os.devnull)
    if stat.S_ISCHR(found.st_mode) and not source.isatty() and found.st_rdev != nothing.st_rdev:
        # Such as /dev/zero: one line without an end.
        source.close()
        raise InvalidFile(f"{stream_name(source)}: expected a file, a pipe or a terminal, got a device")
    return source


def _folder(problems: str) -> Path:
    """Returns where meshes are looked for."""
    return Path.cwd() if problems == "-" else Path(problems).parent.absolute()


def draw(answered: "Iterable[tuple[Problem, dict[str, Any]]]", plot: Path) -> None:
    """Writes a picture of problems and their answers."""
    from handsight.viewer.correction_figures import CorrectionPanel, draw_corrections

    panels = [
        CorrectionPanel(problem.model, problem.contacts, problem.vision, answer)
        for problem, answer in answered
    ]
    draw_corrections(panels, plot)
