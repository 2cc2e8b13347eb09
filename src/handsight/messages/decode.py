"""ROS messages to measurements, the parts of an `Observation`: joints, wrenches and transforms by the fast readers, all
others by rosbags."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import import_module
from math import hypot, inf, isfinite
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight.checks import MAX_DISTANCE, MAX_LOAD, Array
from handsight.errors import InvalidInput, needing
from handsight.messages import images
from handsight.messages.contacts import contact, contacts
from handsight.messages.definitions import definitions
from handsight.messages.detections import KINDS, detections
from handsight.messages.fast import OTHER_BYTES, FastReader, StampedTransform
from handsight.messages.joints import joints_along, positions
from handsight.messages.paths import time_along
from handsight.messages.taxels import readings
from handsight.messages.topics import MessageRejected, RawMessage, Role, RosMessage, RosType, TopicReport
from handsight.observation import VISION_FRAMES, PoseMeasurement

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IDL = "=" * 80 + "\nIDL: "
"""What is before each definition in IDL, as recorders of ROS 2 write them one after the other."""
FAST = frozenset((RosType.JOINTS, RosType.WRENCH, RosType.TF, RosType.TF_ROS1))
"""The types of messages that `fast` reads."""
MAX_DEFINITION = 1 << 16  # length of the longest definition of a type that is read [characters]


@dataclass(slots=True, eq=False)
class Measurement:
    """The content of one message, or of a part of it: a transform of /tf, a finger, or a tactile surface."""

    topic: TopicReport  # the report in which the message is counted
    stamp: float  # the message's own stamp; after `Clocks`, in the clock of the joint states [s]
    log_time: float  # when it was recorded or received [s]
    value: Any
    """By the topic's role. joints: positions by name. wrench: (6,). contact: `ContactMeasurement` or None. skin: the
    readings. vision: `PoseMeasurement`. truth: (4, 4). color, depth, mask: image. detections: `Detection2D`s.
    info: `Camera`. tf: parent, child, `T_parent_child` (4, 4)."""
    part: str = (
        ""  # the finger of a wrench or a contact, the tactile surface, the names of joints or of frames
    )
    restarts: bool = False
    """Whether it is the first measurement of all, or the first after the clock of the joint states was set back."""
    of_taxels: bool = False
    """Whether it is of a tactile surface, which may be in a message of joint states."""

    @property
    def role(self) -> Role:
        """What it measures."""
        return "skin" if self.of_taxels else self.topic.role

    @property
    def size(self) -> int:
        """Its approximate size [bytes]."""
        return 500 + (self.value.nbytes if self.topic.role in ("color", "depth", "mask") else 0)


class Part(NamedTuple):
    """A part of a message that is a measurement on its own, and can be used or not."""

    stamp: float  # its own, 0 where it has none [s]
    read: Callable[[], Any]
    """Returns the measurement's value; raises MessageRejected or InvalidInput."""
    name: str = ""  # as of a measurement's part
    about: str = ""  # what a reason to reject it begins with
    of_taxels: bool = False  # whether it is a tactile surface's


def decode(
    raw: RawMessage,
    topic: TopicReport,
    frames: Mapping[str, str],
    fast: Mapping[str, FastReader],
) -> list[Measurement]:
    """Returns the measurements in a message: none, one, or one for each transform of /tf, finger or tactile surface.

    Each is counted as a message of the topic; what cannot be used is counted with its reason. `frames`: the frame ids
    of world, palm and camera. `fast`: a reader for each encoding, to be kept from message to message; without one,
    joints, wrenches and transforms cannot be read. Raises MissingExtra.
    """
    found = list[Measurement]()
    try:
        parts = _parts(raw, topic, frames, fast.get(raw.encoding))
    except (MessageRejected, InvalidInput) as error:
        topic.messages += 1
        topic.reject(str(error), nan=False)
        return found
    for stamp, read, name, about, of_taxels in parts:
        topic.messages += 1
        try:
            value = read()
            found.append(Measurement(topic, stamp, raw.log_time, value, name, of_taxels=of_taxels))
        except (MessageRejected, InvalidInput) as error:
            topic.reject(f"{about}{error}", nan=getattr(error, "nan", False))
    return found


