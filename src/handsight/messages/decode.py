"""Messages to measurements, the parts of an `Observation`: joints, wrenches, transforms, touch, poses and images."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, inf, isfinite, sin
from typing import Any, NamedTuple

import numpy as np

from handsight.checks import MAX_DISTANCE, MAX_LOAD, Array
from handsight.contact.taxels import PIXELS, block
from handsight.errors import InvalidInput
from handsight.messages import images
from handsight.messages.paths import at, beside, numbers, time_along
from handsight.messages.read import OTHER_BYTES, FastReader, StampedTransform, deserialized
from handsight.messages.report import TopicReport
from handsight.messages.topics import (
    MessageRejected,
    RawMessage,
    Role,
    RosMessage,
    RosType,
    TaxelSource,
    Topic,
)
from handsight.observation import VISION_FRAMES, ContactMeasurement, Detection2D, PoseMeasurement
from handsight.rig.rig import JointReading

FAST = frozenset((RosType.JOINTS, RosType.WRENCH, RosType.TF, RosType.TF_ROS1))
"""The types of messages that a `FastReader` reads."""
MAX_POSITION = 1e6
"""Of a joint [rad or m]; large, as wheels turn far."""
MAX_DETECTIONS = 1000
"""Detections of a message that are used."""


@dataclass(slots=True, eq=False)
class Measurement:
    """The content of one message, or of a part of it: a transform of /tf, a finger, or a tactile surface."""

    report: TopicReport
    """Where the message is counted."""
    stamp: float
    """The message's own, 0 where it has none; from the order on, in the clock of the joint states [s]."""
    log_time: float  # when it was recorded or received [s]
    value: Any
    """By role. joints: positions by name. wrench: (6,). contact: `ContactMeasurement` or None. skin: the readings.
    vision: `PoseMeasurement`. truth: (4, 4). color, depth, mask: image. detections: `Detection2D`s. info: `Camera`. tf:
    parent, child, `T_parent_child` (4, 4)."""
    role: Role
    """What it measures: what its topic is for, but `skin` for a surface's readings in a message of joint states."""
    part: str = ""
    """The finger of a wrench or a contact, the tactile surface, the names of joints or of frames."""
    restarts: bool = False
    """Whether it is the first measurement of all, or the first after the clock of the joint states was set back."""

    @property
    def size(self) -> int:
        """Its approximate size [bytes]."""
        return 500 + (self.value.nbytes if self.role in ("color", "depth", "mask") else 0)


class Part(NamedTuple):
    """A part of a message that is a measurement on its own, and can be used or not."""

    stamp: float  # its own, 0 where it has none [s]
    read: Callable[[], Any]
    """Returns the measurement's value; raises MessageRejected or InvalidInput."""
    role: Role
    name: str = ""  # as of a measurement's part
    about: str = ""  # what a reason to reject it begins with


def decode(
    raw: RawMessage, report: TopicReport, frames: Mapping[str, str], fast: Mapping[str, FastReader]
) -> list[Measurement]:
    """Returns the measurements in a message: none, one, or one for each transform of /tf, finger or tactile surface.

    Each is counted as a message of the topic; what cannot be used is counted with its reason. `frames`: the frame ids
    of world, palm and camera. `fast`: a reader for each encoding, to be kept from message to message. Raises
    MissingExtra.
    """
    found = list[Measurement]()
    try:
        parts = _parts(raw, report.topic, frames, fast.get(raw.encoding))
    except (MessageRejected, InvalidInput) as error:
        report.messages += 1
        report.reject(str(error))
        return found
    for stamp, read, role, name, about in parts:
        report.messages += 1
        try:
            found.append(Measurement(report, stamp, raw.log_time, read(), role, name))
            report.found(name)
        except (MessageRejected, InvalidInput) as error:
            report.reject(f"{about}{error}", nan=getattr(error, "nan", False))
    return found


