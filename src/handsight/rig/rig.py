"""The robot as one value: hand, fingertips with their sensors, camera, table, and their topics.

Every sigma is one standard deviation per axis.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from handsight import checks, se3
from handsight.camera import Camera, check_lens
from handsight.checks import Array
from handsight.contact import Fingertip, TactileSurface, WrenchCalibration
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.msgspec_errors import FieldPath as FieldPath
from handsight.msgspec_errors import field_name
from handsight.objects import ObjectSpec
from handsight.objects.model import check_friction
from handsight.representation import short_repr

DepthCamera = Literal["structured_light", "time_of_flight", "stereo"]
"""How a camera measures depth; `handsight.vision.depth_noise` has the errors of each."""
STEP = re.compile(
    r"\.?(?P<name>[A-Za-z]\w*)"
    r"|\[(?P<index>\d{1,6})\]"
    r"|\[(?P<first>\d{0,6}):(?P<end>\d{0,6})\]"
    r"|\[(?P<key>[A-Za-z]\w*)=(?P<value>[^\[\]=]+)\]"
    r"|\[(?P<columns>[A-Za-z]\w*(?:,[A-Za-z]\w*)*)\]"
)
"""A step into a message. `data` is a field; `data[3]` its fourth element, `data[0:9]` nine of them;
`sensors[name=thumb]` the element whose `name` is thumb; `taxels[x,y,z]` three numbers of each element, or of each point
of a PointCloud2."""


class NotUnique(InvalidInput):
    """Two parts of a rig have one body, pose or topic."""

    def __init__(self, field: FieldPath, message: str) -> None:
        super().__init__(f"{field_name(field)}: {message}")
        self.field, self.message = field, message


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finger:
    """A `Finger` is one fingertip and the six-axis sensor on which it hangs, if it has one."""

    frame: str
    """Body of the hand's file to which the tip is fixed."""
    T_frame_surface: Array
    """(4, 4) pose of the tip's frame (origin at the surface's centre, the tip points along +z) in the body."""
    tip: Fingertip
    """Shape, cap and friction, and the sensor's pose `T_surface_sensor`."""
    calibration: WrenchCalibration = field(
        default_factory=lambda: WrenchCalibration(np.zeros(3), np.zeros(3), 0.0, np.zeros(3))
    )
    """Bias, mass and centre of mass in the sensor's frame, and the sign of its readings; zero without a sensor."""
    sigma_force: float = 0.01
    """Noise of a force reading [N]."""
    sigma_torque: float = 5e-5
    """Noise of a torque reading [N m]."""
    sigma_gain: float = 0.02
    """Constant relative error of the readings of each axis, such as of its calibration matrix."""
    sigma_point: float = 5e-4
    """Error of a contact's position beside those of joints and sensor: calibration, a soft tip [m]."""
    sigma_normal: float = np.deg2rad(1.0)
    """The same of a contact's normal [rad]."""
    full_scale: tuple[float, float] | None = None
    """Largest force [N] and torque [N m] that the sensor can read; such a reading is no measurement."""
    friction: float | None = None
    """Coefficient of friction between tip and objects; None where it is to be learnt."""
    sigma_friction: float = 0.1
    """Standard deviation of that coefficient."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput for a wrong pose, standard deviation or coefficient of friction."""
        se3.check(self.T_frame_surface, "T_frame_surface")
        for name in ("sigma_force", "sigma_torque"):
            checks.sigma(getattr(self, name), name)
        check_friction(self.friction, self.sigma_friction, "friction")
        _check_sigmas(self, "sigma_point", "sigma_normal", "sigma_gain")

    def calibrated(
        self, found: WrenchCalibration, noise_force: float = 1e-3, noise_torque: float = 5e-6
    ) -> "Finger":
        """Returns the finger with a calibration of its sensor, and with sigmas that cover what that leaves.

        Real sensors leave .1 to .5 N where their noise is a few millinewton, because a bias that depends on the
        direction of gravity fits no calibration. `noise_force` [N] and `noise_torque` [N m]: of a single reading.
        """
        left = [np.mean(np.square(part)) for part in (found.residual_force, found.residual_torque)]
        sigma_force, sigma_torque = np.sqrt(left + np.square([noise_force, noise_torque])).tolist()
        return replace(self, calibration=found, sigma_force=sigma_force, sigma_torque=sigma_torque)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MountedCamera:
    """A `MountedCamera` is the camera that observes the object, with its pose and its errors."""

    on: Literal["world", "palm"] = "world"
    """What the camera is fixed to."""
    T_mount_camera: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of its optical frame in the world or the palm."""
    intrinsics: Array | None = None
    """(3, 3) camera matrix of its images [pixels]; None: it gives poses only."""
    size: tuple[int, int] | None = None
    """(width, height) of its images [pixels]."""
    lens: Array = field(default_factory=lambda: np.zeros(0))
    """Distortion k1, k2, p1, p2[, k3[, k4, k5, k6]] as OpenCV and ROS' CameraInfo have it; empty: rectified images."""
    depth_camera: DepthCamera = "structured_light"
    """How it measures depth, if it does."""
    sigma_position: float = 0.005
    """Noise of a detected pose's position, independent in each image [m]."""
    sigma_rotation: float = np.deg2rad(3.0)
    """Noise of its rotation [rad]."""
    sigma_position_constant: float = 0.05
    """Constant error of a detected pose's position, by a wrong extrinsic calibration [m]."""
    sigma_rotation_constant: float = np.deg2rad(6.0)
    """Constant error of its rotation [rad]."""
    sigma_position_correlated: float | None = None
    """Error of a detected pose's position that images of nearly the same time share, by the object's visible side,
    smoothing, or the texture [m]; None: twice `sigma_position`. Of published estimators it is once to three times the
    part that is independent in each image."""
    sigma_rotation_correlated: float | None = None
    """The same error of its rotation [rad]; None: `sigma_rotation`."""
    correlation_time: float = 5.0
    """How long such an error lasts: the time in which its correlation falls by a factor of e [s]."""
    latency: float = 0.0
    """How much older a pose, or an image, is than its stamp says [s]."""
    sigma_latency: float = 0.1
    """How far the latency may be another [s]; it is estimated while the hand moves the object."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput for a wrong pose, standard deviation, lens or kind of depth camera."""
        se3.check(self.T_mount_camera, "T_mount_camera")
        object.__setattr__(self, "lens", check_lens(self.lens, "lens"))
        kinds = get_args(DepthCamera)
        if self.depth_camera not in kinds:
            came = f"{checks.brief(self.depth_camera)!r}{checks.suggestion(str(self.depth_camera), kinds)}"
            raise InvalidInput(f"depth_camera: expected one of {', '.join(kinds)}, got {came}")
        sigmas = (name for name in MountedCamera.__slots__ if name.startswith("sigma"))
        _check_sigmas(self, *(name for name in sigmas if getattr(self, name) is not None))
        checks.positive(self.correlation_time, "correlation_time")
        if not 0 <= float(checks.finite(self.latency, "latency", ())) <= 1:
            raise InvalidInput(f"latency: expected a number from 0 to 1, got {self.latency:g}")

    @property
    def drift(self) -> Array:
        """(3,) variance of the correlated error: position [m²], rotation [rad²], and how long it lasts [s]."""
        position, rotation = self.sigma_position_correlated, self.sigma_rotation_correlated
        position = 2 * self.sigma_position if position is None else position
        rotation = self.sigma_rotation if rotation is None else rotation
        return np.array([position**2, rotation**2, self.correlation_time])

    def with_images_of(self, camera: Camera) -> "MountedCamera":
        """Returns the same camera with these intrinsics, as a CameraInfo has them."""
        return replace(self, intrinsics=camera.matrix, size=camera.size, lens=camera.lens)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A `Table` is a horizontal plane on which the object stands until it is lifted."""

    height: float
    """Height of its top in the world, along +z [m]."""
    sigma_height: float = 0.003
    """Standard deviation of the height [m]."""
    sigma_tilt: float = np.deg2rad(1.0)
    """Standard deviation of the angle between the object's base and the table [rad]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for a wrong height or standard deviation."""
        checks.position(self.height, "height", ())
        _check_sigmas(self, "sigma_height", "sigma_tilt")


