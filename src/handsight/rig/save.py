"""A `Rig` as the text of a `rig.yaml`, each key with what it means: `read` gives the same rig again."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Fingertip, Sphere
from handsight.errors import InvalidFile
from handsight.hand.paths import PACKAGE
from handsight.rig.parts import Camera, Finger, ObjectEntry
from handsight.rig.rig import Rig


def write(rig: Rig, path: Path) -> None:
    """Writes the rig's text to a file; raises InvalidFile where that cannot be.

    Files that the rig names are written as they are found from anywhere: with their whole path, or as `package://`.
    """
    try:
        path.write_text(text(rig), encoding="utf-8")
    except OSError as error:
        raise InvalidFile(f"{path}: cannot be written: {error.strerror}") from None


def text(rig: Rig) -> str:
    """The rig as YAML."""
    lines = [
        "# Lengths in metres, angles in degrees, forces in newtons. Every sigma is one standard deviation per axis.",
        "version: 1",
        "hand:",
        f"  file: {_file(rig.hand.file)}   # URDF or MJCF",
        f"  palm: {_quoted(rig.hand.palm)}",
        f"  joint_offset_deg: {_number(np.rad2deg(rig.sigma_joint_offset))}   # constant error of each joint angle",
        f"  joint_noise_deg: {_number(np.rad2deg(rig.sigma_joint))}",
        "fingers:",
    ]
    for k, (name, finger) in enumerate(rig.fingers.items()):
        said = _finger(finger)
        # What each key means is said once.
        said = said if k == 0 else [line.partition("   #")[0] for line in said]
        lines += _indented([f"{_quoted(name)}:", *_indented(said)])
    if rig.camera is not None:
        lines += ["camera:", *_indented(_camera(rig.camera))]
    if rig.table is not None:
        lines += [
            "table:   # objects stand on it until they are lifted",
            f"  height: {_number(rig.table.height)}   # of its top in the world",
            f"  sigma_height: {_number(rig.table.sigma_height)}",
            f"  sigma_tilt_deg: {_number(np.rad2deg(rig.table.sigma_tilt))}",
        ]
    lines += [
        "world:",
        f"  palm_from: {rig.world_from or 'nowhere'}   # tf, joints (the hand's file has the arm in it), nowhere",
        f"  gravity: {_vector(rig.gravity)}",
        "frames:   # what messages call them in frame_id",
        *(f"  {role}: {_quoted(name)}" for role, name in rig.frames.items()),
        *_topics(rig),
    ]
    if rig.objects:
        lines.append("objects:")
        for name, entry in rig.objects.items():
            lines += _indented([f"{_quoted(name)}: {_object(entry)}"])
    return "\n".join(lines) + "\n"


def _finger(finger: Finger) -> list[str]:
    known, tip = finger.calibration, finger.tip
    T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
    lines = [
        f"frame: {_quoted(finger.frame)}   # the body the tip moves with",
        f"surface: {pose_text(finger.T_frame_surface)}   # the shape's centre in it; the tip points along +z",
        f"tip: {_tip(tip)}",
        f"sigma_point: {_number(finger.sigma_point)}   # calibration, softness: what joints and sensor do not explain",
        f"sigma_normal_deg: {_number(np.rad2deg(finger.sigma_normal))}",
        "sensor:",
        f"  pose: {pose_text(finger.T_frame_surface @ T_surface_sensor)}   # in the frame",
        f"  reading: {known.reading}   # a tip at rest reads its weight along gravity: on_sensor; against it: on_tip",
        f"  noise: {{force: {_number(finger.sigma_force)}, torque: {_number(finger.sigma_torque)}}}",
        f"  bias: {{force: {_vector(known.bias_force)}, torque: {_vector(known.bias_torque)}}}",
        f"  tip_mass: {_number(known.mass)}   # kg; handsight.calibrate_wrench finds bias, mass and centre",
        f"  tip_center: {_vector(known.center_of_mass)}   # of mass, from the sensor",
    ]
    if finger.full_scale is not None:
        lines.append(f"  full_scale: {_vector(finger.full_scale)}   # force, torque")
    return lines


def _tip(tip: Fingertip) -> str:
    shape = (
        f"sphere: {_number(tip.radius)}"
        if isinstance(tip, Sphere)
        else f"ellipsoid: {_vector(tip.semi_axes)}"
    )
    parts = [shape, f"min_force: {_number(tip.min_force)}"]
    if tip.cap is not None:
        parts.append(f"cap: {_number(tip.cap)}")
    if tip.max_friction is not None:
        parts.append(f"max_friction: {_number(tip.max_friction)}")
    return "{" + ", ".join(parts) + "}"


def _camera(camera: Camera) -> list[str]:
    position, rotation = camera.sigma_position_constant, np.rad2deg(camera.sigma_rotation_constant)
    lines = [
        f"fixed_to: {camera.on}   # world or palm",
        f"pose: {pose_text(camera.T_mount_camera)}   # of its optical frame (x right, y down, z forward)",
        f"noise: {{position: {_number(camera.sigma_position)}, "
        f"rotation_deg: {_number(np.rad2deg(camera.sigma_rotation))}}}   # of a seen pose, each time anew",
        f"constant_error: {{position: {_number(position)}, rotation_deg: {_number(rotation)}}}"
        "   # of its calibration",
    ]
    if camera.intrinsics is not None and camera.size is not None:
        K, (width, height) = camera.intrinsics, camera.size
        values = zip(
            ("width", "height", "fx", "fy", "cx", "cy"),
            (width, height, *K[[0, 1, 0, 1], [0, 1, 2, 2]]),
            strict=True,
        )
        lines.append("intrinsics: {" + ", ".join(f"{key}: {_number(value)}" for key, value in values) + "}")
    return lines


def _topics(rig: Rig) -> list[str]:
    named = rig.topics
    lines = ["topics:", f"  joint_states: {_quoted(named.joint_states)}"]
    for key in ("vision", "tf", "color", "depth", "camera_info", "truth"):
        value = getattr(named, key)
        if value is not None:
            lines.append(f"  {key}: {_quoted(value)}")
    if named.wrenches:
        lines.append("  wrenches:")
        lines += [f"    {_quoted(name)}: {_quoted(topic)}" for name, topic in named.wrenches.items()]
    return lines


def _object(entry: ObjectEntry) -> str:
    if entry.box is not None:
        return f"{{box: {_vector(entry.box)}}}"
    if entry.cylinder is not None:
        radius, height = entry.cylinder
        return f"{{cylinder: {{radius: {_number(radius)}, height: {_number(height)}}}}}"
    return f"{{mesh: {_file(str(entry.mesh))}, scale: {_number(entry.scale)}}}"


def pose_text(T: Array) -> str:
    """A pose (4, 4) as the rig file writes it."""
    quaternion = se3.quaternion_from_rotation(T[:3, :3])
    return f"{{position: {_vector(T[:3, 3])}, quaternion_xyzw: {_vector(quaternion)}}}"


def _vector(values: Iterable[float]) -> str:
    return "[" + ", ".join(_number(value) for value in values) + "]"


def _number(value: float) -> str:
    """The shortest text that YAML reads as this number: it wants a dot before an exponent."""
    said = repr(round(float(value), 12)).replace("-0.0", "0.0") if value == 0 else f"{float(value):.12g}"
    if "e" in said and "." not in said:
        said = said.replace("e", ".0e")
    return said


def _quoted(name: str) -> str:
    """A name as YAML's double-quoted text, which JSON's is."""
    return json.dumps(name, ensure_ascii=False)


def _file(name: str) -> str:
    """A file's name that does not depend on the folder the rig lies in."""
    return _quoted(name if name.startswith(PACKAGE) else str(Path(name).absolute()))


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" for line in lines]