def _parts(raw: RawMessage, topic: Topic, frames: Mapping[str, str], reader: FastReader | None) -> list[Part]:
    """Returns the parts of a message that are measurements; raises MessageRejected, MissingExtra."""
    if not topic.accepts(raw):
        came = raw.type or "no type"
        if topic.any_defined:
            came += (
                ", whose definition did not come: record as MCAP, source its package, or set topics.messages"
            )
        raise MessageRejected(f"expected {' or '.join(topic.expected)}, got {came}")
    if reader and raw.type in FAST and not topic.any_defined:
        try:
            return _fast_parts(raw.data, topic, reader)
        except OTHER_BYTES:
            came = f"{len(raw.data)} bytes that are none"
            raise MessageRejected(f"expected a {raw.type}, got {came}") from None
    message = deserialized(raw)
    stamp = _seconds(message) if hasattr(message, "header") else 0.0
    role = topic.role
    if role in ("joints", "skin"):
        return [*_joints_part(message, stamp, topic), *_taxel_parts(message, stamp, topic)]
    if role == "contact":
        stamp = stamp or max(map(_seconds, getattr(message, "contacts", ())), default=0.0)
        palm = frames["palm"]
        touched = contacts(message, topic.tips)
        return [Part(stamp, partial(contact, each, topic.tips[f], palm), role, f) for f, each in touched]
    if role in ("vision", "truth"):
        return [Part(stamp, partial(_pose, message, role, frames), role)]
    return [Part(stamp, partial(READERS[role], message), role)]


def _fast_parts(data: bytes, topic: Topic, reader: FastReader) -> list[Part]:
    """Returns the parts of a JointState, a WrenchStamped or a TFMessage; raises one of `OTHER_BYTES`."""
    role = topic.role
    if role == "joints":
        stamp, names, given = reader.joints(data)
        return [Part(stamp, partial(positions, names, given, topic.joints), role, " ".join(names))]
    if role == "wrench":
        stamp, values = reader.wrench(data)
        return [Part(stamp, partial(_wrench, values), role, topic.finger)]
    return [
        Part(
            each.stamp,
            partial(_transform, each),
            role,
            f"{each.parent} {each.child}",
            f"transform to {each.child[:60]!r}: ",
        )
        for each in reader.transforms(data)
    ]


def _joints_part(message: RosMessage, stamp: float, topic: Topic) -> Iterator[Part]:
    """Yields the part of the joints' positions at the rig's path, if there is one; raises MessageRejected."""
    reading = topic.joints
    if reading is not None:
        names, given = joints_along(message, reading)
        stamp = stamp or time_along(message, reading.field)
        yield Part(stamp, partial(positions, names, given, reading), "joints", " ".join(names))


def _taxel_parts(message: RosMessage, stamp: float, topic: Topic) -> Iterator[Part]:
    """Yields the parts of a topic's tactile surfaces."""
    for source in topic.surfaces:
        time = stamp or time_along(message, source.field)
        read = partial(readings, message, source)
        yield Part(time, read, "skin", source.name, f"skin {source.name}: ")


