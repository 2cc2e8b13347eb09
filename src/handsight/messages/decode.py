"""ROS messages to what an `Observation` is made of; rosbags reads what the fast readers do not."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from math import hypot, isfinite
from typing import Any, NamedTuple

import numpy as np

from handsight.checks import FARTHEST, STRONGEST, Array
from handsight.errors import InvalidInput, MissingExtra
from handsight.messages import images, touch
from handsight.messages.fast import FastReaders
from handsight.messages.topics import CONTACT, TF, TF_ROS1, MessageRejected, RawMessage, Role, TopicReport
from handsight.observation import VISION_FRAMES, PoseMeasurement
from handsight.vision import PinholeCamera

MAX_JOINTS, MAX_TRANSFORMS = 1000, 10_000
"""Of one message."""
SHORTEST = 4
"""Bytes of a message that has no more than the count of nothing."""
MAX_TURNED = 1e6
"""No joint's position is larger [rad or m]; wheels turn far."""
LENSES = {"plumb_bob": 5, "rational_polynomial": 8}
"""Distortion models of CameraInfo that a pinhole behind a lens is, and how many numbers they have."""
MAX_PIXELS_ACROSS = 1e6
"""No focal length or principal point is larger [pixels]."""


class CameraIntrinsics(NamedTuple):
    """What a CameraInfo says."""

    matrix: Array
    """(3, 3) [pixels]."""
    size: tuple[int, int]
    """(width, height) [pixels]."""
    lens: Array = np.zeros(0)
    """k1, k2, p1, p2[, k3[, k4, k5, k6]]; none: images are rectified. `PinholeCamera(*intrinsics)` is the camera."""


@dataclass(slots=True, eq=False)
class Measurement:
    """What one message, or one transform of /tf, says."""

    topic: TopicReport
    """Where it is counted."""
    stamp: float
    """As the message says it; later, in the clock of the joint states [s]."""
    log_time: float
    """When it was recorded or received [s]."""
    value: Any
    """By role: dict of positions; (6,); ContactMeasurement or None; PoseMeasurement; (4, 4); image; CameraIntrinsics;
    parent, child and `T_parent_child` (4, 4)."""

    @property
    def size(self) -> int:
        """About how many bytes it holds."""
        return 500 + (self.value.nbytes if self.topic.role in ("color", "depth") else 0)


def decode(
    raw: RawMessage, topic: TopicReport, frames: Mapping[str, str], fast: FastReaders
) -> list[Measurement]:
    """What can be used of the message: nothing, one measurement, or one for each transform of /tf.

    Each is counted as a message of the topic, and so is what was rejected, with its reason. `frames`: what messages
    call world, palm and camera. `fast`: kept from message to message. Raises MissingExtra.
    """
    try:
        if raw.type not in topic.expected:
            raise MessageRejected(f"expected {' or '.join(topic.expected)}, got {raw.type or 'no type'}")
        if (found := _decode_fast(raw, topic.role, fast)) is None:
            message = _deserialized(raw)
            if topic.role in ("tf", "tf_static"):
                return _transforms(message, raw, topic)
            named = frames if topic.role != "contact" else {**frames, "tip": topic.body}
            found = _stamp(message), READERS[topic.role](message, named)
        topic.messages += 1
        return [Measurement(topic, found[0], raw.log_time, found[1])]
    except MessageRejected as error:
        topic.messages += 1
        topic.reject(error)
        return []


def _decode_fast(raw: RawMessage, role: Role, fast: FastReaders) -> tuple[float, Any] | None:
    """Stamp and value; None: rosbags must read it."""
    reader = fast.get(raw.encoding)
    if reader is None:
        return None
    if role == "wrench" and (wrench := reader.wrench(raw.data)):
        return wrench[0], _wrench(wrench[1])
    if role == "joints" and (joints := reader.joints(raw.data)):
        return joints[0], _positions(joints[1], joints[2])
    return None


def _transforms(message: Any, raw: RawMessage, topic: TopicReport) -> list[Measurement]:
    """Each transform by itself: one that cannot be used does not spoil the others."""
    found = []
    if len(message.transforms) > MAX_TRANSFORMS:
        raise MessageRejected(f"expected at most {MAX_TRANSFORMS} transforms, got {len(message.transforms)}")
    for each in message.transforms:
        topic.messages += 1
        parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
        try:
            T = _rigid_transform(each.transform.translation, each.transform.rotation)
            found.append(Measurement(topic, _stamp(each), raw.log_time, (parent, child, T)))
        except MessageRejected as error:
            topic.reject(MessageRejected(f"transform to {child[:60]!r}: {error}", nan=error.nan))
    return found


