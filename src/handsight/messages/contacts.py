"""Contacts out of messages of fingertips that sense them: of Shadow, tactile_msgs, or its_msgs (in millimetres)."""

from collections.abc import Mapping

import numpy as np

from handsight.checks import Array
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.observation import ContactMeasurement


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

    `tip`: the body that the tip moves with. `palm`: the palm's frame id. Raises MessageRejected, InvalidInput.
    """
    if message is None:
        return None
    if hasattr(message, "PoC"):  # its_msgs
        point = 1e-3 * _xyz(message.PoC)
        normal = _xyz(message.n)
        force = float(message.Fn)
    elif hasattr(message, "wrench"):  # tactile_msgs: its force is in the same frame as the normal
        point = _xyz(message.position)
        normal = _xyz(message.normal)
        along = abs(float(np.dot(normal, _xyz(message.wrench.force))))
        length = float(np.linalg.norm(normal))
        force = along / max(length, 1e-12)
    else:
        point = _xyz(message.contact_position)
        normal = _xyz(message.contact_normal)
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


def _xyz(vector: RosMessage) -> Array:
    return np.array([vector.x, vector.y, vector.z])
