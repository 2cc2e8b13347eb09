"""`handsight demo`: a can and a box in a five-fingered hand, corrected, located and tracked (all synthetic)."""

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, cast

import typer
from typer import Option

from handsight.cli.correct import draw as draw_corrections
from handsight.cli.options import Run
from handsight.cli.terminal import announce_compiling, bar, millimetres, table
from handsight.errors import MissingExtra

if TYPE_CHECKING:
    from rich.table import Table

    from handsight.batch.problems import Problem
    from handsight.evaluation import CorrectionErrors
    from handsight.recording.detections import Located
    from handsight.recording.frames import Frame
    from handsight.rig import Rig

NAMES = ("can", "box")
DATA = Path(__file__).parents[1] / "data"
"""Folder with a problem and a recording for each name, and with an image of the can."""


def demo(
    plot: Annotated[
        Path,
        Option(
            help="File for the first picture: PNG, PDF or SVG by its name. The others are written beside it."
        ),
    ] = Path("handsight-demo.png"),
) -> None:
    """Correct a can and a box held by five fingers, find the can in an image, and replay recordings (all synthetic).

    In the image the hand is in front of the can, and the can's pose is unknown. The recordings, one for each object,
    are of the simulated Shadow hand of `handsight simulate`: vision has a constant error of centimetres, and the object
    is grasped, pushed over the table, lifted and turned.

    ```
    handsight demo --plot demo.png
    ```
    """
    from rich.console import Console

    announce_compiling(aloud=True)
    out = Console(width=None if sys.stdout.isatty() else 110, markup=False, highlight=False)
    found = list(examples())
    out.print(error_table(found))
    out.print(
        "open: directions that these contacts do not determine (a can slides along its axis and turns about it);\n"
        "there the answer is vision's, and the estimate says so."
    )
    parts: dict[str, Callable[[], Iterable[str | Table]]] = {
        "no picture": lambda: [draw_corrections([(row.problem, row.answer) for row in found], plot)],
        "no image searched": lambda: find_can(plot.with_name(f"{plot.stem}-picture{plot.suffix}")),
        "no recordings replayed": lambda: replays(plot),
    }
    for lacking, part in parts.items():
        try:
            for shown in part():
                out.print(shown)
        except MissingExtra as error:
            out.print(f"{lacking}: {error}")


class Comparison(NamedTuple):
    """The errors of an example's poses against the truth."""

    name: str
    problem: "Problem"
    answer: dict[str, Any]
    """In the form of `handsight correct`."""
    vision: "CorrectionErrors"
    corrected: "CorrectionErrors"


def examples() -> Iterator[Comparison]:
    """Yields the problems of `data/demo.jsonl`, solved and compared with `data/demo_truth.jsonl`."""
    import numpy as np

    from handsight import se3
    from handsight.batch.problems import Reader, answer
    from handsight.evaluation import correction_errors

    lines, truths = ((DATA / file).read_bytes().splitlines() for file in ("demo.jsonl", "demo_truth.jsonl"))
    reader = Reader(Path.cwd())
    for name, line, truth in zip(NAMES, lines, truths, strict=True):
        problem = reader.read(line)
        answered = answer(problem)
        T_true, T_vision, T_corrected = (
            se3.from_position_quaternion(pose["position"], pose["quaternion_xyzw"])
            for pose in (json.loads(truth), json.loads(line)["vision"], answered)
        )
        unobservable = np.asarray(answered["unobservable"]).reshape(-1, 6)
        vision, corrected = (
            correction_errors(problem.model, T, T_true, unobservable) for T in (T_vision, T_corrected)
        )
        yield Comparison(name, problem, answered, vision, corrected)


def error_table(found: Iterable[Comparison]) -> "Table":
    """Returns the errors of vision's and of the corrected poses as a table."""
    rows = []
    for row in found:
        before = row.vision
        after = row.corrected
        rows.append(
            (
                row.name,
                f"{millimetres(before.shift)} → {millimetres(after.shift)} mm",
                f"{millimetres(before.shift_observable)} → {millimetres(after.shift_observable)} mm",
                f"{math.degrees(before.turn):.1f} → {math.degrees(after.turn):.1f}°",
                f"{len(row.answer['unobservable'])} of 6",
            )
        )
    columns = ("object", "position", "of it, by touch", "rotation", "open")
    return table(columns, rows, title="Error against the truth, vision → corrected (synthetic example)")


def find_can(plot: Path) -> Iterator[str]:
    """Yields how well the can is located in the built-in image, and draws it; raises MissingExtra."""
    from handsight import se3
    from handsight.cli.locate import draw, locator
    from handsight.rig import Rig
    from handsight.vision.depth_noise import STRUCTURED_LIGHT

    rig = Rig.from_file(DATA / "can.rig.yaml")
    known = json.loads((DATA / "can.picture.json").read_bytes())
    model = replace(rig.objects["can"].model(), name="can")
    row = cast("Located", locator({model.name: model}, STRUCTURED_LIGHT)(picture(rig, known)))
    if row.reason is not None:
        yield f"can in an image (synthetic): not found: {row.reason}"
        return
    T = row.found.Ts_camera_object[0]
    T_true = se3.from_position_quaternion(**known["truth"])
    off = millimetres(math.dist(T[:3, 3], T_true[:3, 3]))
    tilt = math.degrees(math.acos(min(1.0, abs(float(T[:3, 2] @ T_true[:3, 2])))))
    found = f"centre off by {off} mm, axis by {tilt:.1f}°, in {1000 * row.seconds:.0f} ms"
    yield f"can found in an image with the hand in front of it, without a guess (synthetic): {found}"
    yield draw([row], plot)


def picture(rig: "Rig", known: dict[str, Any]) -> "Frame":
    """Returns the built-in image of the can in the hand, masked by joints and calibration; raises MissingExtra."""
    import numpy as np

    from handsight import se3
    from handsight.recording.frames import Frame
    from handsight.vision import hand_mask, read_camera, read_color, read_depth

    camera = read_camera(DATA / "can.camera.json")
    depth = read_depth(DATA / "can.depth.png", camera=camera)
    shape = rig.hand.shape()
    T_camera_palm = se3.from_position_quaternion(**known["T_camera_palm"])
    vertices = shape.vertices_palm(known["joint_positions"])
    hand = hand_mask(camera, np.nan_to_num(depth), vertices, shape.faces, T_camera_palm)
    color = read_color(DATA / "can.color.jpg", camera=camera)
    return Frame(name="can.depth.png", camera=camera, depth=depth, color=color, hand=hand)


def replays(plot: Path) -> Iterator[str]:
    """Tracks the built-in recordings, and yields what `handsight track` says of each; raises MissingExtra.

    It ends the command if tracking ends early.
    """
    from handsight.cli.track import draw, progress, tracked
    from handsight.recording.track_log import TrackLog
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings

    for name in NAMES:
        rig = Rig.from_file(DATA / f"{name}.rig.yaml")
        run = Run(DATA / f"{name}.mcap", rig, rig.objects[name].model(), TrackerSettings(outside=500))
        with bar(f"{name}.mcap") as move, TrackLog() as log:
            result = tracked(run, partial(progress, move), log)
        yield f"{name}.mcap, replayed (synthetic):"
        yield from result.sentences()
        if result.exit_code:
            raise typer.Exit(result.exit_code)
        yield draw(result, run.model, plot.with_name(f"{plot.stem}-{name}{plot.suffix}"))
