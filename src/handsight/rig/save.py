"""A `Rig` as the text of a `rig.yaml`, with a comment beside each key; reading the text gives the same rig again."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Sphere, TactileSurface
from handsight.files import text_file
from handsight.hand.paths import PACKAGE
from handsight.objects import ObjectSpec
from handsight.rig import form
from handsight.rig.form import Form, Section, Values, keys
from handsight.rig.rig import Finger, MountedCamera, Rig


def write(rig: Rig, path: Path) -> None:
    """Writes the rig's text to a file; raises NotWritten.

    Files that the rig names are written with their absolute path, or as `package://`, so that they are found from
    anywhere. Places of taxels that are on no grid are written to tables beside it, one for all links of one shape.
    """
    tables = dict[str, str]()
    files = dict[str, str]()
    for name, surface in rig.skin.items():
        if surface.layout is None:
            rows = "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in _table(surface))
            files[name] = tables.setdefault(rows, f"{path.stem}.{name}.csv")
    for place, content in (
        *((path.parent / file, f"x,y,z,nx,ny,nz,ax,ay,az\n{rows}") for rows, file in tables.items()),
        (path, text(rig, files)),
    ):
        with text_file(place) as file:
            file.write(content)


def text(rig: Rig, tables: Mapping[str, str] | None = None) -> str:
    """Returns the rig as YAML; `tables`: by surface, the file of its taxels, which else are in the text."""
    document = {
        "version": form.VERSION,
        "hand": _hand(rig),
        "fingers": {name: _finger(f, sensed=name in rig.topics.wrenches) for name, f in rig.fingers.items()},
        "skin": {name: _surface(name, rig, (tables or {}).get(name)) for name in rig.skin},
        "camera": None if rig.camera is None else _camera(rig.camera),
        "table": None if rig.table is None else _values(form.TableForm, rig.table),
        "world": _values(form.WorldForm, rig, palm_from=rig.world_from or "nowhere"),
        "frames": rig.frames,
        "topics": _values(
            form.TopicsForm, rig.topics, joint_states=_joint_states(rig), messages=rig.topics.messages or None
        ),
        "objects": {name: _object(entry) for name, entry in rig.objects.items()},
    }
    title = "# Lengths in metres, angles in degrees, forces in newtons. Every sigma is one standard deviation per axis."
    return "\n".join([title, *_section(document, form.RigForm)]) + "\n"


def _hand(rig: Rig) -> Values:
    """Returns the values of the hand."""
    given: dict[str, object] = {"file": _file_name(rig.hand.file), "palm": rig.hand.palm}
    given["joint_names"] = dict(rig.joint_names) or None
    if not rig.hand.couplings.laws:
        given["sigma_coupled"] = None
    return _values(form.HandForm, rig, **given)


def _joint_states(rig: Rig) -> object:
    """Returns the topic of the joint states, with how they are read where that is not as a JointState's."""
    topics = rig.topics
    reading = topics.joint_reading
    if reading is None:
        return topics.joint_states
    names = reading.names or None
    field = reading.field or None
    return _values(form.JointStatesForm, reading, topic=topics.joint_states, message_field=field, names=names)


def pose_text(T: Array) -> str:
    """Returns a pose (4, 4) as the rig file has it."""
    return inline(se3.position_quaternion(T))


def sensor_text(finger: Finger) -> list[str]:
    """Returns what a calibration finds of a finger's sensor, as the rig file's lines below `sensor`."""
    sensor = _finger(finger)["sensor"]
    number = re.compile(r"\d+\.\d+(e-\d+)?")
    lines = (f"{name}: {inline(sensor[name])}" for name in ("noise", "bias", "tip_mass", "tip_center"))
    return [number.sub(lambda found: inline(float(f"{float(found[0]):.4g}")), line) for line in lines]


def _values(kind: type[Form], part: object, /, **given: object) -> Values:
    """Returns the values of a form's keys: those that are given, else the part's attributes; angles in degrees."""
    values = Values()
    for key in keys(kind):
        value: Any = given[key.name] if key.name in given else getattr(part, key.name, None)
        values[key.text] = np.rad2deg(value) if key.text.endswith("_deg") and value is not None else value
    return values


def _surface(name: str, rig: Rig, file: str | None) -> Values:
    """Returns the values of a grid, or of taxels at any places, which are in a file or in the text."""
    surface = rig.skin[name]
    given: Values = dict.fromkeys(("pose", "rows", "columns", "taxels", "layout")) | {"file": file}
    given["indentation"] = surface.indentation or None
    if surface.layout is not None:
        T, given["rows"], given["columns"] = surface.layout
        given["pose"] = se3.position_quaternion(T)
    elif file is None:
        given["taxels"] = _table(surface)
    return _values(form.SkinForm, surface, **given, message_field=rig.topics.skin_fields.get(name))


