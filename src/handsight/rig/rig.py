"""The robot as one value: hand, fingertips with their sensors, camera, table, and where each is heard.

Every sigma is one standard deviation per axis.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from itertools import combinations
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Fingertip, TaxelArray, WrenchCalibration
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.msgspec_errors import FieldPath as FieldPath
from handsight.msgspec_errors import field_name
from handsight.objects import ObjectModel

FARTHEST = 100.0
"""Nothing of a rig is farther away than this [m]; beyond it the unit is wrong."""
LONGEST_LINK = 0.5
"""Of what a fingertip hangs on [m]."""
LARGEST_HELD = 5.0
"""Side, radius or height of what is in a hand [m]."""
SAME_POSE = 1e-9
"""Two fingertips so alike [m] are one."""
DepthCamera = Literal["structured_light", "time_of_flight", "stereo"]
"""How a camera measures depth; what is wrong with it then, `handsight.vision.depth_noise` knows."""
LENSES = (0, 4, 5, 8)
"""How many numbers a lens may have: none, plumb_bob without and with k3, rational polynomial."""


class Shared(InvalidInput):
    """Two parts of a rig have what only one can have."""

    def __init__(self, field: FieldPath, said: str) -> None:
        super().__init__(f"{field_name(field)}: {said}")
        self.field, self.said = field, said


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finger:
    """One fingertip and the six-axis sensor it hangs on."""

    frame: str
    """The body of the hand's file that the tip moves with."""
    T_frame_surface: Array
    """(4, 4) the tip's frame (origin at the surface's centre, the tip points along +z) in the body's."""
    tip: Fingertip
    """Shape, cap and friction; its `T_surface_sensor` is where the sensor sits."""
    calibration: WrenchCalibration
    """Bias, mass and centre of mass in the sensor's frame, and which way it reads."""
    sigma_force: float = 0.01
    """Noise of a reading [N]."""
    sigma_torque: float = 5e-5
    """[N m]"""
    sigma_point: float = 5e-4
    """What joints and sensor do not explain: calibration, a soft tip [m]."""
    sigma_normal: float = np.deg2rad(1.0)
    """[rad]"""
    full_scale: tuple[float, float] | None = None
    """Largest force [N] and torque [N m] the sensor can read; at it the reading is no measurement."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for what is no pose or no standard deviation."""
        se3.check(self.T_frame_surface, "T_frame_surface")
        for name in ("sigma_force", "sigma_torque"):
            checks.sigma(getattr(self, name), name)
        _check_sigmas(self, "sigma_point", "sigma_normal")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Camera:
    """What sees the object, where it is, and how far it may be wrong."""

    on: Literal["world", "palm"] = "world"
    """What it is fixed to."""
    T_mount_camera: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) its optical frame in the world or the palm."""
    intrinsics: Array | None = None
    """(3, 3) of its images [pixels]; None: it gives poses only."""
    size: tuple[int, int] | None = None
    """(width, height) of its images [pixels]."""
    lens: Array = field(default_factory=lambda: np.zeros(0))
    """k1, k2, p1, p2[, k3[, k4, k5, k6]] of OpenCV and ROS' CameraInfo; none: its images are rectified."""
    depth_camera: DepthCamera = "structured_light"
    """How it measures depth, where it does."""
    sigma_position: float = 0.005
    """Of a seen pose, from one to the next [m]."""
    sigma_rotation: float = np.deg2rad(3.0)
    """[rad]"""
    sigma_position_constant: float = 0.05
    """Of its constant error: what a wrong extrinsic calibration does to a seen pose [m]."""
    sigma_rotation_constant: float = np.deg2rad(6.0)
    """[rad]"""

    def __post_init__(self) -> None:
        """Raises InvalidInput for what is no pose, no standard deviation, no lens or no kind of depth camera."""
        se3.check(self.T_mount_camera, "T_mount_camera")
        object.__setattr__(self, "lens", check_lens(self.lens, "lens"))
        kinds = get_args(DepthCamera)
        if self.depth_camera not in kinds:
            came = f"{checks.brief(self.depth_camera)!r}{checks.suggestion(str(self.depth_camera), kinds)}"
            raise InvalidInput(f"depth_camera: expected one of {', '.join(kinds)}, got {came}")
        _check_sigmas(self, *(name for name in Camera.__slots__ if name.startswith("sigma")))


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A horizontal plane that the object stands on until it is lifted."""

    height: float
    """Of its top in the world, along +z [m]."""
    sigma_height: float = 0.003
    """[m]"""
    sigma_tilt: float = np.deg2rad(1.0)
    """Of the object's stand on it [rad]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for what is no height or no standard deviation."""
        checks.position(self.height, "height", ())
        _check_sigmas(self, "sigma_height", "sigma_tilt")


