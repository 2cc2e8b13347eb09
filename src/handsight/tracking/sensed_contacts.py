"""Contacts that a fingertip senses itself, into the palm beside those that are sensed from its wrench."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import REASON_NAMES
from handsight.errors import InvalidInput
from handsight.observation import ContactMeasurement
from handsight.rig import Finger, Rig

FREE = REASON_NAMES.index("free")


def put_ready(
    rig: Rig,
    contacts: Mapping[str, ContactMeasurement | None],
    Ts_palm_tip: Array,
    by_error: Array,
    records: NDArray[np.void],
) -> None:
    """Writes the contacts into the rows of `records` (n) PALM_CONTACT, and into `by_error`, of their fingers.

    `Ts_palm_tip` (n, 4, 4), `by_error` (n, 6, j): as `contacts_to_palm` takes them, in the order of the rig's fingers.
    Fingers that the rig has not are passed over. Raises InvalidInput.
    """
    if not isinstance(contacts, Mapping):
        raise InvalidInput(
            f"observation.contacts: expected a mapping from finger to contact, got {checks.brief(contacts)}"
        )
    for i, (name, finger) in enumerate(rig.fingers.items()):
        if name not in contacts:
            continue
        contact, name_of = contacts[name], f"observation.contacts[{name!r}]"
        if not isinstance(contact, ContactMeasurement | None):
            came = type(contact).__name__
            raise InvalidInput(f"{name_of}: expected a ContactMeasurement or None, got {came}")
        if contact is None or (contact.force is not None and contact.force < finger.tip.min_force):
            records[i]["reason"] = FREE
            continue
        records[i]["reason"] = 0
        _put(
            contact,
            finger,
            _T_palm_frame(contact, rig, finger, Ts_palm_tip[i], name_of),
            Ts_palm_tip[i],
            by_error[i],
            records[i],
        )


def _T_palm_frame(
    contact: ContactMeasurement, rig: Rig, finger: Finger, T_palm_tip: Array, name_of: str
) -> Array:
    """Returns (4, 4) of the frame that a contact is given in; raises InvalidInput."""
    frames = {
        "tip": T_palm_tip @ finger.T_frame_surface,
        "palm": np.eye(4),
        rig.hand.palm: np.eye(4),
        finger.frame: T_palm_tip,
    }
    if contact.frame not in frames:
        known = ", ".join(dict.fromkeys(frames))
        raise InvalidInput(
            f"{name_of}.frame: expected one of {known}, got {checks.brief(repr(contact.frame))}"
        )
    return frames[contact.frame]


def _put(
    contact: ContactMeasurement,
    finger: Finger,
    T_palm_frame: Array,
    T_palm_tip: Array,
    J: Array,
    row: np.void,
) -> None:
    """Writes one contact: place, normal, and their covariance with the joints' errors `J` (6, j), which become its
    own."""
    R = T_palm_frame[:3, :3]
    point, normal = R @ contact.point + T_palm_frame[:3, 3], R @ contact.normal
    center = T_palm_tip[:3, :3] @ finger.T_frame_surface[:3, 3] + T_palm_tip[:3, 3]
    if (point - center) @ normal > 0:  # some say which way the tip pushes
        normal = -normal
    shift, turn = J[:3], J[3:]
    J[:3] = shift + np.cross(turn, (point - T_palm_tip[:3, 3])[:, None], axis=0)
    J[3:] = np.cross(turn, normal[:, None], axis=0)
    if contact.covariance is None:
        C = np.diag(np.repeat([finger.sigma_point**2, finger.sigma_normal**2], 3))
    else:
        C = se3.rotate_covariance(R, contact.covariance)
    tangent = np.eye(6)
    tangent[3:, 3:] -= np.outer(normal, normal)
    row["point"], row["normal"], row["load"] = point, normal, np.nan
    row["covariance"] = tangent @ (C + J @ J.T) @ tangent
