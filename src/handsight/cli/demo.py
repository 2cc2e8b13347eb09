"""`handsight demo`: a can and a box held by five fingers, vision 8 cm off, and a recording of each (all synthetic)."""

import contextlib
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import announce_compiling, live_rows
from handsight.errors import MissingExtra

if TYPE_CHECKING:
    from handsight.batch.problems import Problem
    from handsight.cli.track import Run
    from handsight.evaluation import CorrectionErrors

NAMES = ("can", "box")


def demo(
    plot: Annotated[
        Path, typer.Option(help="Where the picture goes: PNG, PDF or SVG by its name; others go beside it.")
    ] = Path("handsight-demo.png"),
) -> None:
    """Correct a can and a box held by five fingers, then replay a recording of each (all synthetic).

    The recordings are of the simulated Shadow hand that `handsight simulate` drives: vision is constantly wrong by
    centimetres, and the object is grasped, pushed over the table, lifted and turned.
    """
    from rich.console import Console

    announce_compiling()
    out = Console(width=None if sys.stdout.isatty() else 110)
    found = list(examples())
    out.print(_corrections(found))
    _plain(
        out,
        "open: directions that these contacts cannot see (a can slides along its axis and spins about it);\n"
        "there the answer is vision's, and the estimate says so.",
    )
    try:
        from handsight.viewer.corrections import Panel, draw_corrections

        problems = [(row.problem, row.answer) for row in found]
        draw_corrections([Panel(p.model, p.contacts, p.vision, answer) for p, answer in problems], plot)
        _plain(out, f"wrote {plot}")
    except MissingExtra as error:
        _plain(out, f"no picture: {error}")
    try:
        with recordings() as paths:
            runs = [_replayed(name, path, plot, out) for name, path in paths.items()]
    except MissingExtra as error:
        _plain(out, f"no recordings replayed: {error}")
        return
    out.print(_tracks(runs))


@dataclass(frozen=True)
class Comparison:
    """One example's errors against its truth."""

    name: str
    problem: "Problem"
    answer: dict[str, Any]
    """In the form of the command's answers."""
    vision: "CorrectionErrors"
    corrected: "CorrectionErrors"


def examples() -> Iterator[Comparison]:
    """Solves the problems of `data/demo.jsonl` and compares them with `data/demo_truth.jsonl`."""
    from handsight.batch.problems import Reader, answer

    reader = Reader(Path.cwd())
    for name, line, truth in zip(NAMES, _lines("demo.jsonl"), _lines("demo_truth.jsonl"), strict=True):
        problem = reader.read(line.encode())
        yield _compared(name, problem, answer(problem), json.loads(truth))


def _compared(name: str, problem: "Problem", answer: dict[str, Any], truth: dict[str, Any]) -> Comparison:
    import numpy as np

    from handsight import se3
    from handsight.evaluation import correction_errors

    T_true, T_corrected = (
        se3.from_position_quaternion(pose["position"], pose["quaternion_xyzw"]) for pose in (truth, answer)
    )
    T_vision = T_corrected if problem.vision is None else problem.vision.T_palm_object
    unobservable = np.asarray(answer["unobservable"]).reshape(-1, 6)
    vision, corrected = (
        correction_errors(problem.model, T, T_true, problem.contacts.points_palm, unobservable)
        for T in (T_vision, T_corrected)
    )
    return Comparison(name, problem, answer, vision, corrected)


@contextlib.contextmanager
def recordings() -> Iterator[dict[str, Path]]:
    """By object, the built-in recordings, each with its rig beside it."""
    from importlib import resources

    with resources.as_file(resources.files("handsight").joinpath("data")) as folder:
        yield {name: folder / f"{name}.mcap" for name in NAMES}


def _lines(name: str) -> list[str]:
    from importlib import resources

    return resources.files("handsight").joinpath("data", name).read_text(encoding="utf-8").splitlines()


def _corrections(found: Sequence["Comparison"]) -> Any:
    from rich.table import Table

    table = Table(title="Error against the truth, vision → corrected (synthetic example)")
    columns = ("object", "position", "of it, seen by touch", "rotation", "contacts off the surface", "open")
    for column in columns:
        table.add_column(column, justify="left" if column == "object" else "right")
    for row in found:
        before, after = row.vision, row.corrected
        table.add_row(
            row.name,
            f"{1e3 * before.shift:.1f} → {1e3 * after.shift:.1f} mm",
            f"{1e3 * before.shift_observable:.1f} → {1e3 * after.shift_observable:.1f} mm",
            f"{math.degrees(before.turn):.1f} → {math.degrees(after.turn):.1f}°",
            f"{1e3 * before.gap:.1f} → {1e3 * after.gap:.2f} mm",
            f"{len(row.answer['unobservable'])} of 6",
        )
    return table


def _replayed(name: str, path: Path, plot: Path, out: Any) -> "Run":
    """A recording tracked, and drawn where that can be."""
    from handsight.cli.track import run, watching
    from handsight.rig import Rig
    from handsight.tracking import TrackerSettings

    rig = Rig.from_file(path.with_suffix(".rig.yaml"))
    model = rig.objects[name].model()
    with live_rows(path.name) as show:
        ended = run(path, rig, model, TrackerSettings(outside=500), watching(show))
    try:
        from handsight.viewer.track import draw_track

        drawn = plot.with_name(f"{plot.stem}-{name}{plot.suffix}")
        draw_track(ended.name, model, ended.steps, ended.truths, drawn)
        _plain(out, f"wrote {drawn}")
    except MissingExtra:
        pass  # said already
    return ended


def _tracks(runs: Sequence["Run"]) -> Any:
    from rich.table import Table

    table = Table(
        title="Recordings replayed: error of the base's centre on the table, as the paper measures it"
    )
    for column in ("recording", "vision", "tracked", "at the end", "corrections", "real time"):
        table.add_column(column, justify="left" if column == "recording" else "right")
    for ended in runs:
        errors = ended.summary()["errors_mm_deg"]
        table.add_row(
            ended.name,
            f"{errors['vision']['base_mean']:.1f} mm",
            f"{errors['tracked']['base_mean']:.1f} mm",
            f"{errors['tracked']['base_last']:.1f} mm",
            str(ended.corrections),
            f"{ended.tally.recorded / ended.tally.wall:.0f}x",
        )
    return table


def _plain(out: Any, text: str) -> None:
    out.print(text, highlight=False, markup=False)
