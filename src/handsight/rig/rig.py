"""The robot as one value: hand, fingertips with their sensors, camera, table, and their topics.

Every sigma is one standard deviation per axis.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from handsight import checks, se3
from handsight.camera import Camera, check_lens
from handsight.checks import Array
from handsight.contact import Fingertip, TactileSurface, WrenchCalibration
from handsight.contact.sensing import SIGMA_FORCE, SIGMA_TORQUE
from handsight.errors import InvalidInput
from handsight.gaussian_pose import stretched
from handsight.hand import Hand
from handsight.msgspec_errors import FieldPath as FieldPath
from handsight.msgspec_errors import field_name
from handsight.objects import ObjectSpec
from handsight.objects.model import SIGMA_FRICTION, check_friction
from handsight.representation import short_repr

GRAVITY = (0.0, 0.0, -9.81)  # where none is given, in the world [m/s²]
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
        self.path = field
        self.message = message


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Finger:
    """One fingertip and the six-axis sensor on which it hangs, if it has one."""

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
    sigma_force: float = SIGMA_FORCE
    """Noise of a force reading [N]."""
    sigma_torque: float = SIGMA_TORQUE
    """Noise of a torque reading [N m]."""
    sigma_gain: float = 0.02
    """Constant relative error of the readings of each axis, such as of its calibration matrix."""
    sigma_point: float = 5e-4
    """Error of a contact's position beside those of joints and sensor: calibration, a soft tip [m]."""
    sigma_normal: float = np.deg2rad(1)
    """The same of a contact's normal [rad]."""
    full_scale: tuple[float, float] | None = None
    """Largest force [N] and torque [N m] that the sensor can read; such a reading is no measurement."""
    friction: float | None = None
    """Coefficient of friction between tip and objects; None where it is to be learnt."""
    sigma_friction: float = SIGMA_FRICTION
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
    """Camera that observes the object, with its pose and its errors."""

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
    sigma_ray: float | None = None
    """Noise of its position along the ray from the camera, which is known worst; None: `sigma_position`, which is that
    across it otherwise [m]."""
    sigma_rotation: float = np.deg2rad(3)
    """Noise of its rotation [rad]."""
    sigma_position_constant: float = 0.05
    """Constant error of a detected pose's position, by a wrong extrinsic calibration [m]."""
    sigma_rotation_constant: float = np.deg2rad(6)
    """Constant error of its rotation [rad]."""
    sigma_position_correlated: float | None = None
    """Error of a detected pose's position that images of nearly the same time share, by the object's visible side,
    smoothing, or the texture [m]; None: twice `sigma_position`. Of published estimators it is once to three times the
    part that is independent in each image."""
    sigma_rotation_correlated: float | None = None
    """The same error of its rotation [rad]; None: `sigma_rotation`."""
    correlation_time: float = 5
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
            came = checks.brief(self.depth_camera)
            raise InvalidInput(f"depth_camera: expected one of {', '.join(kinds)}, got {came!r}")
        sigmas = (name for name in MountedCamera.__slots__ if name.startswith("sigma"))
        _check_sigmas(self, *(name for name in sigmas if getattr(self, name) is not None))
        checks.positive(self.correlation_time, "correlation_time")
        if not 0 <= checks.finite(self.latency, "latency", ()) <= 1:
            raise InvalidInput(f"latency: expected a number from 0 to 1, got {self.latency:g}")

    @property
    def drift(self) -> Array:
        """(3,) variance of the correlated error: position [m²], rotation [rad²], and how long it lasts [s]."""
        position = self.sigma_position_correlated
        rotation = self.sigma_rotation_correlated
        position = 2 * self.sigma_position if position is None else position
        rotation = self.sigma_rotation if rotation is None else rotation
        return np.array([position**2, rotation**2, self.correlation_time])

    def noise_at(self, position_mount: Array) -> Array:
        """Returns the covariance (6, 6) of a detected pose's noise, along the mount's axes, of an object at a position
        (3,)."""
        covariance = np.diag([self.sigma_position**2] * 3 + [self.sigma_rotation**2] * 3)
        ray = position_mount - self.T_mount_camera[:3, 3]
        distance = np.linalg.norm(ray)
        if self.sigma_ray is not None and distance > 0:
            covariance[:3, :3] += stretched(ray / distance, self.sigma_ray, self.sigma_position)
        return covariance

    def with_images_of(self, camera: Camera) -> "MountedCamera":
        """Returns the same camera with these intrinsics, as a CameraInfo has them."""
        return replace(self, intrinsics=camera.matrix, size=camera.size, lens=camera.lens)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Horizontal plane on which the object stands until it is lifted."""

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
class JointReading:
    """How a driver publishes the positions of joints; wrong fields raise InvalidInput.

    A position is `scale * (number - offset)`, as readings of taxels are.
    """

    field: str = ""
    """The path to the numbers in a message, such as `hand_states[0].position`; empty: it is a JointState."""
    names: tuple[str | None, ...] = ()
    """The joints of the numbers in order, None where one is of no joint; empty: the message's own names, which are the
    field `name` beside the numbers."""
    scale: float | tuple[float, ...] = 1.0
    """Factor from `number - offset` to radians, or metres of a slide: one for all joints, or one for each number."""
    offset: float | tuple[float, ...] = 0.0
    """What is published at position 0: one for all joints, or one for each number."""

    def __post_init__(self) -> None:
        if self.field:
            try:
                message_steps(self.field)
            except InvalidInput as error:
                raise InvalidInput(f"field: {error}") from None
        named = [name for name in self.names if name is not None]
        if twice := next((name for name in named if named.count(name) > 1), None):
            raise InvalidInput(f"names: expected each joint once, got {twice!r} twice")
        for name in ("scale", "offset"):
            value = getattr(self, name)
            if not np.isfinite(value).all() or (name == "scale" and not np.all(value)):
                expected = "finite numbers" + ", none of them 0" * (name == "scale")
                raise InvalidInput(f"{name}: expected {expected}, got {checks.brief(value)}")
            if not isinstance(value, tuple) or len(value) == len(self.names):
                continue
            expected = (
                f"a number, or one for each of the {len(self.names)} names"
                if self.names
                else "a number, or names"
            )
            raise InvalidInput(f"{name}: expected {expected}, got {len(value)} numbers")

    @property
    def converts(self) -> bool:
        """Whether what is published is in another unit, or counted from another place."""
        return bool(np.any(np.not_equal(self.scale, 1)) or np.any(self.offset))


@dataclass(frozen=True, slots=True, kw_only=True)
class Topics:
    """Names of a recording's, or a running robot's, topics."""

    joint_states: str = "/joint_states"
    messages: tuple[str, ...] = ()
    """Folders `PACKAGE/msg` with `.msg` files: of types whose messages come without a definition."""
    joint_reading: JointReading | None = None
    """How the positions are read on that topic; None: a JointState, by the names and in the unit of the hand's file."""
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
    offsets: Mapping[str, float] = field(default_factory=dict)
    """By topic: what is added to its stamps [s], where its clock is not that of the joint states."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for a path that cannot lead into a message, and for an offset of another topic."""
        named = {*self.wrenches.values(), *self.contacts.values(), *self.skin.values(), self.joint_states}
        others = (self.vision, self.tf, self.color, self.depth, self.camera_info)
        known = named.union(others, (self.detections, self.mask, self.truth))
        for topic, offset in self.offsets.items():
            if topic not in known:
                near = checks.suggestion(topic, filter(None, known))
                raise InvalidInput(f"offsets: expected a topic of the rig, got {topic!r}{near}")
            checks.finite(offset, f"offsets[{topic!r}]", ())
        for name, path in self.skin_fields.items():
            try:
                message_steps(path)
            except InvalidInput as error:
                raise InvalidInput(f"skin_fields[{name!r}]: {error}") from None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rig:
    """Robot hand with its sensors, and the camera that observes it."""

    hand: Hand
    """The hand, in whose palm frame poses are estimated."""
    fingers: Mapping[str, Finger]
    """Fingers by name."""
    sigma_joint_offset: float = np.deg2rad(1.0)
    """Constant error of each joint angle [rad]."""
    sigma_joint: float = np.deg2rad(0.1)
    """Noise of each joint angle [rad]."""
    sigma_coupled: float = np.deg2rad(2.0)
    """How far a coupled joint that is not measured is off what its leader says [rad]: play, a stretched cord."""
    joint_names: Mapping[str, str] = field(default_factory=dict)
    """By the name of a joint in messages, that in the hand's file, where these differ."""
    camera: MountedCamera | None = None
    table: Table | None = None
    gravity: Array = field(default_factory=lambda: np.array(GRAVITY))
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
                raise InvalidInput(
                    f"fingers[{name!r}].frame: expected the body of the hand's tip, {body!r}, got {finger.frame!r}"
                )
        for name, array in self.skin.items():
            self.hand.chains_to({f"skin[{name!r}].frame": array.frame})
        checks.load(self.gravity, "gravity", (3,))
        _check_sigmas(self, "sigma_joint_offset", "sigma_joint", "sigma_coupled")
        _check_unique(self)

    def joint_errors(self, joints: Sequence[str], sigma: float) -> Array:
        """Returns L (j, j), where L Lᵀ is the covariance of the joints' errors, each with a standard deviation of
        `sigma` [rad]; the error of a joint that others follow is theirs, too, beside their own (`sigma_coupled`)."""
        laws = self.hand.couplings.laws
        own = [math.hypot(sigma, self.sigma_coupled) if name in laws else sigma for name in joints]
        return np.asarray(self.hand.couplings.changes(joints, {}) * own)

    @classmethod
    def from_file(cls, path: str | Path) -> "Rig":
        """Returns the rig of a YAML file; docs/rig_file.md shows one.

        Raises an InvalidFile with file, line, and the nearest valid name if there is one.
        """
        from handsight.rig.load import load  # which imports this module

        if not isinstance(path, str | Path):
            raise InvalidInput(f"path: expected a path, got {checks.brief(path)}")
        return load(Path(path))


