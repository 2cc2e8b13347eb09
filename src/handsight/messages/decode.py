"""ROS messages to what an `Observation` is made of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import hypot, isfinite
from typing import Any, Literal, NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.errors import InvalidInput, MissingExtra
from handsight.messages import images
from handsight.messages.fast_cdr import QuickReader
from handsight.messages.images import MessageRejected
from handsight.observation import VISION_FRAMES, PoseMeasurement
from handsight.rig import Rig

Role = Literal["joints", "wrench", "vision", "truth", "color", "depth", "tf", "tf_static", "info"]

JOINTS, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
TF = "tf2_msgs/msg/TFMessage"
TYPES: dict[Role, tuple[str, ...]] = {
    "joints": (JOINTS,),
    "wrench": (WRENCH,),
    "vision": (POSE, POSE_COVARIANCE),
    "truth": (POSE, POSE_COVARIANCE),
    "color": (IMAGE, COMPRESSED),
    "depth": (IMAGE, COMPRESSED),
    "tf": (TF, "tf/msg/tfMessage"),
    "tf_static": (TF, "tf/msg/tfMessage"),
    "info": (INFO,),
}


class RawMessage(NamedTuple):
    """One message as it lies in a file, or comes over the wire."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    encoding: str
    """`cdr` of ROS 2, `ros1`, or what else the file says."""
    log: float
    """When it was recorded, or received [s]."""
    data: bytes


class Channel(NamedTuple):
    """What a topic is to the rig."""

    topic: str
    role: Role
    finger: str = ""
    """Of a wrench."""


class FrameTransform(NamedTuple):
    """A transform of /tf."""

    parent: str
    child: str
    T_parent_child: Array
    """(4, 4)."""


class CameraIntrinsics(NamedTuple):
    """What a CameraInfo says."""

    intrinsics: Array
    """(3, 3) [pixels]."""
    size: tuple[int, int]
    """(width, height) [pixels]."""


@dataclass(slots=True, eq=False)
class Event:
    """Something that was measured."""

    channel: Channel
    stamp: float
    """As the message says it; later, in the clock of the joint states [s]."""
    log: float
    """When it was recorded [s]."""
    value: Any
    """By role: dict of positions; (6,); PoseMeasurement; (4, 4); image; FrameTransform; CameraIntrinsics."""

    @property
    def size(self) -> int:
        """About how many bytes it holds."""
        return 500 + (self.value.nbytes if self.channel.role in ("color", "depth") else 0)


def channels(rig: Rig) -> dict[str, Channel]:
    """What the rig listens to, by topic."""
    topics = rig.topics
    heard = [Channel(topics.joint_states, "joints")]
    heard += [Channel(topic, "wrench", finger) for finger, topic in topics.wrenches.items()]
    if topics.tf is not None and rig.world_from == "tf":
        heard += [Channel(topics.tf, "tf"), Channel(f"{topics.tf}_static", "tf_static")]
    others: dict[Role, str | None] = {
        "vision": topics.vision,
        "truth": topics.truth,
        "color": topics.color,
        "depth": topics.depth,
        "info": topics.camera_info,
    }
    heard += [Channel(topic, role) for role, topic in others.items() if topic is not None]
    return {channel.topic: channel for channel in heard}


def decoded(raw: RawMessage, channel: Channel, frames: Mapping[str, str], quick: QuickReader) -> list[Event]:
    """What the message says: one event, or one for each transform of /tf, still as messages; raises MessageRejected."""
    if raw.type not in TYPES[channel.role]:
        raise MessageRejected(f"expected {' or '.join(TYPES[channel.role])}, got {raw.type or 'no type'}")
    if raw.encoding == "cdr" and channel.role == "wrench" and (wrench := quick.wrench(raw.data)):
        return [Event(channel, wrench[0], raw.log, _six(wrench[1]))]
    if raw.encoding == "cdr" and channel.role == "joints" and (joints := quick.joints(raw.data)):
        return [Event(channel, joints[0], raw.log, _positions(joints[1], joints[2]))]
    message = _deserialized(raw)
    if channel.role in ("tf", "tf_static"):
        return [Event(channel, _stamp(each), raw.log, each) for each in message.transforms]
    return [Event(channel, _stamp(message), raw.log, READERS[channel.role](message, frames))]


def _deserialized(raw: RawMessage) -> Any:
    store = _typestore(raw.encoding)
    kind = TF if raw.type == "tf/msg/tfMessage" else raw.type
    try:
        if raw.encoding == "ros1":
            return store.deserialize_ros1(raw.data, kind)
        return store.deserialize_cdr(raw.data, kind)
    except Exception as error:  # whatever generated code trips over: the bytes are no such message
        raise MessageRejected(
            f"expected a {kind}, got {len(raw.data)} bytes that are none ({str(error)[:80]})"
        ) from None


