"""`handsight demo`: a can and a box held by five fingers, a picture of one, a recording of each (all synthetic)."""

import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from handsight.cli.correct import draw as draw_corrections
from handsight.cli.terminal import announce_compiling, live_rows, say, table
from handsight.errors import MissingExtra

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from handsight.batch.problems import Problem
    from handsight.cli.track_summary import Run
    from handsight.evaluation import CorrectionErrors
    from handsight.recording.frames import Frame
    from handsight.rig import Rig

NAMES = ("can", "box")
DATA = Path(__file__).parents[1] / "data"
"""Built-in problems, a line for each name, and recordings, each with its rig beside it."""


def demo(
    plot: Annotated[
        Path, typer.Option(help="Where the picture goes: PNG, PDF or SVG by its name; others go beside it.")
    ] = Path("handsight-demo.png"),
) -> None:
    """Correct a can and a box held by five fingers, find the can in a picture, replay recordings (all synthetic).

    In the picture the hand is before the can, and nothing is known of where it is. The recordings, one of each, are
    of the simulated Shadow hand that `handsight simulate` drives: vision is constantly wrong by centimetres, and the
    object is grasped, pushed over the table, lifted and turned.
    """
    from rich.console import Console

    announce_compiling()
    out = Console(width=None if sys.stdout.isatty() else 110, markup=False, highlight=False)
    found = list(examples())
    out.print(_corrections(found))
    out.print(
        "open: directions that these contacts cannot see (a can slides along its axis and spins about it);\n"
        "there the answer is vision's, and the estimate says so."
    )
    try:
        draw_corrections([(row.problem, row.answer) for row in found], plot)
        out.print(f"wrote {plot}")
    except MissingExtra as error:
        out.print(f"no picture: {error}")
    try:
        out.print(_pictured(plot.with_name(f"{plot.stem}-picture{plot.suffix}")))
    except MissingExtra as error:
        out.print(f"no picture looked at: {error}")
    try:
        runs = [_replayed(name, plot, out) for name in NAMES]
    except MissingExtra as error:
        out.print(f"no recordings replayed: {error}")
        return
    out.print(_tracks(runs))


class Comparison(NamedTuple):
    """A `Comparison` is one example's errors against its truth."""

    name: str
    problem: "Problem"
    answer: dict[str, Any]
    """In the form of the command's answers."""
    vision: "CorrectionErrors"
    corrected: "CorrectionErrors"


def examples() -> Iterator[Comparison]:
    """Solves the problems of `data/demo.jsonl` and compares them with `data/demo_truth.jsonl`."""
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
            correction_errors(problem.model, T, T_true, problem.contacts.points_palm, unobservable)
            for T in (T_vision, T_corrected)
        )
        yield Comparison(name, problem, answered, vision, corrected)


def _corrections(found: Sequence[Comparison]) -> "Table":
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
    columns = ("object", "position", "of it, seen by touch", "rotation", "contacts off the surface", "open")
    return table(columns, rows, title="Error against the truth, vision → corrected (synthetic example)")


def _pictured(plot: Path) -> str:
    """Returns where the can is found in the built-in picture, against its truth; the picture is drawn where that can
    be."""
    from dataclasses import replace

    from handsight import se3
    from handsight.cli.locate_images import Sought, draw, warmed
    from handsight.rig import Rig
    from handsight.vision.depth_noise import STRUCTURED_LIGHT

    rig, known = Rig.from_file(DATA / "can.rig.yaml"), json.loads((DATA / "can.picture.json").read_bytes())
    model = replace(rig.objects["can"].model(), name="can")
    row = warmed(Sought({model.name: model}, STRUCTURED_LIGHT))(picture(rig, known))
    truth = se3.from_position_quaternion(**known["truth"])
    if row.reason is not None:
        return f"can in a picture (synthetic): not found: {row.reason}"
    T = row.found.Ts_camera_object[0]
    off = 1e3 * math.dist(T[:3, 3], truth[:3, 3])
    tilt = math.degrees(math.acos(min(1.0, abs(float(T[:3, 2] @ truth[:3, 2])))))
    found = f"centre off by {off:.1f} mm, axis by {tilt:.1f}°, in {1e3 * row.seconds:.0f} ms"
    text = f"can found in a picture with the hand before it, without a guess (synthetic): {found}"
    try:
        return f"{text}\n{draw([row], plot)}"
    except MissingExtra as error:
        return f"{text}\nno picture: {error}"


def picture(rig: "Rig", known: dict[str, Any]) -> "Frame":
    """The built-in picture of the can in the hand, the hand masked by what the robot knows; raises MissingExtra."""
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


def _replayed(name: str, plot: Path, out: "Console") -> "Run":
    """Returns a recording tracked, and drawn where that can be."""
    from handsight.cli.track import draw, progress, run
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings

    rig = Rig.from_file(DATA / f"{name}.rig.yaml")
    model = rig.objects[name].model()
    with live_rows(f"{name}.mcap", progress) as watch:
        ended = run(DATA / f"{name}.mcap", rig, model, TrackerSettings(outside=500), watch)
    for end in ended.ends:  # a part of it is no demonstration
        if end.message:
            say(end.message)
        raise typer.Exit(end.exit_code)
    out.print(draw(ended, model, plot.with_name(f"{plot.stem}-{name}{plot.suffix}")))
    return ended


def _tracks(runs: Sequence["Run"]) -> "Table":
    rows = []
    for ended in runs:
        vision, tracked = (ended.errors[name].summary() for name in ("vision", "tracked"))
        errors = (vision["base_mean"], tracked["base_mean"], tracked["base_last"])
        faster = ended.tally.recorded / ended.tally.wall
        rows.append(
            [ended.name, *(f"{mm:.1f} mm" for mm in errors), str(ended.corrections), f"{faster:.0f}x"]
        )
    title = "Recordings replayed: error of the base's centre on the table, as the paper measures it"
    columns = ("recording", "vision", "tracked", "at the end", "corrections", "real time")
    return table(columns, rows, title=title)
