"""Contacts of fingertips that sense them themselves."""

from collections.abc import Mapping

import numpy as np

from handsight.errors import InvalidInput
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


def contact(message: RosMessage, frames: Mapping[str, str]) -> ContactMeasurement | None:
    """Returns the contact of a ShadowContactStateStamped; None: nothing is touched. Raises MessageRejected.

    `frames`: what messages call the palm, and as `tip` the body that the tip moves with.
    """
    point, normal = (
        np.array([vector.x, vector.y, vector.z])
        for vector in (message.contact_position, message.contact_normal)
    )
    force, named = float(message.f_normal), message.header.frame_id.lstrip("/")
    if not np.isfinite([*point, *normal, force]).all():
        raise MessageRejected("position, normal or force is not finite", nan=True)
    frame = {"": "tip", frames["palm"].lstrip("/"): "palm", frames["tip"]: frames["tip"]}.get(named)
    if frame is None:
        valid = f"none (the tip's own), {frames['tip']!r}, {frames['palm']!r}"
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {valid}")
    if force <= 0 or not normal.any():
        return None
    try:
        return ContactMeasurement(point, normal, frame, force)
    except InvalidInput as error:
        raise MessageRejected(str(error)) from None
