"""Contacts out of messages of fingertips that sense them: of Shadow, tactile_msgs, or its_msgs (in millimetres)."""

from collections.abc import Mapping

import numpy as np

from handsight.checks import Array
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.observation import ContactMeasurement

Found = list[tuple[str, ContactMeasurement | None]]


def contacts(message: RosMessage, tips: Mapping[str, str], palm: str) -> Found:
    """Returns the contacts of a message, by finger; None: the finger touches nothing.

    `tips`: the body that each finger's tip moves with. A message about one contact is of the only finger there is; of
    several contacts, and several fingers, each is of the finger whose name or body it names. `palm`: the palm's frame
    id. Raises MessageRejected.
    """
    if not hasattr(message, "contacts"):
        finger = _finger(message, tips) if len(tips) > 1 else next(iter(tips))
        if not finger:
            names = ", ".join(sorted({*tips, *tips.values()}))
            raise MessageRejected(f"expected the name or frame of a finger on this topic ({names}), got none")
        return [(finger, _contact(message, tips[finger], palm))]
    named = {_finger(each, tips): each for each in message.contacts}
    return [(f, _contact(named[f], body, palm) if f in named else None) for f, body in tips.items()]


def _finger(message: RosMessage, tips: Mapping[str, str]) -> str:
    """Returns the finger that a contact is of, by its name or its frame; empty: of none."""
    names = {getattr(message, "name", ""), message.header.frame_id.lstrip("/")}
    return next((finger for finger, body in tips.items() if names & {finger, body}), "")


def _contact(message: RosMessage, tip: str, palm: str) -> ContactMeasurement | None:
    """Returns one contact; its vectors are in the fingertip's frame if the header names none."""
    scale = 1.0
    if hasattr(message, "PoC"):  # its_msgs
        p, n, force, scale = message.PoC, message.n, float(message.Fn), 1e-3
    elif hasattr(message, "wrench"):  # tactile_msgs: its force is in the same frame as the normal
        p, n, f = message.position, message.normal, message.wrench.force
        force = abs(float(np.dot(_xyz(n), _xyz(f)))) / max(float(np.linalg.norm(_xyz(n))), 1e-12)
    else:
        p, n, force = message.contact_position, message.contact_normal, float(message.f_normal)
    point, normal = scale * _xyz(p), _xyz(n)
    if not np.isfinite([*point, *normal, force]).all():
        raise MessageRejected("position, normal or force is not finite", nan=True)
    named = message.header.frame_id.lstrip("/")
    frame = {"": "tip", palm.lstrip("/"): "palm", tip: tip}.get(named)
    if frame is None:
        valid = f"none (the tip's own), {tip!r}, {palm!r}"
        raise MessageRejected(f"unknown frame {named[:60]!r}; valid: {valid}")
    return ContactMeasurement(point, normal, frame, force) if force > 0 and normal.any() else None


def _xyz(vector: RosMessage) -> Array:
    return np.array([vector.x, vector.y, vector.z])
