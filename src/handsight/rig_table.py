"""A rig as a table for the terminal."""

import numpy as np
from rich.console import Console
from rich.table import Table

from handsight.contact import Sphere
from handsight.rig import Finger, Rig


def print_rig(rig: Rig, name: str) -> None:
    """Prints what a rig file says, in millimetres and degrees."""
    out = Console()
    hand = rig.hand
    out.print(
        f"[bold]{name}[/]: {len(hand.tips)} fingers on {hand.palm}, {len(hand.joint_names)} joints",
        highlight=False,
    )
    out.print(_fingers(rig))
    table = Table(show_header=False, box=None)
    for row in _rows(rig):
        table.add_row(*row)
    out.print(table)


def _fingers(rig: Rig) -> Table:
    table = Table(title="Fingertips", title_justify="left")
    columns = (
        "finger",
        "moves with",
        "shape [mm]",
        "cap [mm]",
        "friction",
        "noise",
        "tip [g]",
        "± [mm], [°]",
        "topic",
    )
    for column in columns:
        table.add_column(column)
    for name, finger in rig.fingers.items():
        table.add_row(name, finger.frame, *_finger(finger), rig.topics.wrenches.get(name, "-"))
    return table


def _finger(finger: Finger) -> list[str]:
    tip = finger.tip
    sizes = " x ".join(f"{1e3 * a:g}" for a in tip.semi_axes)
    if isinstance(tip, Sphere):
        sizes = f"sphere {1e3 * tip.radius:g}"
    return [
        sizes,
        "whole" if tip.cap is None else f"{1e3 * tip.cap:g}",
        "any" if tip.max_friction is None else f"{tip.max_friction:g}",
        f"{1e3 * finger.sigma_force:g} mN, {1e3 * finger.sigma_torque:g} mNm",
        f"{1e3 * finger.calibration.mass:g}",
        f"{1e3 * finger.sigma_point:g}, {np.rad2deg(finger.sigma_normal):.2g}",
    ]


def _rows(rig: Rig) -> list[tuple[str, str]]:
    offset, noise = np.rad2deg(rig.sigma_joint_offset), np.rad2deg(rig.sigma_joint)
    places = {"tf": f"from {rig.topics.tf}", "joints": "from the joints", None: "not known"}
    rows = [
        ("joints", f"{offset:.2g}° constant, {noise:.2g}° noise; on {rig.topics.joint_states}"),
        ("palm in the world", places[rig.world_from]),
    ]
    c = rig.camera
    if c is not None:
        noise = f"{1e3 * c.sigma_position:g} mm, {np.rad2deg(c.sigma_rotation):.2g}°"
        constant = f"{1e3 * c.sigma_position_constant:g} mm, {np.rad2deg(c.sigma_rotation_constant):.2g}°"
        rows.append(("camera", f"fixed to the {c.on}; noise {noise}; constant error {constant}"))
    rows.append(("vision", f"poses on {rig.topics.vision}" if rig.topics.vision else "none"))
    if rig.table is not None:
        rows.append(("table", f"at {rig.table.height:g} m, ± {1e3 * rig.table.sigma_height:g} mm"))
    rows.append(("objects", ", ".join(rig.objects) or "none"))
    return rows