@dataclass(frozen=True, slots=True, kw_only=True)
class Topics:
    """Where a recording, or a running robot, says what."""

    joint_states: str = "/joint_states"
    wrenches: Mapping[str, str] = field(default_factory=dict)
    """By finger."""
    contacts: Mapping[str, str] = field(default_factory=dict)
    """By finger, of tips that sense contacts themselves: ShadowContactStateStamped."""
    skin: Mapping[str, str] = field(default_factory=dict)  # by tactile array: Float32MultiArray or Image
    vision: str | None = "/vision/object"
    """PoseStamped or PoseWithCovarianceStamped."""
    tf: str | None = "/tf"
    color: str | None = None
    depth: str | None = None
    camera_info: str | None = None
    truth: str | None = None
    """PoseStamped of the object in the palm, where it is known: never used, only compared with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectEntry:
    """An object the rig knows by name; one of box, cylinder, mesh, name."""

    box: tuple[float, float, float] | None = None
    """Sides [m]."""
    cylinder: tuple[float, float] | None = None
    """Radius and height [m]."""
    mesh: Path | None = None
    scale: float = 1.0
    """Metres of a unit of the mesh."""
    name: str | None = None
    """In the library that `ObjectModel.from_library` opens."""
    mass: float | None = None
    """[kg]; beside a name: instead of the library's."""
    center_of_mass: tuple[float, float, float] | Literal["homogeneous"] | None = None
    """In the object's frame [m]; `homogeneous`: the centroid of its volume."""
    sigma_center_of_mass: float | None = None
    """One standard deviation per axis [m]."""

    def model(self) -> ObjectModel:
        """The object's surface, and what is known of its weight; raises a HandsightError where it cannot be made."""
        model = self._surface()
        if self.mass is None and self.center_of_mass is None:
            return model
        center = model.volume_centroid if self.center_of_mass == "homogeneous" else self.center_of_mass
        sigma = self.sigma_center_of_mass
        if center is None:
            center, sigma = model.center_of_mass, model.sigma_center_of_mass
        mass = model.mass if self.mass is None else self.mass
        return model.with_weight(mass=mass, center_of_mass=center, sigma_center_of_mass=sigma)

    def _surface(self) -> ObjectModel:
        if self.box is not None:
            return ObjectModel.box(self.box)
        if self.cylinder is not None:
            return ObjectModel.cylinder(*self.cylinder)
        if self.name is not None:
            return ObjectModel.from_library(self.name)
        if self.mesh is None:
            raise InvalidInput("object: expected one of box, cylinder, mesh, name, got none")
        return ObjectModel.from_file(self.mesh, scale=self.scale)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rig:
    """A robot hand that feels and is seen."""

    hand: Hand
    """Its palm frame is what poses are estimated in."""
    fingers: Mapping[str, Finger]
    """By name."""
    sigma_joint_offset: float = np.deg2rad(1.0)
    """Constant error of each joint angle [rad]."""
    sigma_joint: float = np.deg2rad(0.1)
    """Noise of each joint angle [rad]."""
    camera: Camera | None = None
    table: Table | None = None
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    """(3,) in the world [m/s²]."""
    world_from: Literal["tf", "joints"] | None = "tf"
    """Where `T_world_palm` comes from: /tf between `world_frame` and `palm_frame`, the hand's own file with the arm in
    it, or nowhere."""
    frames: Mapping[str, str] = field(
        default_factory=lambda: {"world": "world", "palm": "palm", "camera": "camera"}
    )
    """What messages call world, palm and camera in their frame_id."""
    topics: Topics = field(default_factory=Topics)
    objects: Mapping[str, ObjectEntry] = field(default_factory=dict)
    """By name."""
    skin: Mapping[str, TaxelArray] = field(default_factory=dict)
    """Tactile arrays on links, by name."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for a hand without a tip for each finger, and for two fingers or topics that are one."""
        for name, finger in self.fingers.items():
            body = self.hand.tips.get(name)
            if body != finger.frame:
                expected = (
                    f"expected the body of the hand's tip {body!r}" if body else "expected a tip of the hand"
                )
                raise InvalidInput(f"fingers[{name!r}].frame: {expected}, got {finger.frame!r}")
        for name, array in self.skin.items():
            self.hand.chains_to({f"skin[{name!r}].frame": array.frame})
        checks.load(self.gravity, "gravity", (3,))
        _check_sigmas(self, "sigma_joint_offset", "sigma_joint")
        if found := shared(self):
            raise Shared(*found)

    @classmethod
    def from_file(cls, path: str | Path) -> "Rig":
        """The rig that a YAML file describes; docs/robots.md shows one.

        Raises InvalidFile with file, line, and the nearest valid name where there is one.
        """
        from handsight.rig.load import load  # which makes one

        if not isinstance(path, str | Path):
            raise InvalidInput(f"path: expected a path, got {checks.brief(path)}")
        return load(Path(path))