def message_steps(field: str) -> list[re.Match[str]]:
    """Returns the steps of a path into a message; raises InvalidInput for a text that is none."""
    found = list[re.Match[str]]()
    at = 0
    while step := STEP.match(field, at):
        found = [*found, step]
        at = step.end()
    if at < len(field) or not 0 < len(field) <= 200:
        raise InvalidInput(
            "expected a path into a message, such as sensors[sensor_pos=3].forces[0:30] or [fx,fy,fz], got "
            f"{checks.brief(field)}"
        )
    return found


def _check_unique(rig: Rig) -> None:
    """Raises NotUnique where two fingers have one body or pose, or two topics one name."""
    owners = dict[tuple[str, str], FieldPath]()
    for path, kind, value in _unique_names(rig):
        owner = owners.setdefault((kind, value), path)
        if owner != path:
            raise NotUnique(
                path, f"expected a {kind} of its own, got {value!r}, which is {field_name(owner)}'s"
            )
    # Each joint has another position, so that fingers of one shape are at different poses.
    positions = {joint: (k + 10) / 100 for k, joint in enumerate(rig.hand.moving)}
    tips = zip(rig.hand.tips, rig.hand.Ts_palm_tip(positions), strict=True)
    placed = [(name, T @ rig.fingers[name].T_frame_surface) for name, T in tips if name in rig.fingers]
    for (one, T_one), (other, T_other) in combinations(placed, 2):
        if np.abs(T_one - T_other).max() < 1e-9:
            message = f"expected a place of its own, got that of fingers.{one}"
            raise NotUnique(("fingers", other, "surface"), message)