def _seconds(message: RosMessage) -> float:
    """Returns the stamp in a message's header [s]."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _xyz(vector: RosMessage) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _check_within(values: Sequence[float], limit: float, what: str) -> None:
    """Raises MessageRejected for a number that is not finite, or beyond a limit."""
    if hypot(*values) <= limit:
        return
    for number in values:
        if not abs(number) <= limit:
            nan = not isfinite(number)
            raise MessageRejected(f"expected {what} within {limit:g}, got {number:g}", nan=nan)


def joints_along(message: RosMessage, reading: JointReading) -> tuple[Sequence[str], Sequence[float]]:
    """Returns the names of the joints in a message, none where the rig has them, and the numbers of their positions.

    Raises MessageRejected, InvalidInput.
    """
    found, sizes = numbers(at(message, reading.field))
    if len(sizes) > 1:
        raise MessageRejected(f"expected positions in a row, got {' x '.join(map(str, sizes))} numbers")
    if reading.names:
        return (), found.tolist()
    path = beside(reading.field, "name")
    try:
        names = [str(name) for name in at(message, path)]
    except (InvalidInput, TypeError):
        expected = "expected topics.joint_states.names in the rig"
        raise MessageRejected(f"{expected}, as the message has no names at {path}") from None
    return names, found.tolist()


def positions(
    names: Sequence[str], given: Sequence[float], reading: JointReading | None = None
) -> Mapping[str, float]:
    """Returns the positions of joints by name [rad or m]; raises MessageRejected.

    `given`: the numbers as published. `reading`: what these are, and the names in place of the message's own; None:
    positions of a JointState.
    """
    known: Sequence[str | None] = names
    if reading is not None and reading.names:
        known = reading.names
    if len(known) != len(given):
        raise MessageRejected(f"expected as many positions as names, got {len(given)} for {len(known)}")
    if reading is not None and reading.converts:
        given = (np.asarray(reading.scale) * (np.asarray(given) - reading.offset)).tolist()
    pairs = zip(known, given, strict=True)
    found = {name: position for name, position in pairs if name is not None}
    if len(found) != len(known) - known.count(None):
        raise MessageRejected("expected each joint once, got one name twice")
    if not hypot(*found.values()) <= MAX_POSITION:
        for name, position in found.items():
            _check_within((position,), MAX_POSITION, f"a position of joint {name}")
    return found


def _wrench(values: Sequence[float]) -> Array:
    """Returns (6,) force [N] and torque [N m]."""
    _check_within(values, MAX_LOAD, "a force [N] and torque [N m]")
    return np.array(values)


def _transform(given: StampedTransform) -> tuple[str, str, Array]:
    """Returns the parent, the child and `T_parent_child`."""
    return given.parent.lstrip("/"), given.child.lstrip("/"), _rigid_transform(*given.numbers)


def _rigid_transform(*given: float) -> Array:
    """Returns a pose (4, 4) from x, y, z [m] and a quaternion's x, y, z, w. Plain floats, because NumPy takes ten times
    as long for one pose."""
    px, py, pz, x, y, z, w = given
    _check_within(given[:3], MAX_DISTANCE, "a position [m]")
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


def readings(message: RosMessage, source: TaxelSource) -> Array:
    """Returns a surface's readings, NaN where a taxel has no finite one.

    The numbers are in the order of the surface's taxels, of a grid row by row from its corner at -x, -y. Raises
    MessageRejected, InvalidInput.
    """
    value = at(message, source.field)
    if hasattr(value, "sensors"):  # a TactileState
        value = at(value, f"sensors[name={source.name}]")
    found, sizes = numbers(value)
    expected = f"expected {' x '.join(map(str, source.shape))} taxels"
    if source.indentation:
        expected += f", or an image with {PIXELS}"
    if source.indentation and block(sizes, source.shape) is not None:
        source = source._replace(shape=sizes)
    # A list of vectors is of the taxels one after the other, those of a grid too, and so is an image of a bent gel.
    allowed = source.shape, (math.prod(source.shape[:-1]), source.shape[-1])
    bent = source.indentation and len(source.shape) == 1
    if len(sizes) > 1 and sizes not in allowed and not bent:
        raise MessageRejected(f"{expected}, got {' x '.join(map(str, sizes))}")
    if not found.size:
        why = "as drivers send them without a calibration of the sensor"
        raise MessageRejected(f"{expected}, got none, {why}")
    if found.size != math.prod(source.shape):
        raise MessageRejected(f"{expected}, got {found.size} numbers")
    found = np.where(np.isfinite(found), found, np.nan).reshape(source.shape)
    if np.isnan(found).all():
        raise MessageRejected("no taxel has a finite reading", nan=True)
    return found


def contacts(message: RosMessage, tips: Mapping[str, str]) -> list[tuple[str, RosMessage | None]]:
    """Returns the parts of a message that say where fingers are touched, by finger; None: the finger touches nothing.

    `tips`: the body that each finger's tip moves with. A message about one contact is of the only finger there is; of
    several contacts, and several fingers, each is of the finger whose name or body it names. Raises MessageRejected.
    """
    if hasattr(message, "contacts"):
        named = {_finger(each, tips): each for each in message.contacts}
        return [(finger, named.get(finger)) for finger in tips]
    finger = _finger(message, tips) if len(tips) > 1 else next(iter(tips))
    if not finger:
        names = ", ".join(sorted({*tips, *tips.values()}))
        raise MessageRejected(f"expected the name or frame of a finger on this topic ({names}), got none")
    return [(finger, message)]


def _finger(message: RosMessage, tips: Mapping[str, str]) -> str:
    """Returns the finger that a contact is of, by its name or its frame; empty: of none."""
    names = {getattr(message, "name", ""), message.header.frame_id.lstrip("/")}
    return next((finger for finger, body in tips.items() if names & {finger, body}), "")


def contact(message: RosMessage | None, tip: str, palm: str) -> ContactMeasurement | None:
    """Returns one contact; its vectors are in the fingertip's frame if the header names none.

    The message is one of Shadow, tactile_msgs, or its_msgs (in millimetres). `tip`: the body that the tip moves with.
    `palm`: the palm's frame id. Raises MessageRejected, InvalidInput.
    """
    if message is None:
        return None
    if hasattr(message, "PoC"):  # its_msgs
        point = 1e-3 * np.array(_xyz(message.PoC))
        normal = np.array(_xyz(message.n))
        force = float(message.Fn)
    elif hasattr(message, "wrench"):  # tactile_msgs: its force is in the same frame as the normal
        point = np.array(_xyz(message.position))
        normal = np.array(_xyz(message.normal))
        along = abs(float(np.dot(normal, _xyz(message.wrench.force))))
        length = float(np.linalg.norm(normal))
        force = along / max(length, 1e-12)
    else:
        point = np.array(_xyz(message.contact_position))
        normal = np.array(_xyz(message.contact_normal))
        force = float(message.f_normal)
    if not np.isfinite([*point, *normal, force]).all():
        raise MessageRejected("position, normal or force is not finite", nan=True)
    named = message.header.frame_id.lstrip("/")
    frame = {"": "tip", palm.lstrip("/"): "palm", tip: tip}.get(named)
    if frame is None:
        valid = f"none (the tip's own), {tip!r}, {palm!r}"
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {valid}")
    if force <= 0 or not normal.any():
        return None
    return ContactMeasurement(point, normal, frame, force)


def detections(message: RosMessage) -> tuple[Detection2D, ...]:
    """Returns the detections of a Detection2DArray of ROS 1, Foxy, or later: one for each hypothesis of what is in a
    box. Raises MessageRejected, InvalidInput."""
    found = list[Detection2D]()
    for k, each in enumerate(message.detections[:MAX_DETECTIONS]):
        box = _upright_box(each.bbox, f"detection {k}")
        if not len(each.results):
            found.append(Detection2D("", None, box))
        for result in each.results:
            hypothesis = getattr(result, "hypothesis", result)
            label = result.id if hypothesis is result else hypothesis.class_id
            score = float(hypothesis.score)
            if not 0 <= score <= 1:
                raise MessageRejected(f"detection {k}: expected a score from 0 to 1, got {score:g}")
            least = 1e-6  # some detectors round a score to 0
            found.append(Detection2D(str(label), max(score, least), box))
    return tuple(found)


def _upright_box(box: RosMessage, name: str) -> tuple[float, float, float, float]:
    """Returns the upright box around a turned one [pixels]; raises MessageRejected."""
    center = getattr(box.center, "position", box.center)
    turn = box.center.theta
    width = box.size_x
    height = box.size_y
    finite = isfinite(hypot(center.x, center.y, width, height, turn))
    if not finite or min(width, height) < 0:
        came = f"{width:g} x {height:g} at {center.x:g}, {center.y:g}, turned by {turn:g}"
        raise MessageRejected(f"{name}: expected a finite box, got {came}", nan=not finite)
    c = abs(cos(turn))
    s = abs(sin(turn))
    half_u = (c * width + s * height) / 2
    half_v = (s * width + c * height) / 2
    return center.x - half_u, center.y - half_v, center.x + half_u, center.y + half_v


READERS: dict[Role, Callable[[RosMessage], object]] = {
    "color": images.color,
    "depth": images.depth,
    "detections": detections,
    "mask": images.labels,
    "info": images.camera,
}
"""The function that reads a decoded message, by its topic's role; raises MessageRejected or InvalidInput."""