@dataclass(frozen=True, slots=True, kw_only=True)
class Topics:
    """`Topics` are the names of a recording's, or a running robot's, topics."""

    joint_states: str = "/joint_states"
    wrenches: Mapping[str, str] = field(default_factory=dict)
    """By finger: WrenchStamped."""
    contacts: Mapping[str, str] = field(default_factory=dict)
    """By finger, of tips that sense contacts themselves: ShadowContactStateStamped, TactileContact(s), or ITS."""
    skin: Mapping[str, str] = field(default_factory=dict)
    """By tactile array: a MultiArray, Image or TactileState, or any message with a path in `skin_fields`."""
    skin_fields: Mapping[str, str] = field(default_factory=dict)
    """By tactile array: the path to its readings in the message, such as `sensors[sensor_pos=3].forces[0:30]`."""
    vision: str | None = "/vision/object"
    """PoseStamped or PoseWithCovarianceStamped."""
    tf: str | None = "/tf"
    color: str | None = None
    depth: str | None = None
    camera_info: str | None = None
    detections: str | None = None
    """Detection2DArray of another detector: where a lost object is searched first."""
    mask: str | None = None
    """Image that is not 0, or the object's label, where it is."""
    truth: str | None = None
    """PoseStamped of the true pose in the palm, which is only compared with."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for a path that cannot lead into a message."""
        for name, path in self.skin_fields.items():
            try:
                message_steps(path)
            except InvalidInput as error:
                raise InvalidInput(f"skin_fields[{name!r}]: {error}") from None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rig:
    """A `Rig` is a robot hand with its sensors, and the camera that observes it."""

    hand: Hand
    """The hand, in whose palm frame poses are estimated."""
    fingers: Mapping[str, Finger]
    """Fingers by name."""
    sigma_joint_offset: float = np.deg2rad(1.0)
    """Constant error of each joint angle [rad]."""
    sigma_joint: float = np.deg2rad(0.1)
    """Noise of each joint angle [rad]."""
    camera: MountedCamera | None = None
    table: Table | None = None
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    """(3,) gravity in the world [m/s²]."""
    world_from: Literal["tf", "joints"] | None = "tf"
    """Source of `T_world_palm`: /tf between `world_frame` and `palm_frame`, the hand's own file with the arm in it, or
    none."""
    frames: Mapping[str, str] = field(
        default_factory=lambda: {"world": "world", "palm": "palm", "camera": "camera"}
    )
    """Names of world, palm and camera in the frame_id of messages."""
    topics: Topics = field(default_factory=Topics)
    objects: Mapping[str, ObjectSpec] = field(default_factory=dict)
    """Objects by name."""
    skin: Mapping[str, TactileSurface] = field(default_factory=dict)
    """Tactile arrays on links, by name."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput for a hand without a tip for each finger, and for two fingers or topics of one name."""
        for name, finger in self.fingers.items():
            body = self.hand.tips.get(name)
            if body != finger.frame:
                expected = f"the body of the hand's tip {body!r}" if body else "a tip of the hand"
                raise InvalidInput(f"fingers[{name!r}].frame: expected {expected}, got {finger.frame!r}")
        for name, array in self.skin.items():
            self.hand.chains_to({f"skin[{name!r}].frame": array.frame})
        checks.load(self.gravity, "gravity", (3,))
        _check_sigmas(self, "sigma_joint_offset", "sigma_joint")
        _check_unique(self)

    @classmethod
    def from_file(cls, path: str | Path) -> "Rig":
        """Returns the rig of a YAML file; docs/robots.md shows one.

        Raises an InvalidFile with file, line, and the nearest valid name if there is one.
        """
        from handsight.rig.load import load  # which imports this module

        if not isinstance(path, str | Path):
            raise InvalidInput(f"path: expected a path, got {checks.brief(path)}")
        return load(Path(path))


