"""`handsight demo`: a can and a box held by five fingers, vision 8 cm off, and a recording of each (all synthetic)."""

import contextlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import announce_compiling, live_rows
from handsight.errors import InvalidInput, MissingExtra

if TYPE_CHECKING:
    from rich.table import Table

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
        with _data() as folder:
            runs = [_replayed(name, folder / f"{name}.mcap", plot, out) for name in NAMES]
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
    import numpy as np

    from handsight import se3
    from handsight.batch.problems import Reader, answer
    from handsight.evaluation import correction_errors

    with _data() as folder:
        lines, truths = (
            (folder / name).read_text(encoding="utf-8").splitlines()
            for name in ("demo.jsonl", "demo_truth.jsonl")
        )
    reader = Reader(Path.cwd())
    for name, line, truth in zip(NAMES, lines, truths, strict=True):
        problem = reader.read(line.encode())
        if problem.vision is None:
            raise InvalidInput("vision: expected a pose to compare with, got none")
        answered = answer(problem)
        unobservable = np.asarray(answered["unobservable"]).reshape(-1, 6)
        T_true, T_corrected = (
            se3.from_position_quaternion(pose["position"], pose["quaternion_xyzw"])
            for pose in (json.loads(truth), answered)
        )
        vision, corrected = (
            correction_errors(problem.model, T, T_true, problem.contacts.points_palm, unobservable)
            for T in (problem.vision.T_palm_object, T_corrected)
        )
        yield Comparison(name, problem, answered, vision, corrected)


@contextlib.contextmanager
def _data() -> Iterator[Path]:
    """The folder of the built-in problems and recordings, each with its rig beside it."""
    from importlib import resources

    with resources.as_file(resources.files("handsight").joinpath("data")) as folder:
        yield folder


def _table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> "Table":
    from rich.table import Table

    table = Table(title=title)
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left")
    for row in rows:
        table.add_row(*row)
    return table


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
    return _table("Error against the truth, vision → corrected (synthetic example)", columns, rows)


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


def _tracks(runs: Sequence["Run"]) -> "Table":
    rows = []
    for ended in runs:
        vision, tracked = (ended.errors[name].summary() for name in ("vision", "tracked"))
        rows.append(
            (
                ended.name,
                f"{vision['base_mean']:.1f} mm",
                f"{tracked['base_mean']:.1f} mm",
                f"{tracked['base_last']:.1f} mm",
                str(ended.corrections),
                f"{ended.tally.recorded / ended.tally.wall:.0f}x",
            )
        )
    title = "Recordings replayed: error of the base's centre on the table, as the paper measures it"
    return _table(title, ("recording", "vision", "tracked", "at the end", "corrections", "real time"), rows)


def _plain(out: Any, text: str) -> None:
    out.print(text, highlight=False, markup=False)
