"""A `Rig` as the text of a `rig.yaml`, each key with what it means: `read` gives the same rig again."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Fingertip, Sphere
from handsight.contact.taxels import TaxelArray
from handsight.files import write_errors
from handsight.hand.paths import PACKAGE
from handsight.rig.rig import Camera, Finger, ObjectEntry, Rig, Table, Topics


def write(rig: Rig, path: Path) -> None:
    """Writes the rig's text to a file; raises NotWritten where that cannot be.

    Files that the rig names are written as they are found from anywhere: with their whole path, or as `package://`.
    """
    with write_errors(path):
        path.write_text(text(rig), encoding="utf-8")


def text(rig: Rig) -> str:
    """The rig as YAML."""
    objects = {_said(name): _object(entry) for name, entry in rig.objects.items()}
    return (
        f"""\
# Lengths in metres, angles in degrees, forces in newtons. Every sigma is one standard deviation per axis.
version: 1
hand:
  file: {_said(_file(rig.hand.file))}   # URDF or MJCF
  palm: {_said(rig.hand.palm)}
  joint_offset_deg: {_said(np.rad2deg(rig.sigma_joint_offset))}   # constant error of each joint angle
  joint_noise_deg: {_said(np.rad2deg(rig.sigma_joint))}
fingers:
{_fingers(rig.fingers)}{_skin(rig.skin)}{_camera(rig.camera)}{_table(rig.table)}world:
  palm_from: {rig.world_from or "nowhere"}   # tf, joints (the hand's file has the arm in it), nowhere
  gravity: {_said(rig.gravity)}
frames:   # what messages call them in frame_id
{_lines(rig.frames)}{_topics(rig.topics)}{"objects:" if objects else ""}
{_lines(objects)}""".rstrip("\n")
        + "\n"
    )


def _fingers(fingers: Mapping[str, Finger]) -> str:
    lines = []
    for k, (name, finger) in enumerate(fingers.items()):
        # What each key means is said once.
        said = [line if k == 0 else line.partition("   #")[0] for line in _finger(finger).splitlines()]
        lines += [f"  {_said(name)}:", *(f"    {line}" for line in said)]
    return "\n".join(lines) + "\n"


def _finger(finger: Finger) -> str:
    known, tip = finger.calibration, finger.tip
    T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
    bias = {"force": known.bias_force, "torque": known.bias_torque}
    full_scale = (
        "" if finger.full_scale is None else f"  full_scale: {_said(finger.full_scale)}   # force, torque"
    )
    return f"""\
frame: {_said(finger.frame)}   # the body the tip moves with
surface: {pose_text(finger.T_frame_surface)}   # the shape's centre in it; the tip points along +z
tip: {_tip(tip)}
sigma_point: {_said(finger.sigma_point)}   # calibration, softness: what joints and sensor do not explain
sigma_normal_deg: {_said(np.rad2deg(finger.sigma_normal))}
sensor:
  pose: {pose_text(finger.T_frame_surface @ T_surface_sensor)}   # in the frame
  reading: {known.reading}   # a tip at rest reads its weight along gravity: on_sensor; against it: on_tip
  noise: {_said({"force": finger.sigma_force, "torque": finger.sigma_torque})}
  bias: {_said(bias)}
  tip_mass: {_said(known.mass)}   # kg; handsight.calibrate_wrench finds bias, mass and centre
  tip_center: {_said(known.center_of_mass)}   # of mass, from the sensor
{full_scale}"""


def _tip(tip: Fingertip) -> str:
    shape = {"sphere": tip.radius} if isinstance(tip, Sphere) else {"ellipsoid": tip.semi_axes}
    return _said(shape | {name: getattr(tip, name) for name in ("min_force", "cap", "max_friction")})


def _skin(skin: Mapping[str, TaxelArray]) -> str:
    return _section("skin", {_said(name): _array(array) for name, array in skin.items()})


def _array(array: TaxelArray) -> dict[str, Any]:
    given = {name: getattr(array, name) for name in ("pitch", "threshold", "full_scale", "sigma_point")}
    T = array.T_frame_grid
    return {
        "frame": array.frame,
        "pose": {"position": T[:3, 3], "quaternion_xyzw": se3.quaternion_from_rotation(T[:3, :3])},
        "rows": array.rows,
        "columns": array.columns,
        **given,
        "sigma_normal_deg": np.rad2deg(array.sigma_normal),
        "sigma_mount": array.sigma_mount,
    }


def _camera(camera: Camera | None) -> str:
    if camera is None:
        return ""
    lines = f"""\