def _table(surface: TactileSurface) -> Array:
    """Returns the point, normal and x axis (n, 9) of each taxel."""
    axes = surface.taxels["axes"]
    return np.column_stack([surface.points, axes[:, :, 2], axes[:, :, 0]])


def _finger(finger: Finger, sensed: bool = True) -> Values:
    """Returns the values of a finger; its sensor's only where it is `sensed`, or calibrated."""
    known = finger.calibration
    tip = finger.tip
    T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
    size = {"sphere": tip.radius} if isinstance(tip, Sphere) else {"ellipsoid": tip.semi_axes}
    sensor = _values(
        form.SensorForm,
        finger,
        pose=se3.position_quaternion(finger.T_frame_surface @ T_surface_sensor),
        reading=known.reading,
        noise=_values(form.SensorNoiseForm, finger),
        bias={"force": known.bias_force, "torque": known.bias_torque},
        tip_mass=known.mass,
        tip_center=known.center_of_mass,
    )
    shape = _values(form.TipForm, tip, **size)
    given: Values = {"surface": se3.position_quaternion(finger.T_frame_surface), "tip": shape}
    given["sensor"] = sensor if sensed or known.mass or known.bias_force.any() else None
    if finger.friction is None:
        given["sigma_friction"] = None
    return _values(form.FingerForm, finger, **given)


def _camera(camera: MountedCamera) -> Values:
    given: Values = {"fixed_to": camera.on, "pose": se3.position_quaternion(camera.T_mount_camera)}
    for name, kind in form.CAMERA_ERRORS.items():
        sigmas = {key: getattr(camera, key + kind) for key in ("sigma_position", "sigma_rotation")}
        errors = form.VisionNoiseForm if kind else form.ImageNoiseForm
        given[name] = _values(errors, camera, **sigmas)
    values = _values(form.CameraForm, camera, **given, intrinsics=None, lens=None)
    if camera.intrinsics is not None and camera.size is not None:
        numbers = (*camera.size, *camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]])
        values["intrinsics"] = dict(zip(("width", "height", "fx", "fy", "cx", "cy"), numbers, strict=True))
        values["lens"] = camera.lens if len(camera.lens) else None
    return values


def _object(entry: ObjectSpec) -> Values:
    """Returns the values of the first of box, cylinder, name and mesh that the entry has, and of its weight."""
    cylinder = entry.cylinder and dict(zip(("radius", "height"), entry.cylinder, strict=True))
    mesh = None if entry.mesh is None else _file_name(str(entry.mesh))
    values = _values(form.ObjectForm, entry, cylinder=cylinder, mesh=mesh)
    kinds = [name for name in ("box", "cylinder", "name", "mesh") if values[name] is not None]
    left_out = kinds[1:] if kinds[0] == "mesh" else [*kinds[1:], "scale"]
    return {name: value for name, value in values.items() if name not in left_out}


def _file_name(name: str) -> str:
    """Returns the name of a file that does not depend on the folder of the rig."""
    return name if name.startswith(PACKAGE) else str(Path(name).absolute())


def _section(values: Mapping[str, Any], kind: object, comments: bool = True) -> Iterator[str]:
    """Yields a line for each value that is not None, and the lines of the sections in it.

    `kind`: the form of these values, or the type of each of them. Of several sections of one form, the first alone has
    comments.
    """
    declared = {key.text: key for key in keys(kind)} if isinstance(kind, type) else {}
    for i, (name, value) in enumerate(values.items()):
        key = declared.get(name)
        inner = key.kind if key else get_args(kind)[1]
        comment = f"   # {key.comment}" if key and key.comment and comments else ""
        name = name if key else inline(name)
        if value is None or (isinstance(value, Mapping) and all(part is None for part in value.values())):
            continue
        if get_origin(inner) is dict or (isinstance(inner, type) and issubclass(inner, Section)):
            yield f"{name}:{comment}"
            lines = _section(value, inner, comments and (key is not None or i == 0))
            yield from (f"  {line}" for line in lines)
        else:
            yield f"{name}: {value if get_origin(inner) is Literal else inline(value)}{comment}"


def inline(value: object) -> str:
    """Returns a value in one line; of a mapping, the entries that are not None."""
    if isinstance(value, Mapping):
        parts = (f"{name}: {inline(part)}" for name, part in value.items() if part is not None)
        return "{" + ", ".join(parts) + "}"
    if isinstance(value, str):  # YAML's double-quoted text is JSON's
        return json.dumps(value, ensure_ascii=False)
    if value is None:
        return "null"
    if isinstance(value, Iterable):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, int):
        return str(value)
    number = f"{float(value):.12g}" if value else "0.0"  # type: ignore[arg-type]
    # YAML wants a dot before an exponent.
    return number.replace("e", ".0e") if "." not in number else number