def _deserialized(raw: RawMessage) -> Any:
    store = typestore(raw.encoding)
    kind = TF if raw.type == TF_ROS1 else raw.type
    if len(raw.data) < SHORTEST:  # millions of them may come
        raise MessageRejected(f"expected a {kind}, got {len(raw.data)} bytes that are none")
    try:
        return getattr(store, f"deserialize_{raw.encoding}")(raw.data, kind)
    except Exception as error:  # code that rosbags generates raises anything: the bytes are no such message
        said = f"expected a {kind}, got {len(raw.data)} bytes that are none ({str(error)[:80]})"
        raise MessageRejected(said) from None


@lru_cache
def typestore(encoding: str) -> Any:
    """What rosbags knows of the messages so encoded, `cdr` or `ros1`; raises MessageRejected, MissingExtra."""
    typesys = rosbags_module("rosbags.typesys")
    stores = {"cdr": typesys.Stores.ROS2_HUMBLE, "ros1": typesys.Stores.ROS1_NOETIC}
    if encoding not in stores:
        raise MessageRejected(f"expected messages encoded as cdr or ros1, got {encoding[:20]!r}")
    store = typesys.get_typestore(stores[encoding])
    if TF not in store.types:  # ROS 1's own messages have only its forerunner
        store.register(typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    store.register(typesys.get_types_from_msg(touch.SHADOW_CONTACT, CONTACT))
    return store


def rosbags_module(name: str) -> Any:
    """The module of rosbags, or of what it brings, loaded when it is needed; raises MissingExtra."""
    try:
        return import_module(name)
    except ImportError:
        raise MissingExtra("recordings need rosbags: pip install 'handsight[robot]'") from None


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _positions(names: Sequence[str], positions: Sequence[float]) -> dict[str, float]:
    if len(names) != len(positions):
        raise MessageRejected(f"expected as many positions as names, got {len(positions)} for {len(names)}")
    found = dict(zip(names, positions, strict=True))
    if len(found) != len(names):
        raise MessageRejected("expected each joint once, got one name twice")
    if len(found) > MAX_JOINTS:
        raise MessageRejected(f"expected at most {MAX_JOINTS} joints, got {len(found)}")
    if not hypot(*positions) <= MAX_TURNED:
        _check_positions(found)
    return found


def _check_positions(positions: Mapping[str, float]) -> None:
    bad = [name for name, position in positions.items() if not isfinite(position)]
    if bad:
        raise MessageRejected(f"joint {', '.join(bad[:5])} is not a finite number", nan=True)
    name = max(positions, key=lambda name: abs(positions[name]))
    if abs(positions[name]) > MAX_TURNED:
        raise MessageRejected(
            f"joint {name}: expected a position within {MAX_TURNED:g}, got {positions[name]:g}"
        )


def _wrench(values: Sequence[float]) -> Array:
    """(6,)"""
    if not hypot(*values) <= STRONGEST:
        if not all(map(isfinite, values)):
            raise MessageRejected("force or torque is not finite", nan=True)
        if (most := max(map(abs, values))) > STRONGEST:
            raise MessageRejected(f"expected a force and torque within {STRONGEST:g} N and N m, got {most:g}")
    return np.array(values)


def _wrench_message(message: Any, _: Mapping[str, str]) -> Array:
    force, torque = message.wrench.force, message.wrench.torque
    return _wrench((force.x, force.y, force.z, torque.x, torque.y, torque.z))


def _rigid_transform(position: Any, orientation: Any) -> Array:
    """(4, 4); raises MessageRejected. In plain floats: for one pose NumPy is ten times slower."""
    p, x, y, z, w = position, orientation.x, orientation.y, orientation.z, orientation.w
    length = hypot(x, y, z, w)
    if not isfinite(length + abs(p.x) + abs(p.y) + abs(p.z)):
        raise MessageRejected("position or orientation is not finite", nan=True)
    if (far := max(abs(p.x), abs(p.y), abs(p.z))) > FARTHEST:
        raise MessageRejected(f"expected a position within {FARTHEST:g} m, got {far:g}")
    if length < 1e-6:
        raise MessageRejected("expected an orientation, got a quaternion of length 0")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), p.x],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), p.y],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), p.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _vision(message: Any, frames: Mapping[str, str]) -> PoseMeasurement:
    pose, covariance = message.pose, None
    if hasattr(pose, "covariance"):
        covariance, pose = np.array(pose.covariance, dtype=np.float64).reshape(6, 6), pose.pose
    T = _rigid_transform(pose.position, pose.orientation)
    if covariance is not None and not np.isfinite(covariance).all():
        raise MessageRejected("covariance is not finite", nan=True)
    if covariance is not None and not covariance.any():
        covariance = None  # what drivers send that do not know it
    named = message.header.frame_id.lstrip("/")
    roles = {frames[role].lstrip("/"): role for role in reversed(VISION_FRAMES) if role in frames}
    if named not in roles:
        known = ", ".join(f"{frames[role]!r} ({role})" for role in VISION_FRAMES if role in frames)
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {known}")
    try:
        return PoseMeasurement(T, roles[named], covariance)
    except InvalidInput as error:
        raise MessageRejected(str(error)) from None