@lru_cache
def _typestore(encoding: str) -> Any:
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise MissingExtra("recordings need rosbags: pip install 'handsight[robot]'") from None
    stores = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
    if encoding not in stores:
        raise MessageRejected(f"expected messages encoded as cdr or ros1, got {encoding[:20]!r}")
    store = get_typestore(stores[encoding])
    if TF not in store.types:  # ROS 1's own messages have only its forerunner
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _joints(message: Any, _: Mapping[str, str]) -> dict[str, float]:
    return _positions(message.name, message.position.tolist())


def _positions(names: Sequence[str], positions: Sequence[float]) -> dict[str, float]:
    """By name; raises MessageRejected."""
    if len(names) != len(positions):
        raise MessageRejected(f"expected as many positions as names, got {len(positions)} for {len(names)}")
    found = dict(zip(names, positions, strict=True))
    if len(found) != len(names):
        raise MessageRejected("expected each joint once, got one name twice")
    if not all(map(isfinite, positions)):
        bad = [name for name, position in found.items() if not isfinite(position)]
        raise MessageRejected(f"joint {', '.join(bad[:5])} is not a finite number", nan=True)
    return found


def _wrench(message: Any, _: Mapping[str, str]) -> Array:
    force, torque = message.wrench.force, message.wrench.torque
    return _six((force.x, force.y, force.z, torque.x, torque.y, torque.z))


def _six(values: Sequence[float]) -> Array:
    """(6,); raises MessageRejected."""
    if not all(map(isfinite, values)):
        raise MessageRejected("force or torque is not finite", nan=True)
    return np.array(values)


def _pose(pose: Any) -> Array:
    """(4, 4); raises MessageRejected."""
    p, q = pose.position, pose.orientation
    return transform((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def transform(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> Array:
    """(4, 4); raises MessageRejected. In plain floats: for one pose NumPy is ten times slower."""
    x, y, z, w = quaternion_xyzw
    length = hypot(x, y, z, w)
    if not isfinite(length + sum(map(abs, position))):
        raise MessageRejected("position or orientation is not finite", nan=True)
    if length < 1e-6:
        raise MessageRejected("expected an orientation, got a quaternion of length 0")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), position[0]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), position[1]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), position[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _vision(message: Any, frames: Mapping[str, str]) -> PoseMeasurement:
    with_covariance = hasattr(message.pose, "covariance")
    T = _pose(message.pose.pose if with_covariance else message.pose)
    covariance = (
        np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6) if with_covariance else None
    )
    if covariance is not None and not np.isfinite(covariance).all():
        raise MessageRejected("covariance is not finite", nan=True)
    if covariance is not None and not covariance.any():
        covariance = None  # what drivers send that do not know it
    named = message.header.frame_id.lstrip("/")
    for role in VISION_FRAMES:
        if frames.get(role, "").lstrip("/") == named:
            try:
                return PoseMeasurement(T, role, covariance)
            except InvalidInput as error:
                raise MessageRejected(str(error)) from None
    known = ", ".join(f"{frames[role]!r} ({role})" for role in VISION_FRAMES if role in frames)
    raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {known}")


def _truth(message: Any, frames: Mapping[str, str]) -> Array:
    vision = _vision(message, frames)
    if vision.frame != "palm":
        raise MessageRejected(
            f"expected the truth in the palm ({frames.get('palm')!r}), got it in the {vision.frame}"
        )
    return vision.T_frame_object


def link(message: Any) -> FrameTransform:
    """The transform of a TransformStamped; raises MessageRejected."""
    p, q = message.transform.translation, message.transform.rotation
    parent, child = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
    try:
        return FrameTransform(parent, child, transform((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    except MessageRejected as rejected:
        raise MessageRejected(f"transform to {child[:60]!r}: {rejected}", nan=rejected.nan) from None


def _lens(message: Any, _: Mapping[str, str]) -> CameraIntrinsics:
    K = np.array(message.K if hasattr(message, "K") else message.k, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(K).all():
        raise MessageRejected("intrinsics are not finite", nan=True)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise MessageRejected("expected focal lengths above 0, got an uncalibrated camera")
    return CameraIntrinsics(K, (int(message.width), int(message.height)))


READERS: dict[Role, Callable[[Any, Mapping[str, str]], Any]] = {
    "joints": _joints,
    "wrench": _wrench,
    "vision": _vision,
    "truth": _truth,
    "color": lambda message, _: images.color(message),
    "depth": lambda message, _: images.depth(message),
    "info": _lens,
}