def _unique_names(rig: Rig) -> Iterator[tuple[FieldPath, str, str]]:
    """Yields path, kind and value of each body and topic that belongs to one part of a rig only."""
    for name, finger in rig.fingers.items():
        yield ("fingers", name, "frame"), "body", finger.frame
    for item in fields(rig.topics):
        topic = getattr(rig.topics, item.name)
        if isinstance(topic, str):
            yield ("topics", item.name), "topic", topic
    reading = rig.topics.joint_reading
    for kind in ("wrenches", "contacts", "skin"):
        named = getattr(rig.topics, kind)
        for name, topic in named.items():
            # One message may be about several fingers' contacts, or about surfaces at different paths.
            by_path = kind == "skin" and name in rig.topics.skin_fields
            several = kind == "contacts" or by_path
            first = next(other for other in named if named[other] == topic)
            with_joints = (
                by_path and reading is not None and bool(reading.field) and topic == rig.topics.joint_states
            )
            if with_joints:
                continue
            if first == name or not several:
                yield ("topics", kind, name), "topic", topic


def _check_sigmas(part: object, *names: str) -> None:
    """Raises InvalidInput for a standard deviation that is not from zero to the largest there is."""
    for name in names:
        value = getattr(part, name)
        if not 0 <= checks.finite(value, name, ()) <= checks.MAX_DISTANCE:
            raise InvalidInput(f"{name}: expected a number from 0 to {checks.MAX_DISTANCE:g}, got {value:g}")
