"""`rig.yaml` to a `Rig`: strict, versioned. docs/robots.md shows every key."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np

from handsight import checks, se3
from handsight.checks import among
from handsight.contact import Ellipsoid, Fingertip, Sphere, WrenchCalibration
from handsight.errors import HandsightError, MissingExtra
from handsight.hand import Hand, find_file
from handsight.hand.paths import PACKAGE
from handsight.rig.yaml_file import Node, load
from handsight.rig.parts import Camera, Finger, ObjectEntry, Rig, Table, Topics

VERSION = 1
LONGEST_TIP = 0.2
"""[m]; checked by the shapes themselves as well."""


def read(path: Path) -> Rig:
    """The rig of a file; raises InvalidFile with file, line and path of what is wrong."""
    root = load(path)
    version = root.number("version")
    if version != VERSION:
        raise root.fail("version", f"expected {VERSION}, got {version:g}")
    fingers_node = root.needed("fingers")
    fingers = {name: _finger(_entry(fingers_node, name)) for name in fingers_node.keys}
    if not fingers:
        raise root.fail("fingers", "expected at least one finger, got none")
    hand_node = root.needed("hand")
    hand = _hand(hand_node, path, fingers_node, {name: finger.frame for name, finger in fingers.items()})
    joint_offset = hand_node.angle("joint_offset_deg", np.deg2rad(1.0))
    joint_noise = hand_node.angle("joint_noise_deg", np.deg2rad(0.1))
    hand_node.done()
    world = root.section("world")
    rig = Rig(
        hand=hand,
        fingers=fingers,
        sigma_joint_offset=joint_offset,
        sigma_joint=joint_noise,
        camera=_camera(root.section("camera")),
        table=_table(root.section("table")),
        gravity=np.array([0.0, 0.0, -9.81]) if world is None else _gravity(world),
        world_from="tf" if world is None else _world_from(world),
        frames=_frames(root.section("frames")),
        topics=_topics(root.section("topics"), tuple(fingers)),
        objects=_objects(root.section("objects"), path.parent),
    )
    if world is not None:
        world.done()
    root.done()
    return rig


def _entry(node: Node, name: str) -> Node:
    return node.needed(name)


@contextmanager
def _at(node: Node, key: str) -> Iterator[None]:
    """What a constructor refuses is an error at that key's line."""
    try:
        yield
    except HandsightError as error:
        raise node.fail(key, str(error)) from None


def _hand(node: Node, path: Path, fingers: Node, tips: dict[str, str]) -> Hand:
    named, palm = node.text("file"), node.text("palm")
    try:
        found = find_file(named, beside=path.parent)
        hand = Hand.from_file(found, palm=palm, tips=tips)
    except MissingExtra:
        raise
    except HandsightError as error:
        # Whose body it is that the file does not have says the error's first word.
        what, _, said = str(error).partition(": ")
        if what == "palm":
            raise node.fail("palm", said) from None
        for name in tips:
            if what == f"tips[{name!r}]":
                raise fingers.needed(name).fail("frame", said) from None
        raise node.fail("file", str(error)) from None
    except OSError as error:
        raise node.fail("file", f"{checks.brief(named)}: {error.strerror}") from None
    if named.startswith(PACKAGE):  # its name is as good in a rig file elsewhere
        hand.file = named
    return hand


def _finger(node: Node) -> Finger:
    sensor = node.needed("sensor")
    T_frame_sensor, T_frame_surface = sensor.pose("pose"), node.pose("surface")
    noise = sensor.section("noise")
    full_scale = sensor.vector("full_scale", 2, None)
    if full_scale is not None and not (full_scale > 0).all():
        raise sensor.fail("full_scale", "expected newtons and newton metres above 0, got "
                          f"{full_scale.tolist()}")  # fmt: skip
    finger = Finger(
        frame=node.text("frame"),
        T_frame_surface=T_frame_surface,
        tip=_tip(node.needed("tip"), se3.inverse(T_frame_surface) @ T_frame_sensor),
        calibration=_calibration(sensor),
        sigma_force=0.01 if noise is None else noise.positive("force", 0.01),
        sigma_torque=5e-5 if noise is None else noise.positive("torque", 5e-5),
        sigma_point=node.least("sigma_point", 5e-4),
        sigma_normal=node.angle("sigma_normal_deg", np.deg2rad(1.0)),
        full_scale=None if full_scale is None else (float(full_scale[0]), float(full_scale[1])),
    )
    for part in (noise, sensor, node):
        if part is not None:
            part.done()
    return finger


def _tip(node: Node, T_surface_sensor: np.ndarray) -> Fingertip:
    options = {
        "cap": node.number("cap", None),
        "max_friction": node.positive("max_friction", None),
        "min_force": node.positive("min_force", 0.1),
        "T_surface_sensor": T_surface_sensor,
    }
    shapes = [shape for shape in ("ellipsoid", "sphere") if shape in node]
    if len(shapes) != 1:
        came = " and ".join(shapes) or f"neither{node.misspelt('ellipsoid', 'sphere')}"
        raise node.fail("", f"expected ellipsoid: [a, b, c] or sphere: r, got {came}")
    round_tip = shapes[0] == "sphere"
    sizes = node.positive("sphere") if round_tip else node.vector("ellipsoid", 3)
    with _at(node, shapes[0]):
        tip: Fingertip = Sphere(sizes, **options) if round_tip else Ellipsoid(sizes, **options)
    node.done()
    return tip


