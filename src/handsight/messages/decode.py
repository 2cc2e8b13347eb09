"""ROS messages to measurements, the parts of an `Observation`: by the fast readers, or by rosbags where they cannot."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from math import hypot, isfinite
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight.checks import MAX_DISTANCE, MAX_LOAD, Array
from handsight.errors import InvalidInput, needing
from handsight.messages import definitions, images
from handsight.messages.contacts import contacts
from handsight.messages.detections import DEFINITIONS, KINDS, detections
from handsight.messages.fast import FastReader, StampedTransform
from handsight.messages.taxels import readings
from handsight.messages.topics import MessageRejected, RawMessage, Role, RosMessage, RosType, TopicReport
from handsight.observation import VISION_FRAMES, PoseMeasurement

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IDL = "=" * 80 + "\nIDL: "
"""What is before each definition in IDL, as recorders of ROS 2 write them one after the other."""
MAX_DEFINITION = 1 << 16  # length of the longest definition of a type that is read [characters]


@dataclass(slots=True, eq=False)
class Measurement:
    """A `Measurement` is the content of one message, or of one transform of /tf."""

    topic: TopicReport  # the report in which the message is counted
    stamp: float  # the message's own stamp; after `Clocks`, in the clock of the joint states [s]
    log_time: float  # when it was recorded or received [s]
    value: Any
    """By the topic's role. joints: positions by name. wrench: (6,). contact: `ContactMeasurement` or None. skin: the
    readings. vision: `PoseMeasurement`. truth: (4, 4). color, depth, mask: image. detections: `Detection2D`s.
    info: `Camera`. tf: parent, child, `T_parent_child` (4, 4)."""
    part: str = ""  # the finger of a wrench or a contact, or the tactile surface
    restarts: bool = False
    """Whether it is the first measurement of all, or the first after the clock of the joint states was set back."""

    @property
    def size(self) -> int:
        """Its approximate size [bytes]."""
        return 500 + (self.value.nbytes if self.topic.role in ("color", "depth", "mask") else 0)


def decode(
    raw: RawMessage,
    topic: TopicReport,
    frames: Mapping[str, str],
    fast: Mapping[str, FastReader] | None = None,
) -> list[Measurement]:
    """Returns the measurements in a message: none, one, or one for each transform of /tf, finger or tactile surface.

    Each is counted as a message of the topic; what cannot be used is counted with its reason. `frames`: the frame ids
    of world, palm and camera. `fast`: a reader for each encoding, to be kept from message to message. Raises
    MissingExtra.
    """
    role, reader = topic.role, fast.get(raw.encoding) if fast else None
    value: object
    try:
        if not topic.accepts(raw):
            came = raw.type or "no type"
            came += ", whose definition did not come: source its package" if topic.any_defined else ""
            raise MessageRejected(f"expected {' or '.join(topic.expected)}, got {came}")
        if role in ("tf", "tf_static"):
            return _transforms(raw, topic, reader)
        if reader and role == "wrench" and (wrench := reader.wrench(raw.data)):
            stamp, value = wrench[0], _wrench(wrench[1])
        elif reader and role == "joints" and (joints := reader.joints(raw.data)):
            stamp, value = joints[0], _positions(joints[1], joints[2])
        else:
            message = _deserialized(raw)
            # A message without a header has stamp 0, and gets its log time later.
            stamp = _seconds(message) if hasattr(message, "header") else 0.0
            if role == "skin":
                return _surfaces(raw, message, topic, stamp)
            if role == "contact":
                found = contacts(message, topic.tips, frames["palm"])
                topic.messages += len(found)
                stamp = stamp or max(map(_seconds, getattr(message, "contacts", ())), default=0.0)
                return [Measurement(topic, stamp, raw.log_time, each, finger) for finger, each in found]
            value = READERS[role](message) if role in READERS else _pose(message, role, frames)
        topic.messages += 1
        return [Measurement(topic, stamp, raw.log_time, value, topic.finger)]
    except (MessageRejected, InvalidInput) as error:
        topic.messages += 1
        topic.reject(error if isinstance(error, MessageRejected) else MessageRejected(str(error)))
        return []


def _surfaces(raw: RawMessage, message: RosMessage, topic: TopicReport, stamp: float) -> list[Measurement]:
    """Returns the readings of each tactile surface in a message; those that cannot be used are rejected."""
    found = list[Measurement]()
    for source in topic.surfaces:
        topic.messages += 1
        try:
            values, own = readings(message, source)
            found.append(Measurement(topic, stamp or own, raw.log_time, values, source.name))
        except (MessageRejected, InvalidInput) as error:
            path = f"{source.field}: " if source.field and not str(error).startswith("field ") else ""
            reason, nan = f"skin {source.name}: {path}{error}", getattr(error, "nan", False)
            topic.reject(MessageRejected(reason, nan=nan))
    return found


def _transforms(raw: RawMessage, topic: TopicReport, reader: FastReader | None) -> list[Measurement]:
    """Returns the transforms of a TFMessage; one that cannot be used is rejected, and the others are returned."""
    transforms = (reader.transforms(raw.data) if reader else None) or []
    for each in () if transforms else _deserialized(raw).transforms:
        p, q = each.transform.translation, each.transform.rotation
        frames, numbers = (each.header.frame_id, each.child_frame_id), (*_xyz(p), *_xyz(q), q.w)
        transforms.append(StampedTransform(_seconds(each), *frames, numbers))
    found = list[Measurement]()
    for each in transforms:
        topic.messages += 1
        parent, child = each.parent.lstrip("/"), each.child.lstrip("/")
        try:
            value = parent, child, _rigid_transform(*each.numbers)
            found.append(Measurement(topic, each.stamp, raw.log_time, value))
        except MessageRejected as error:
            topic.reject(MessageRejected(f"transform to {child[:60]!r}: {error}", nan=error.nan))
    return found


def _deserialized(raw: RawMessage) -> RosMessage:
    kind = RosType.TF if raw.type == RosType.TF_ROS1 else raw.type
    expected = f"expected a {kind}, got {len(raw.data)} bytes that are none"
    # The shortest message is a count. There may be many empty ones, and errors of rosbags are slow.
    if len(raw.data) < (1 if raw.type in definitions.SINGLE else 4):
        raise MessageRejected(expected)
    store, reason = typestore(raw.encoding), ""
    if raw.definition and (raw.type in definitions.DEFINITIONS or raw.type not in store.types):
        store = _defined(raw.encoding, raw.type, raw.definition)  # its own, if it is no type of ROS itself
    for layout in KINDS[raw.encoding] if raw.type == RosType.DETECTIONS else (kind,):
        try:
            message: RosMessage = getattr(store, f"deserialize_{raw.encoding}")(raw.data, layout)
            return message
        except Exception as error:  # rosbags' generated code raises anything: the bytes are no such message
            reason = reason or str(error)[:80]
    raise MessageRejected(f"{expected} ({reason})")


@lru_cache(64)
def _defined(encoding: str, kind: str, definition: str) -> "Typestore":
    """Returns rosbags' types with one that a definition gives, and those it is made of; raises MessageRejected."""
    typesys = rosbags_module("rosbags.typesys")
    if len(definition) > MAX_DEFINITION:
        raise MessageRejected(f"expected a definition of {kind} within {MAX_DEFINITION} characters")
    store: Typestore = typesys.get_typestore(_stores()[encoding])
    try:
        if definition.startswith(IDL):  # of the type, and of each that it is made of
            found = [typesys.get_types_from_idl(each) for each in re.split(f"{IDL}.*", definition)[1:]]
            types = {name: each for part in found for name, each in part.items()}
        else:
            types = typesys.get_types_from_msg(definition, kind)
        store.register({name: each for name, each in types.items() if name not in store.types})
    except Exception as error:  # a parser that raises anything: the text is no definition
        came = f"one that is none ({str(error)[:80]})"
        raise MessageRejected(f"expected a definition of {kind}, got {came}") from None
    return store


