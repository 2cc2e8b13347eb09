"""`handsight rig check`: a rig as tables, 80 columns wide where names are short, and what a recording lacks for it."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from handsight.rig import Finger, Rig

rig_app = typer.Typer(help="What describes a robot: hand, fingertips, camera.", no_args_is_help=True)


@rig_app.command("check")
def check(
    rig: Annotated[Path, typer.Argument(help="A rig.yaml.")],
    recording: Annotated[Path | None, typer.Argument(help="A recording to check it against.")] = None,
) -> None:
    """Print the rig as a table, and what a recording lacks for it.

    The exit code is 1 where the recording lacks something that tracking needs.
    """
    from handsight.rig import Rig

    found = Rig.from_file(rig)
    _print_rig(found, str(rig))
    if recording is None:
        return
    from handsight.recording import open_recording

    with open_recording(recording, found) as opened:
        for _ in opened.observations():
            pass
        lacking = [*opened.report.sentences(), *opened.lacks()]
    for sentence in lacking:
        typer.echo(f"- {sentence}")
    if not lacking:
        typer.echo(f"{recording.name} has everything that this rig listens to.")
    if lacking:
        raise typer.Exit(1)


def _print_rig(rig: "Rig", name: str) -> None:
    """Prints what a rig file says, in millimetres and degrees."""
    from rich.console import Console
    from rich.table import Table

    # Names are the user's, and [mm] is no markup.
    out = Console(markup=False, highlight=False)
    hand = rig.hand
    out.print(
        f"{name}: {len(hand.tips)} fingers on {hand.palm}, {len(hand.joint_names)} joints\n", soft_wrap=True
    )
    shapes = ("fingertip", "moves with", "shape [mm]", "cap [mm]", "friction", "± [mm]", "± [°]")
    out.print(_table(shapes, [[finger, *_shape(rig.fingers[finger])] for finger in rig.fingers]), "")
    sensors = ("sensor", "topic", "noise [mN]", "[mN m]", "range [N]", "[N m]", "tip [g]")
    out.print(_table(sensors, [[finger, *_sensor(rig, finger)] for finger in rig.fingers]), "")
    rest = Table(show_header=False, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for row in _rows(rig):
        rest.add_row(*row)
    out.print(rest)


def _table(columns: tuple[str, ...], rows: list[list[str]]) -> "Table":
    """Texts on the left, numbers on the right."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold underline")
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k < 2 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _shape(finger: "Finger") -> list[str]:
    from handsight.contact import Sphere

    tip = finger.tip
    sizes = " x ".join(f"{1e3 * a:g}" for a in tip.semi_axes)
    return [
        finger.frame,
        f"sphere {1e3 * tip.radius:g}" if isinstance(tip, Sphere) else sizes,
        "whole" if tip.cap is None else f"{1e3 * tip.cap:g}",
        "any" if tip.max_friction is None else f"{tip.max_friction:g}",
        f"{1e3 * finger.sigma_point:g}",
        f"{math.degrees(finger.sigma_normal):.2g}",
    ]


def _sensor(rig: "Rig", name: str) -> list[str]:
    finger = rig.fingers[name]
    scale = ("?", "?") if finger.full_scale is None else (f"{value:g}" for value in finger.full_scale)
    return [
        rig.topics.wrenches.get(name, "none"),
        f"{1e3 * finger.sigma_force:g}",
        f"{1e3 * finger.sigma_torque:g}",
        *scale,
        f"{1e3 * finger.calibration.mass:g}",
    ]


def _rows(rig: "Rig") -> list[tuple[str, str]]:
    offset, noise = math.degrees(rig.sigma_joint_offset), math.degrees(rig.sigma_joint)
    places = {"tf": f"from {rig.topics.tf}", "joints": "from the joints", None: "not known"}
    rows = [
        ("joints", f"{offset:.2g}° constant, {noise:.2g}° noise; on {rig.topics.joint_states}"),
        ("palm in the world", places[rig.world_from]),
    ]
    c = rig.camera
    if c is not None:
        seen = f"{1e3 * c.sigma_position:g} mm, {math.degrees(c.sigma_rotation):.2g}°"
        constant = f"{1e3 * c.sigma_position_constant:g} mm, {math.degrees(c.sigma_rotation_constant):.2g}°"
        rows += [("camera", f"fixed to the {c.on}; noise {seen}"), ("", f"constant error {constant}")]
    rows.append(("vision", f"poses on {rig.topics.vision}" if rig.topics.vision else "none"))
    if rig.table is not None:
        rows.append(("table", f"at {rig.table.height:g} m, ± {1e3 * rig.table.sigma_height:g} mm"))
    rows.append(("objects", ", ".join(rig.objects) or "none"))
    return rows