def _calibration(sensor: Node) -> WrenchCalibration:
    bias = sensor.section("bias")
    calibration = WrenchCalibration(
        bias_force=np.zeros(3) if bias is None else bias.vector("force", 3, np.zeros(3)),
        bias_torque=np.zeros(3) if bias is None else bias.vector("torque", 3, np.zeros(3)),
        mass=sensor.least("tip_mass", 0.0),
        center_of_mass=sensor.vector("tip_center", 3, np.zeros(3)),
        residual_force=np.zeros(3),
        residual_torque=np.zeros(3),
        condition=1.0,
        reading=sensor.one_of("reading", ("on_sensor", "on_tip")),
    )
    if bias is not None:
        bias.done()
    if calibration.mass > 2:
        raise sensor.fail("tip_mass", f"expected kilograms, got {calibration.mass:g} (grams?)")
    return calibration


def _camera(node: Node | None) -> Camera | None:
    if node is None:
        return None
    intrinsics = size = None
    lens = node.section("intrinsics")
    if lens is not None:
        fx, fy, cx, cy = (lens.positive(key) for key in ("fx", "fy", "cx", "cy"))
        intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        size = (int(lens.positive("width")), int(lens.positive("height")))
        lens.done()
    usual = Camera()
    noise = node.section("noise")
    constant = node.section("constant_error")
    sigma = [(usual.sigma_position, usual.sigma_rotation)]
    sigma += [(usual.sigma_position_constant, usual.sigma_rotation_constant)]
    for i, part in enumerate((noise, constant)):
        if part is not None:
            sigma[i] = (part.least("position", sigma[i][0]), part.angle("rotation_deg", sigma[i][1]))
            part.done()
    camera = Camera(
        on=node.one_of("fixed_to", ("world", "palm"), "world"),
        T_mount_camera=node.pose("pose"),
        intrinsics=intrinsics,
        size=size,
        sigma_position=sigma[0][0],
        sigma_rotation=sigma[0][1],
        sigma_position_constant=sigma[1][0],
        sigma_rotation_constant=sigma[1][1],
    )
    node.done()
    return camera


def _table(node: Node | None) -> Table | None:
    if node is None:
        return None
    usual = Table(height=0.0)
    table = Table(
        height=node.number("height"),
        sigma_height=node.positive("sigma_height", usual.sigma_height),
        sigma_tilt=node.angle("sigma_tilt_deg", usual.sigma_tilt),
    )
    node.done()
    return table


def _gravity(world: Node) -> np.ndarray:
    gravity = world.vector("gravity", 3, np.array([0.0, 0.0, -9.81]))
    length = float(np.linalg.norm(gravity))
    if not 1.5 <= length <= 30:
        raise world.fail("gravity", f"expected a vector of 1.5 to 30 m/s², got length {length:.3g}")
    return np.asarray(gravity)


def _world_from(world: Node) -> Literal["tf", "joints"] | None:
    known: dict[str, Literal["tf", "joints"] | None] = {"tf": "tf", "joints": "joints", "nowhere": None}
    return known[world.one_of("palm_from", known, "tf")]


def _frames(node: Node | None) -> dict[str, str]:
    names = {"world": "world", "palm": "palm", "camera": "camera"}
    if node is not None:
        names = {role: node.text(role, name) for role, name in names.items()}
        node.done()
    return names


def _topics(node: Node | None, fingers: tuple[str, ...]) -> Topics:
    usual = Topics()
    if node is None:
        return Topics(wrenches={name: f"/{name}/wrench" for name in fingers})
    wrenches = {}
    heard = node.section("wrenches")
    for name in fingers if heard is None else heard.keys:
        if name not in fingers and heard is not None:
            raise heard.fail(name, f"unknown finger{among(name, fingers)}")
        wrenches[name] = f"/{name}/wrench" if heard is None else heard.text(name)
    others = {
        key: node.text(key, getattr(usual, key))
        for key in ("joint_states", "vision", "tf", "color", "depth", "camera_info", "truth")
    }
    node.done()
    return Topics(wrenches=wrenches, **others)


def _objects(node: Node | None, folder: Path) -> dict[str, ObjectEntry]:
    if node is None:
        return {}
    return {name: _object(_entry(node, name), folder) for name in node.keys}


def _object(node: Node, folder: Path) -> ObjectEntry:
    kinds = [kind for kind in ("box", "cylinder", "mesh") if kind in node]
    if len(kinds) != 1:
        came = " and ".join(kinds) or f"none{node.misspelt('box', 'cylinder', 'mesh')}"
        raise node.fail("", f"expected one of box, cylinder, mesh, got {came}")
    box = node.vector("box", 3, None)
    cylinder, mesh = node.section("cylinder"), node.text("mesh", None)
    size = None
    if cylinder is not None:
        size = (cylinder.positive("radius"), cylinder.positive("height"))
        cylinder.done()
    if box is not None and not (box > 0).all():
        raise node.fail("box", f"expected 3 sides above 0, got {box.tolist()}")
    entry = ObjectEntry(
        box=None if box is None else (float(box[0]), float(box[1]), float(box[2])),
        cylinder=size,
        mesh=None if mesh is None else folder / mesh,
        scale=node.positive("scale", 1.0) if mesh is not None else 1.0,
    )
    node.done()
    return entry
