"""Contacts of fingertips that sense them themselves, and readings of tactile arrays, out of messages and into them.

What reads a message raises MessageRejected, or InvalidInput, where it cannot be used.
"""

from collections.abc import Mapping
from types import SimpleNamespace as Message

import numpy as np

from handsight.checks import Array
from handsight.contact.taxels import TaxelArray
from handsight.errors import InvalidInput
from handsight.messages import images
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.observation import ContactMeasurement

SHADOW_CONTACT = """\
std_msgs/Header header
geometry_msgs/Vector3 tangential_force
geometry_msgs/Point contact_position
geometry_msgs/Vector3 contact_normal
float64 f_normal
float64 l_torque
"""
"""ShadowContactStateStamped; its vectors are in the core of the fingertip, unless the header names a frame."""
ENCODINGS = ("mono8", "8UC1", "mono16", "16UC1", "32FC1")


def contact(message: RosMessage, frames: Mapping[str, str]) -> ContactMeasurement | None:
    """Returns the contact of a ShadowContactStateStamped; None: nothing is touched.

    `frames`: what messages call the palm, and as `tip` the body that the tip moves with.
    """
    p, n = message.contact_position, message.contact_normal
    point, normal, force = np.array([p.x, p.y, p.z]), np.array([n.x, n.y, n.z]), float(message.f_normal)
    if not np.isfinite([*point, *normal, force]).all():
        raise MessageRejected("position, normal or force is not finite", nan=True)
    named = message.header.frame_id.lstrip("/")
    frame = {"": "tip", frames["palm"].lstrip("/"): "palm", frames["tip"]: frames["tip"]}.get(named)
    if frame is None:
        valid = f"none (the tip's own), {frames['tip']!r}, {frames['palm']!r}"
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {valid}")
    return ContactMeasurement(point, normal, frame, force) if force > 0 and normal.any() else None


def taxel_reading(message: RosMessage, shape: tuple[int, int]) -> Array:
    """Returns (rows, columns) of a Float32MultiArray or an Image; NaN where a taxel reads nothing.

    Row by row from the grid's corner at -x, -y; the layout of an array may state the shape, or nothing.
    """
    expected = f"expected {shape[0]} x {shape[1]} taxels"
    if hasattr(message, "encoding"):
        values = images.values(message, ENCODINGS)[..., 0].astype(np.float64)
        if values.shape != shape:
            raise MessageRejected(f"{expected}, got {values.shape[0]} x {values.shape[1]}")
    else:
        sizes = [int(each.size) for each in message.layout.dim]
        sizes = [size for size in sizes if size != 1] if len(sizes) > 2 else sizes
        data = np.asarray(message.data, dtype=np.float64)[int(message.layout.data_offset) :]
        if len(sizes) == 2 and tuple(sizes) != shape:
            raise MessageRejected(f"{expected}, got {sizes[0]} x {sizes[1]}")
        if len(data) != shape[0] * shape[1]:
            raise MessageRejected(f"{expected}, got {len(data)} numbers")
        values = data.reshape(shape)
    values = np.where(np.isfinite(values), values, np.nan)
    if np.isnan(values).all():
        raise MessageRejected("no taxel has a finite reading", nan=True)
    return values


def taxel_fields(values: Array, array: TaxelArray | None, name: str) -> dict[str, object]:
    """Returns the fields of a Float32MultiArray of an array's readings (rows, columns); raises InvalidInput."""
    if array is None:
        raise InvalidInput(f"skin[{name!r}]: expected a tactile array of the rig, got none of that name")
    clean = array.reading(values, f"skin[{name!r}]")
    (rows, columns), data = clean.shape, clean.astype(np.float32).ravel()
    sides = ("rows", rows, data.size), ("columns", columns, columns)
    dim = [Message(label=label, size=size, stride=stride) for label, size, stride in sides]
    return {"layout": Message(dim=dim, data_offset=0), "data": data}