def _truth(message: Any, frames: Mapping[str, str]) -> Array:
    pose = _vision(message, frames)
    if pose.frame != "palm":
        raise MessageRejected(
            f"expected the truth in the palm ({frames.get('palm')!r}), got it in the {pose.frame}"
        )
    return pose.T_frame_object


def _intrinsics(message: Any, _: Mapping[str, str]) -> CameraIntrinsics:
    K = np.array(message.K if hasattr(message, "K") else message.k, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(K).all():
        raise MessageRejected("intrinsics are not finite", nan=True)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise MessageRejected("expected focal lengths above 0, got an uncalibrated camera")
    if np.abs(K).max() > MAX_PIXELS_ACROSS:
        most = np.abs(K).max()
        raise MessageRejected(f"expected intrinsics within {MAX_PIXELS_ACROSS:g} pixels, got {most:g}")
    K, size = _cut(K, message)
    try:
        camera = PinholeCamera(K, size, _lens(message))
    except InvalidInput as error:
        raise MessageRejected(str(error)) from None
    return CameraIntrinsics(camera.matrix, camera.size, camera.lens)


def _lens(message: Any) -> Array:
    """The lens' numbers, none where they are all zero; raises MessageRejected for a lens of another kind."""
    model, lens = message.distortion_model, np.array(message.D if hasattr(message, "D") else message.d)
    if not np.isfinite(lens).all():
        raise MessageRejected("the lens' numbers are not finite", nan=True)
    if model not in LENSES and (model or lens.any()):
        raise MessageRejected(f"expected a distortion model {' or '.join(LENSES)}, got {model[:40]!r}")
    most = LENSES.get(model, 0)
    if lens[most:].any():
        raise MessageRejected(f"expected at most {most} numbers of a {model} lens, got {len(lens)}")
    lens = lens[:most].astype(np.float64)
    return lens if lens.any() else np.zeros(0)


def _cut(K: Array, message: Any) -> tuple[Array, tuple[int, int]]:
    """The intrinsics and the size of the images that come, cut out and binned: the message's are the whole sensor's."""
    K, roi, size = K.copy(), message.roi, [int(message.width), int(message.height)]
    for axis, (first, side, binned) in enumerate(
        ((roi.x_offset, roi.width, message.binning_x), (roi.y_offset, roi.height, message.binning_y))
    ):
        by = max(int(binned), 1)
        # Centres of pixels are at whole numbers, so the image begins at -½.
        K[axis, axis], K[axis, 2] = K[axis, axis] / by, (K[axis, 2] - first + 0.5) / by - 0.5
        size[axis] = (int(side) or size[axis]) // by
    return K, (size[0], size[1])


READERS: dict[Role, Callable[[Any, Mapping[str, str]], Any]] = {
    "joints": lambda message, _: _positions(message.name, message.position.tolist()),
    "wrench": _wrench_message,
    "contact": touch.contact,
    "vision": _vision,
    "truth": _truth,
    "color": lambda message, _: images.color(message),
    "depth": lambda message, _: images.depth(message),
    "info": _intrinsics,
}
