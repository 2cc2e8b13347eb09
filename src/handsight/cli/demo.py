"""The command `handsight demo`: parse, call, print."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handsight.cli.terminal import live_rows
from handsight.errors import MissingExtra

if TYPE_CHECKING:
    from handsight.cli.examples import Comparison
    from handsight.cli.track import Run


def register(app: typer.Typer) -> None:
    """Adds the command to the program."""
    app.command()(demo)


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

    from handsight.cli.examples import examples, recordings

    out = Console(width=None if sys.stdout.isatty() else 110)
    found = list(examples())
    out.print(_corrections(found))
    _plain(
        out,
        "open: directions that these contacts cannot see (a can slides along its axis and spins about it);\n"
        "there the answer is vision's, and the estimate says so.",
    )
    try:
        from handsight.viewer.corrections import draw_corrections

        draw_corrections([(row.problem, row.answered) for row in found], plot)
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


def _corrections(found: Sequence["Comparison"]) -> Any:
    from rich.table import Table

    table = Table(title="Error against the truth, vision → corrected (synthetic example)")
    columns = ("object", "position", "of it, seen by touch", "rotation", "contacts off the surface", "open")
    for column in columns:
        table.add_column(column, justify="left" if column == "object" else "right")
    for row in found:
        table.add_row(
            row.name,
            *(f"{1e3 * a:.1f} → {1e3 * b:.1f} mm" for a, b in (row.shift, row.shift_seen)),
            "{:.1f} → {:.1f}°".format(*map(math.degrees, row.turn)),
            f"{1e3 * row.gap[0]:.1f} → {1e3 * row.gap[1]:.2f} mm",
            f"{len(row.answered['unobservable'])} of 6",
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