def message_steps(field: str) -> list[re.Match[str]]:
    """Returns the steps of a path into a message; raises InvalidInput for a text that is none."""
    found, at = list[re.Match[str]](), 0
    while step := STEP.match(field, at):
        found, at = [*found, step], step.end()
    if at < len(field) or not 0 < len(field) <= 200:
        example = "such as sensors[sensor_pos=3].forces[0:30] or [fx,fy,fz]"
        raise InvalidInput(f"expected a path into a message, {example}, got {checks.brief(field)}")
    return found


def _check_unique(rig: Rig) -> None:
    """Raises NotUnique where two fingers have one body or pose, or two topics one name."""
    frames: dict[FieldPath, str] = {("fingers", name, "frame"): f.frame for name, f in rig.fingers.items()}
    topics, named = dict[FieldPath, str](), dict[FieldPath, str]()
    pathless = [name for name in rig.topics.skin if name not in rig.topics.skin_fields]
    for kind, topic in ((item.name, getattr(rig.topics, item.name)) for item in fields(rig.topics)):
        if isinstance(topic, str):
            topics["topics", kind] = topic
        elif topic is not None and kind != "skin_fields":
            # One message may be about several fingers' contacts, or about surfaces at different paths.
            several = {} if kind == "wrenches" else {each: name for name, each in reversed(topic.items())}
            named |= {
                ("topics", kind, name): each
                for name, each in topic.items()
                if several.get(each, name) == name or (kind == "skin" and name in pathless)
            }
    topics |= named
    for kind, values in (("body", frames), ("topic", topics)):
        owners = dict[str, FieldPath]()
        for path, value in values.items():
            if value in owners:
                owner = field_name(owners[value])
                raise NotUnique(path, f"expected a {kind} of its own, got {value!r}, which is {owner}'s")
            owners[value] = path
    hand = rig.hand
    # Each joint has another position, so that fingers of one shape are at different poses.
    positions = {joint: 0.1 + 0.01 * k for k, joint in enumerate(hand.moving)}
    Ts = dict(zip(hand.tips, hand.Ts_palm_tip(positions), strict=True))
    Ts = {name: Ts[name] @ finger.T_frame_surface for name, finger in rig.fingers.items()}
    for one, other in combinations(Ts, 2):
        if np.abs(Ts[one] - Ts[other]).max() < 1e-9:
            message = f"expected a place of its own, got that of fingers.{one}"
            raise NotUnique(("fingers", other, "surface"), message)


def _check_sigmas(part: object, *names: str) -> None:
    """Raises InvalidInput for a standard deviation that is not from zero to the largest there is."""
    for name in names:
        value = getattr(part, name)
        if not 0 <= float(checks.finite(value, name, ())) <= checks.MAX_DISTANCE:
            raise InvalidInput(f"{name}: expected a number from 0 to {checks.MAX_DISTANCE:g}, got {value:g}")