camera:
  fixed_to: {camera.on}   # world or palm
  pose: {pose_text(camera.T_mount_camera)}   # of its optical frame (x right, y down, z forward)
  noise: {_sigmas(camera.sigma_position, camera.sigma_rotation)}   # of a seen pose, each time anew
  constant_error: {_sigmas(camera.sigma_position_constant, camera.sigma_rotation_constant)}   # of its calibration
  depth_camera: {camera.depth_camera}   # structured_light, time_of_flight or stereo: how it measures depth
"""
    if camera.intrinsics is None or camera.size is None:
        return lines
    sizes = (*camera.size, *camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]])
    intrinsics = dict(zip(("width", "height", "fx", "fy", "cx", "cy"), sizes, strict=True))
    lens = camera.lens if len(camera.lens) else None
    return lines + _lines({"intrinsics": intrinsics, "lens": lens})


def _sigmas(position: float, rotation: float) -> str:
    return _said({"position": position, "rotation_deg": np.rad2deg(rotation)})


def _table(table: Table | None) -> str:
    if table is None:
        return ""
    return f"""\
table:   # objects stand on it until they are lifted
  height: {_said(table.height)}   # of its top in the world
  sigma_height: {_said(table.sigma_height)}
  sigma_tilt_deg: {_said(np.rad2deg(table.sigma_tilt))}
"""


def _topics(topics: Topics) -> str:
    keys = ("joint_states", "vision", "tf", "color", "depth", "camera_info", "truth")
    named = _section("topics", {key: getattr(topics, key) for key in keys})
    for kind in ("wrenches", "contacts", "skin"):
        by_finger = {_said(name): topic for name, topic in getattr(topics, kind).items()}
        named += indent(_section(kind, by_finger), "  ")
    return named


def _object(entry: ObjectEntry) -> dict[str, Any]:
    known = {name: getattr(entry, name) for name in ("mass", "center_of_mass", "sigma_center_of_mass")}
    return _surface(entry) | {name: value for name, value in known.items() if value is not None}


def _surface(entry: ObjectEntry) -> dict[str, Any]:
    if entry.box is not None:
        return {"box": entry.box}
    if entry.cylinder is not None:
        return {"cylinder": dict(zip(("radius", "height"), entry.cylinder, strict=True))}
    if entry.name is not None:
        return {"name": entry.name}
    return {"mesh": _file(str(entry.mesh)), "scale": entry.scale}


def _file(name: str) -> str:
    """A file's name that does not depend on the folder the rig lies in."""
    return name if name.startswith(PACKAGE) else str(Path(name).absolute())


def pose_text(T: Array) -> str:
    """A pose (4, 4) as the rig file writes it."""
    return _said({"position": T[:3, 3], "quaternion_xyzw": se3.quaternion_from_rotation(T[:3, :3])})


def _section(name: str, entries: Mapping[str, object]) -> str:
    return f"{name}:\n{_lines(entries)}" if entries else ""


def _lines(entries: Mapping[str, object]) -> str:
    """A line for each entry that is not None."""
    return "".join(f"  {key}: {_said(value)}\n" for key, value in entries.items() if value is not None)


def _said(value: Any) -> str:
    """A value in one line; of a mapping what is not None."""
    if isinstance(value, Mapping):
        parts = (f"{key}: {_said(part)}" for key, part in value.items() if part is not None)
        return "{" + ", ".join(parts) + "}"
    if isinstance(value, str):  # YAML's double-quoted text is JSON's
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Iterable):
        return "[" + ", ".join(map(_said, value)) + "]"
    if isinstance(value, int):
        return str(value)
    number = f"{float(value):.12g}" if value else "0.0"
    # YAML wants a dot before an exponent.
    return number.replace("e", ".0e") if "." not in number else number
