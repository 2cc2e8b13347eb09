"""`rig.yaml` to a rig: strict, versioned. docs/robots.md shows every key, `handsight.rig.form` what each may be."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import WrenchCalibration
from handsight.errors import HandsightError, MissingExtra
from handsight.hand import Hand, find_file
from handsight.hand.paths import PACKAGE
from handsight.rig.form import (
    VERSION,
    BiasForm,
    CameraForm,
    FingerForm,
    FramesForm,
    ObjectForm,
    PoseForm,
    RigForm,
    SensorForm,
    WorldForm,
)
from handsight.rig.parts import Camera, Finger, ObjectEntry, Table, Topics
from handsight.rig.yaml_file import YamlFile

Rig = TypeVar("Rig")


def load(path: Path, make: Callable[..., Rig]) -> Rig:
    """The rig of a file, as `make` (a rig's constructor) puts it together from its parts.

    Raises InvalidFile with file, line and path of what is wrong.
    """
    file = YamlFile(path)
    version = file.values.get("version")
    if isinstance(version, int | float) and version != VERSION:  # its other keys are that version's
        raise file.wrong(("version",), f"expected {VERSION}, got {version:g}")
    form = file.read(RigForm)
    world = form.world or WorldForm()
    sigmas = form.hand.given()
    return make(
        hand=_hand(form, file),
        fingers={name: _finger(finger) for name, finger in form.fingers.items()},
        camera=None if form.camera is None else _camera(form.camera),
        table=None if form.table is None else Table(**form.table.given()),
        gravity=np.array(world.gravity, dtype=np.float64),
        world_from=None if world.palm_from == "nowhere" else world.palm_from,
        frames=(form.frames or FramesForm()).given(),
        topics=_topics(form, file),
        objects={name: _object(said, path.parent) for name, said in (form.objects or {}).items()},
        **{name: sigmas[name] for name in ("sigma_joint_offset", "sigma_joint") if name in sigmas},
    )


def _hand(form: RigForm, file: YamlFile) -> Hand:
    named, tips = form.hand.file, {name: finger.frame for name, finger in form.fingers.items()}
    try:
        found = find_file(named, beside=file.path.parent)
        hand = Hand.from_file(found, palm=form.hand.palm, tips=tips)
    except MissingExtra:
        raise
    except HandsightError as error:
        # Whose body it is that the file does not have says the error's first word.
        what, _, said = str(error).partition(": ")
        fields = {"palm": ("hand", "palm")} | {f"tips[{name!r}]": ("fingers", name, "frame") for name in tips}
        if what in fields:
            raise file.wrong(fields[what], said) from None
        raise file.wrong(("hand", "file"), str(error)) from None
    except OSError as error:
        raise file.wrong(("hand", "file"), f"{checks.brief(named)}: {error.strerror}") from None
    if named.startswith(PACKAGE):  # its name is as good in a rig file elsewhere
        hand.file = named
    return hand


def _finger(form: FingerForm) -> Finger:
    T_frame_surface, sensor = _matrix(form.surface), form.sensor
    sigmas = {} if sensor.noise is None else sensor.noise.given()
    sigmas |= {name: value for name, value in form.given().items() if name.startswith("sigma")}
    return Finger(
        frame=form.frame,
        T_frame_surface=T_frame_surface,
        tip=form.tip.shape(se3.inverse(T_frame_surface) @ _matrix(sensor.pose)),
        calibration=_calibration(sensor),
        full_scale=sensor.full_scale,
        **sigmas,
    )


def _calibration(sensor: SensorForm) -> WrenchCalibration:
    bias = sensor.bias or BiasForm()
    return WrenchCalibration(
        bias_force=np.array(bias.force, dtype=np.float64),
        bias_torque=np.array(bias.torque, dtype=np.float64),
        mass=sensor.tip_mass,
        center_of_mass=np.array(sensor.tip_center, dtype=np.float64),
        residual_force=np.zeros(3),
        residual_torque=np.zeros(3),
        condition=1.0,
        reading=sensor.reading,
    )


def _camera(form: CameraForm) -> Camera:
    sigmas = {} if form.noise is None else form.noise.given()
    if form.constant_error is not None:
        sigmas |= {f"{name}_constant": value for name, value in form.constant_error.given().items()}
    k = form.intrinsics
    return Camera(
        on=form.fixed_to,
        T_mount_camera=_matrix(form.pose),
        intrinsics=None if k is None else np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1.0]]),
        size=None if k is None else (int(k.width), int(k.height)),
        **sigmas,
    )


def _topics(form: RigForm, file: YamlFile) -> Topics:
    said = {} if form.topics is None else form.topics.given()
    for name in said.get("wrenches", ()):
        if name not in form.fingers:
            unknown = f"unknown finger{checks.among(name, form.fingers)}"
            raise file.wrong(("topics", "wrenches", name), unknown)
    return Topics(**({"wrenches": {name: f"/{name}/wrench" for name in form.fingers}} | said))


def _object(form: ObjectForm, folder: Path) -> ObjectEntry:
    cylinder = form.cylinder
    return ObjectEntry(
        box=form.box,
        cylinder=None if cylinder is None else (cylinder.radius, cylinder.height),
        mesh=None if form.mesh is None else folder / form.mesh,
        scale=1.0 if form.scale is None else form.scale,
    )


def _matrix(pose: PoseForm | None) -> Array:
    return np.eye(4) if pose is None else pose.matrix()