def _parts(
    raw: RawMessage, topic: TopicReport, frames: Mapping[str, str], reader: FastReader | None
) -> list[Part]:
    """Returns the parts of a message that are measurements; raises MessageRejected, MissingExtra."""
    role = topic.role
    if not topic.accepts(raw):
        came = raw.type or "no type"
        came += (
            ", whose definition did not come: record as MCAP, source its package, or set topics.messages"
            if topic.any_defined
            else ""
        )
        raise MessageRejected(f"expected {' or '.join(topic.expected)}, got {came}")
    if reader and raw.type in FAST and not topic.any_defined:
        try:
            return _fast_parts(raw.data, topic, reader)
        except OTHER_BYTES:
            came = f"{len(raw.data)} bytes that are none"
            raise MessageRejected(f"expected a {raw.type}, got {came}") from None
    message = deserialized(raw)
    # A message without a header has stamp 0, and gets its log time later.
    stamp = _seconds(message) if hasattr(message, "header") else 0.0
    if role in ("joints", "skin"):
        return [*_joints_part(message, stamp, topic), *_taxel_parts(message, stamp, topic)]
    if role == "contact":
        stamp = stamp or max(map(_seconds, getattr(message, "contacts", ())), default=0.0)
        palm = frames["palm"]
        touched = contacts(message, topic.tips)
        return [Part(stamp, partial(contact, each, topic.tips[f], palm), f) for f, each in touched]
    if role in ("vision", "truth"):
        return [Part(stamp, partial(_pose, message, role, frames))]
    return [Part(stamp, partial(READERS[role], message), topic.finger)]


def _joints_part(message: RosMessage, stamp: float, topic: TopicReport) -> list[Part]:
    """Returns the part of the joints' positions at the rig's path, if there is one; raises MessageRejected."""
    reading = topic.joints
    if reading is None:
        return []
    names, given = joints_along(message, reading)
    stamp = stamp or time_along(message, reading.field)
    return [Part(stamp, partial(positions, names, given, reading), " ".join(names))]


def _taxel_parts(message: RosMessage, stamp: float, topic: TopicReport) -> list[Part]:
    """Returns the parts of a topic's tactile surfaces."""
    found = list[Part]()
    for source in topic.surfaces:
        time = stamp or time_along(message, source.field)
        read = partial(readings, message, source)
        found.append(Part(time, read, source.name, f"skin {source.name}: ", of_taxels=True))
    return found


def _fast_parts(data: bytes, topic: TopicReport, reader: FastReader) -> list[Part]:
    """Returns the parts of a JointState, a WrenchStamped or a TFMessage; raises one of `OTHER_BYTES`."""
    if topic.role == "joints":
        stamp, names, given = reader.joints(data)
        return [Part(stamp, partial(positions, names, given, topic.joints), " ".join(names))]
    if topic.role == "wrench":
        stamp, values = reader.wrench(data)
        return [Part(stamp, partial(_wrench, values), topic.finger)]
    found = list[Part]()
    for each in reader.transforms(data):
        about = f"transform to {each.child[:60]!r}: "
        found.append(Part(each.stamp, partial(_transform, each), f"{each.parent} {each.child}", about))
    return found


def _transform(given: StampedTransform) -> tuple[str, str, Array]:
    """Returns the parent, the child and `T_parent_child`."""
    return given.parent.lstrip("/"), given.child.lstrip("/"), _rigid_transform(*given.numbers)


def deserialized(raw: RawMessage) -> RosMessage:
    """Returns the message as rosbags decodes it; raises MessageRejected, MissingExtra."""
    store = typestore(raw.encoding)
    reason = ""
    if raw.definition and (raw.type in definitions("both") or raw.type not in store.types):
        store = defined(raw.encoding, raw.type, raw.definition)  # its own, if it is no type of ROS itself
    for layout in KINDS[raw.encoding] if raw.type == RosType.DETECTIONS else (raw.type,):
        try:
            message: RosMessage = getattr(store, f"deserialize_{raw.encoding}")(raw.data, layout)
            return message
        except Exception as error:  # rosbags' generated code raises anything: the bytes are no such message
            reason = reason or str(error)[:80]
    raise MessageRejected(f"expected a {raw.type}, got {len(raw.data)} bytes that are none ({reason})")


@lru_cache(64)
def defined(encoding: str, kind: str, definition: str) -> "Typestore":
    """Returns rosbags' types with one that a definition gives, and those it is made of; raises MessageRejected."""
    typesys = rosbags_module("rosbags.typesys")
    if len(definition) > MAX_DEFINITION:
        raise MessageRejected(f"expected a definition of {kind} within {MAX_DEFINITION} characters")
    store = _types_of_ros(encoding)
    types = dict[str, Any]()
    try:
        if definition.startswith(IDL):  # of the type, and of each that it is made of
            for each in re.split(f"{IDL}.*", definition)[1:]:
                types |= typesys.get_types_from_idl(each)
        else:
            types |= typesys.get_types_from_msg(definition, kind)
        store.register({name: each for name, each in types.items() if name not in store.types})
    except Exception as error:  # a parser that raises anything: the text is no definition
        came = f"one that is none ({str(error)[:80]})"
        raise MessageRejected(f"expected a definition of {kind}, got {came}") from None
    return store


