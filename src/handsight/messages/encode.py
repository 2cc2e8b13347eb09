"""ROS messages, and parts of them, built from stamps, poses and arrays for rosbags to serialise (ROS 1 and ROS 2)."""

import math
from types import SimpleNamespace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact.taxels import TactileSurface
from handsight.errors import InvalidInput
from handsight.observation import ContactMeasurement


class Message(SimpleNamespace):
    """A ROS message, or a part of one, with its fields as attributes."""


def split_stamp(stamp: float) -> tuple[int, int]:
    """Returns the seconds and nanoseconds of a stamp [s]; raises InvalidInput for one that a message cannot hold."""
    latest = float(2**31)
    if not 0 <= stamp < latest:
        raise InvalidInput(f"stamp: expected seconds from 0 to {latest:.0f}, got {stamp}")
    # Whole seconds are split off first: 1.7e9 s in nanoseconds has more digits than a float.
    sec = math.floor(stamp)
    nanosec = round((stamp - sec) * 1e9)
    return (sec + 1, 0) if nanosec == 10**9 else (sec, nanosec)


def header(stamp: float, frame: str = "") -> Message:
    """Returns a std_msgs/Header of ROS 2 or, with its sequence number, of ROS 1; raises InvalidInput."""
    sec, nanosec = split_stamp(stamp)
    return Message(stamp=Message(sec=sec, nanosec=nanosec), frame_id=frame, seq=0)


def parts(names: str, values: Array) -> Message:
    """Returns a message with one number for each letter: `xyz` for a Vector3 or Point, `xyzw` for a Quaternion."""
    return Message(**dict(zip(names, values.tolist(), strict=True)))


def pose(T: Array) -> Message:
    """Returns a geometry_msgs/Pose."""
    rotation = se3.quaternion_from_rotation(T[:3, :3])
    return Message(position=parts("xyz", T[:3, 3]), orientation=parts("xyzw", rotation))


def pose_with_covariance(T: Array, covariance: Array | None) -> Message:
    """Returns a geometry_msgs/PoseWithCovariance; a covariance of None is all zero, as drivers send it."""
    flat = np.zeros(36) if covariance is None else np.asarray(covariance, dtype=np.float64).ravel()
    return Message(pose=pose(T), covariance=flat)


def transform(T: Array, stamp: float, parent: str, child: str) -> Message:
    """Returns a geometry_msgs/TransformStamped of `T_parent_child`."""
    of = pose(T)
    body = Message(translation=of.position, rotation=of.orientation)
    return Message(header=header(stamp, parent), child_frame_id=child, transform=body)


def contact_fields(contact: ContactMeasurement | None, stamp: float, palm: str) -> dict[str, object]:
    """Returns the fields of a ShadowContactStateStamped; None: nothing is touched. `palm`: its frame id."""
    zero = np.zeros(3)
    frame = ""
    force = 0.0
    point = zero
    normal = zero
    if contact is not None:
        frame = {"tip": "", "palm": palm}.get(contact.frame, contact.frame)
        force = 1.0 if contact.force is None else contact.force  # any above 0 is a touch
        point = contact.point
        normal = contact.normal
    place = {"contact_position": parts("xyz", point), "contact_normal": parts("xyz", normal)}
    unknown = {"tangential_force": parts("xyz", zero), "l_torque": 0.0}
    return {"header": header(stamp, frame), "f_normal": force, **place, **unknown}


def taxel_fields(values: Array, array: TactileSurface | None, name: str) -> dict[str, object]:
    """Returns the fields of a Float32MultiArray of a surface's readings, in its shape; raises InvalidInput."""
    if array is None:
        raise InvalidInput(f"skin[{name!r}]: expected a tactile array of the rig, got none of that name")
    data = array.reading(values, f"skin[{name!r}]").astype(np.float32)
    labels = ("rows", "columns") if data.ndim > array.components // 2 + 1 else ("taxels",)
    sides = zip((*labels, "components"), data.shape, data.strides, strict=False)
    dim = [Message(label=label, size=size, stride=step // 4 * size) for label, size, step in sides]
    data = data.ravel()
    return {"layout": Message(dim=dim, data_offset=0), "data": data}