def check_lens(value: ArrayLike, name: str) -> Array:
    """A lens' numbers as an array (n,); raises InvalidInput for another count of them."""
    lens = checks.finite(value, name, (None,))
    if len(lens) not in LENSES:
        raise InvalidInput(f"{name}: expected {', '.join(map(str, LENSES))} numbers, got {len(lens)}")
    return lens


def shared(rig: Rig) -> tuple[FieldPath, str] | None:
    """Where a rig has two fingers with one body, place or topic, or two topics of one name, and what is wrong then."""
    frames: dict[FieldPath, str] = {
        ("fingers", name, "frame"): finger.frame for name, finger in rig.fingers.items()
    }
    topics: dict[FieldPath, str] = {
        ("topics", item.name): getattr(rig.topics, item.name)
        for item in fields(rig.topics)
        if isinstance(getattr(rig.topics, item.name), str)
    }
    topics |= {("topics", "wrenches", name): topic for name, topic in rig.topics.wrenches.items()}
    for kind in ("contacts", "skin"):
        topics |= {("topics", kind, name): topic for name, topic in getattr(rig.topics, kind).items()}
    for kind, values in (("body", frames), ("topic", topics)):
        owners = dict[str, FieldPath]()
        for path, value in values.items():
            if value in owners:
                return (
                    path,
                    f"expected a {kind} of its own, got {value!r}, which is {field_name(owners[value])}'s",
                )
            owners[value] = path
    return _same_place(rig)


def _same_place(rig: Rig) -> tuple[FieldPath, str] | None:
    """The same of two tips of one pose, whatever the joints do."""
    hand = rig.hand
    # No two joints alike, so that fingers that are do not meet.
    positions = {joint: 0.1 + 0.01 * k for k, joint in enumerate(hand.moving)}
    Ts = dict(zip(hand.tips, hand.Ts_palm_tip(positions), strict=True))
    Ts = {name: Ts[name] @ finger.T_frame_surface for name, finger in rig.fingers.items()}
    for one, other in combinations(Ts, 2):
        if np.abs(Ts[one] - Ts[other]).max() < SAME_POSE:
            return ("fingers", other, "surface"), f"expected a place of its own, got that of fingers.{one}"
    return None


def _check_sigmas(part: object, *names: str) -> None:
    """Raises InvalidInput for a standard deviation that is not from zero to the largest there is."""
    for name in names:
        value = getattr(part, name)
        if not 0 <= float(checks.finite(value, name, ())) <= checks.MAX_DISTANCE:
            raise InvalidInput(f"{name}: expected a number from 0 to {checks.MAX_DISTANCE:g}, got {value:g}")