@lru_cache
def typestore(encoding: str) -> "Typestore":
    """Returns the known message types for an encoding, `cdr` or `ros1`; raises MessageRejected, MissingExtra."""
    store = _types_of_ros(encoding)
    types = dict[str, Any]()
    for kind, definition in (definitions("both") | definitions(encoding)).items():
        types |= rosbags_module("rosbags.typesys").get_types_from_msg(definition, kind)
    store.register({kind: each for kind, each in types.items() if kind not in store.types})
    return store


def _types_of_ros(encoding: str) -> "Typestore":
    """Returns rosbags' message types for an encoding; raises MessageRejected, MissingExtra."""
    typesys = rosbags_module("rosbags.typesys")
    stores = {"cdr": typesys.Stores.ROS2_HUMBLE, "ros1": typesys.Stores.ROS1_NOETIC}
    if encoding not in stores:
        raise MessageRejected(f"expected messages encoded as cdr or ros1, got {encoding[:20]!r}")
    store: Typestore = typesys.get_typestore(stores[encoding])
    return store


def rosbags_module(name: str) -> ModuleType:
    """Returns a module of rosbags or mcap, or of a package that they require; raises MissingExtra."""
    with needing("recordings need rosbags and mcap", "robot"):
        return import_module(name)


def _seconds(message: RosMessage) -> float:
    """Returns the stamp in a message's header [s]."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _xyz(vector: RosMessage) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _wrench(values: Sequence[float]) -> Array:
    """Returns (6,) force [N] and torque [N m]."""
    _check_within(values, MAX_LOAD, "a force [N] and torque [N m]")
    return np.array(values)


def _check_within(numbers: Sequence[float], limit: float, what: str) -> None:
    """Raises MessageRejected for a number that is not finite, or beyond a limit."""
    if not hypot(*numbers) <= limit:
        for number in numbers:
            if not abs(number) <= limit:
                nan = not isfinite(number)
                raise MessageRejected(f"expected {what} within {limit:g}, got {number:g}", nan=nan)


def _rigid_transform(*numbers: float) -> Array:
    """Returns a pose (4, 4) from x, y, z [m] and a quaternion's x, y, z, w. Plain floats, because NumPy takes ten times
    as long for one pose."""
    px, py, pz, x, y, z, w = numbers
    _check_within(numbers[:3], MAX_DISTANCE, "a position [m]")
    length = hypot(x, y, z, w)
    if not 1e-6 <= length < inf:
        nan = not isfinite(length)
        raise MessageRejected(f"expected an orientation, got a quaternion of length {length:g}", nan=nan)
    x = x / length
    y = y / length
    z = z / length
    w = w / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def _pose(message: RosMessage, role: Role, frames: Mapping[str, str]) -> PoseMeasurement | Array:
    """Returns a pose of vision or, on the topic of the truth, `T_palm_object` (4, 4)."""
    pose = message.pose
    covariance = None
    if hasattr(pose, "covariance"):
        covariance = np.array(pose.covariance, dtype=np.float64).reshape(6, 6)
        pose = pose.pose
        if not np.isfinite(covariance).all():
            raise MessageRejected("covariance is not finite", nan=True)
        if not covariance.any():
            covariance = None  # drivers that do not know it send zeros
    T = _rigid_transform(*_xyz(pose.position), *_xyz(pose.orientation), pose.orientation.w)
    named = message.header.frame_id.lstrip("/")
    frame = next((each for each in VISION_FRAMES if frames[each].lstrip("/") == named), None)
    if frame is None:
        known = ", ".join(f"{frames[each]!r} ({each})" for each in VISION_FRAMES)
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {known}")
    if role == "vision":
        return PoseMeasurement(T, frame, covariance)
    if frame != "palm":
        raise MessageRejected(f"expected the truth in the palm ({frames['palm']!r}), got it in the {frame}")
    return T


READERS: dict[Role, Callable[[RosMessage], object]] = {
    "color": images.color,
    "depth": images.depth,
    "detections": detections,
    "mask": images.labels,
    "info": images.camera,
}
"""The function that reads a decoded message, by its topic's role; raises MessageRejected or InvalidInput."""
