"""`handsight demo`: a can and a box in a five-fingered hand, corrected, located and tracked (all synthetic)."""

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, cast

import typer
from typer import Option

from handsight.cli.correct import draw as draw_corrections
from handsight.cli.options import Run
from handsight.cli.terminal import announce_compiling, live_rows, say, table
from handsight.errors import MissingExtra

if TYPE_CHECKING:
    from handsight.batch.problems import Problem
    from handsight.cli.track import TrackResult
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

    announce_compiling()
    out = Console(width=None if sys.stdout.isatty() else 110, markup=False, highlight=False)
    found = list(examples())
    rows = [
        (
            row.name,
            f"{1e3 * row.vision.shift:.1f} → {1e3 * row.corrected.shift:.1f} mm",
            f"{1e3 * row.vision.shift_observable:.1f} → {1e3 * row.corrected.shift_observable:.1f} mm",
            f"{math.degrees(row.vision.turn):.1f} → {math.degrees(row.corrected.turn):.1f}°",
            f"{1e3 * row.vision.gap:.1f} → {1e3 * row.corrected.gap:.2f} mm",
            f"{len(row.answer['unobservable'])} of 6",
        )
        for row in found
    ]
    columns = ("object", "position", "of it, by touch", "rotation", "contacts off the surface", "open")
    title = "Error against the truth, vision → corrected (synthetic example)"
    out.print(table(columns, rows, title=title))
    out.print(
        "open: directions that these contacts do not determine (a can slides along its axis and turns about it);\n"
        "there the answer is vision's, and the estimate says so."
    )
    try:
        draw_corrections([(row.problem, row.answer) for row in found], plot)
        out.print(f"wrote {plot}")
    except MissingExtra as error:
        out.print(f"no picture: {error}")
    try:
        out.print(find_can(plot.with_name(f"{plot.stem}-picture{plot.suffix}")))
    except MissingExtra as error:
        out.print(f"no image searched: {error}")
    tracks = []
    try:
        for name in NAMES:
            result, sentence = replayed(name, plot.with_name(f"{plot.stem}-{name}{plot.suffix}"))
            out.print(sentence)
            vision, tracked = (result.errors[which].summary() for which in ("vision", "tracked"))
            errors = vision["base_mean"], tracked["base_mean"], tracked["base_last"]
            faster = f"{result.tally.recorded / result.tally.wall:.0f}x"
            texts = (*(f"{mm:.1f} mm" for mm in errors), str(result.tracker.corrections), faster)
            tracks.append((result.name, *texts))
    except MissingExtra as error:
        out.print(f"no recordings replayed: {error}")
        return
    columns = ("recording", "vision", "tracked", "at the end", "corrections", "real time")
    title = "Recordings replayed: error of the base's centre on the table, as the paper measures it"
    out.print(table(columns, tracks, title=title))


class Comparison(NamedTuple):
    """A `Comparison` has the errors of an example's poses against the truth."""

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
        given = T_true, problem.contacts.points_palm, unobservable
        vision, corrected = (correction_errors(problem.model, T, *given) for T in (T_vision, T_corrected))
        yield Comparison(name, problem, answered, vision, corrected)


def find_can(plot: Path) -> str:
    """Returns sentences about how well the can is located in the built-in image, and draws it; raises MissingExtra."""
    from handsight import se3
    from handsight.cli.locate import draw, locator
    from handsight.rig import Rig
    from handsight.vision.depth_noise import STRUCTURED_LIGHT

    rig, known = Rig.from_file(DATA / "can.rig.yaml"), json.loads((DATA / "can.picture.json").read_bytes())
    model = replace(rig.objects["can"].model(), name="can")
    row = cast("Located", locator({model.name: model}, STRUCTURED_LIGHT)(picture(rig, known)))
    if row.reason is not None:
        return f"can in an image (synthetic): not found: {row.reason}"
    T, T_true = row.found.Ts_camera_object[0], se3.from_position_quaternion(**known["truth"])
    off = 1e3 * math.dist(T[:3, 3], T_true[:3, 3])
    tilt = math.degrees(math.acos(min(1.0, abs(float(T[:3, 2] @ T_true[:3, 2])))))
    found = f"centre off by {off:.1f} mm, axis by {tilt:.1f}°, in {1e3 * row.seconds:.0f} ms"
    text = f"can found in an image with the hand in front of it, without a guess (synthetic): {found}"
    try:
        return f"{text}\n{draw([row], plot)}"
    except MissingExtra as error:
        return f"{text}\nno picture: {error}"


def picture(rig: "Rig", known: dict[str, Any]) -> "Frame":
    """Returns the built-in image of the can in the hand, masked by joints and calibration; raises MissingExtra."""
    import numpy as np

    from handsight import se3
    from handsight.recording.frames import Frame
    from handsight.vision import hand_mask, read_camera, read_color, read_depth

    camera = read_camera(DATA / "can.camera.json")
    depth = read_depth(DATA / "can.depth.png", camera=camera)
    shape, T_camera_palm = rig.hand.shape(), se3.from_position_quaternion(**known["T_camera_palm"])
    vertices = shape.vertices_palm(known["joint_positions"])
    hand = hand_mask(camera, np.nan_to_num(depth), vertices, shape.faces, T_camera_palm)
    color = read_color(DATA / "can.color.jpg", camera=camera)
    return Frame(name="can.depth.png", camera=camera, depth=depth, color=color, hand=hand)


def replayed(name: str, plot: Path) -> "tuple[TrackResult, str]":
    """Returns the result of tracking a built-in recording, and a sentence about its picture.

    Raises MissingExtra; ends the command if tracking ends early.
    """
    from handsight.cli.track import draw, progress, tracked
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings

    rig = Rig.from_file(DATA / f"{name}.rig.yaml")
    run = Run(DATA / f"{name}.mcap", rig, rig.objects[name].model(), TrackerSettings(outside=500))
    with live_rows(f"{name}.mcap", progress) as watch, TemporaryDirectory() as folder:
        result, log = tracked(run, watch, Path(folder))
        log.close(resumable=False)
    for end in result.ends:
        if end.message:
            say(end.message)
        raise typer.Exit(end.exit_code)
    return result, draw(result, run.model, plot)