@lru_cache
def typestore(encoding: str) -> "Typestore":
    """Returns rosbags' message types for an encoding, `cdr` or `ros1`; raises MessageRejected, MissingExtra."""
    typesys = rosbags_module("rosbags.typesys")
    if encoding not in _stores():
        raise MessageRejected(f"expected messages encoded as cdr or ros1, got {encoding[:20]!r}")
    store: Typestore = typesys.get_typestore(_stores()[encoding])
    if RosType.TF not in store.types:  # ROS 1's own messages have only its predecessor
        store.register(typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", RosType.TF))
    for kind, definition in (DEFINITIONS[encoding] | definitions.DEFINITIONS).items():
        store.register(typesys.get_types_from_msg(definition, kind))
    return store


def _stores() -> dict[str, Any]:
    """Returns rosbags' sets of types, by encoding; raises MissingExtra."""
    stores = rosbags_module("rosbags.typesys").Stores
    return {"cdr": stores.ROS2_HUMBLE, "ros1": stores.ROS1_NOETIC}


def rosbags_module(name: str) -> ModuleType:
    """Returns a module of rosbags, or of a package that rosbags requires; raises MissingExtra."""
    with needing("recordings need rosbags", "robot"):
        return import_module(name)


def _seconds(message: RosMessage) -> float:
    """Returns the stamp in a message's header [s]."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _xyz(vector: RosMessage) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _positions(names: Sequence[str], positions: Sequence[float]) -> dict[str, float]:
    """Returns the positions of a JointState by joint name [rad or m]."""
    if len(names) != len(positions):
        raise MessageRejected(f"expected as many positions as names, got {len(positions)} for {len(names)}")
    found = dict(zip(names, positions, strict=True))
    if len(found) != len(names):
        raise MessageRejected("expected each joint once, got one name twice")
    limit = 1e6  # [rad or m]; large, as wheels turn far
    if not hypot(*positions) <= limit:
        if bad := [name for name, position in found.items() if not isfinite(position)]:
            raise MessageRejected(f"joint {', '.join(bad[:5])} is not a finite number", nan=True)
        name = max(found, key=lambda name: abs(found[name]))
        if abs(found[name]) > limit:
            raise MessageRejected(f"joint {name}: expected a position within {limit:g}, got {found[name]:g}")
    return found


def _wrench(values: Sequence[float]) -> Array:
    """Returns (6,) force [N] and torque [N m]."""
    if not hypot(*values) <= MAX_LOAD:
        if not all(map(isfinite, values)):
            raise MessageRejected("force or torque is not finite", nan=True)
        if (most := max(map(abs, values))) > MAX_LOAD:
            raise MessageRejected(f"expected a force and torque within {MAX_LOAD:g} N and N m, got {most:g}")
    return np.array(values)


def _rigid_transform(*numbers: float) -> Array:
    """Returns a pose (4, 4) from x, y, z [m] and a quaternion's x, y, z, w. Plain floats, because NumPy takes ten times
    as long for one pose."""
    px, py, pz, x, y, z, w = numbers
    length = hypot(x, y, z, w)
    if not isfinite(length + abs(px) + abs(py) + abs(pz)):
        raise MessageRejected("position or orientation is not finite", nan=True)
    if (far := max(abs(px), abs(py), abs(pz))) > MAX_DISTANCE:
        raise MessageRejected(f"expected a position within {MAX_DISTANCE:g} m, got {far:g}")
    if length < 1e-6:
        raise MessageRejected("expected an orientation, got a quaternion of length 0")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def _pose(message: RosMessage, role: Role, frames: Mapping[str, str]) -> PoseMeasurement | Array:
    """Returns a pose of vision or, on the topic of the truth, `T_palm_object` (4, 4)."""
    pose, covariance = message.pose, None
    if hasattr(pose, "covariance"):
        covariance, pose = np.array(pose.covariance, dtype=np.float64).reshape(6, 6), pose.pose
    T = _rigid_transform(*_xyz(pose.position), *_xyz(pose.orientation), pose.orientation.w)
    if covariance is not None and not np.isfinite(covariance).all():
        raise MessageRejected("covariance is not finite", nan=True)
    if covariance is not None and not covariance.any():
        covariance = None  # drivers that do not know it send zeros
    named = message.header.frame_id.lstrip("/")
    roles = {frames[role].lstrip("/"): role for role in reversed(VISION_FRAMES) if role in frames}
    if named not in roles:
        known = ", ".join(f"{frames[role]!r} ({role})" for role in VISION_FRAMES if role in frames)
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {known}")
    measured = PoseMeasurement(T, roles[named], covariance)
    if role != "truth":
        return measured
    if measured.frame != "palm":
        palm = frames.get("palm")
        raise MessageRejected(f"expected the truth in the palm ({palm!r}), got it in the {measured.frame}")
    return measured.T_frame_object


READERS: dict[Role, Callable[[RosMessage], object]] = {
    "joints": lambda message: _positions(message.name, message.position.tolist()),
    "wrench": lambda message: _wrench((*_xyz(message.wrench.force), *_xyz(message.wrench.torque))),
    "color": images.color,
    "depth": images.depth,
    "detections": detections,
    "mask": images.labels,
    "info": images.camera,
}
"""The function that reads a decoded message, by its topic's role; raises MessageRejected or InvalidInput."""
