"""Contacts of fingers that have let go: the object is still where they felt it, for a while."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.tracking.fingertips import FingertipContacts


@dataclass(frozen=True, slots=True, eq=False)
class RememberedContact:
    """One finger's last contact."""

    finger: str
    contacts: Contacts
    """Those it was last among, in the palm frame."""
    row: int
    """Which of them it is."""
    stamp: float
    """When that was [s]."""


class ContactMemory:
    """The last contact of each finger that touches no more."""

    def __init__(self, seconds: float) -> None:
        """How long a contact is kept; 0: not at all."""
        self._seconds = seconds
        self._last: dict[str, RememberedContact] = {}

    def update(self, touch: FingertipContacts, stamp: float) -> None:
        """Takes note of what is touched now; a finger's new contact replaces its old one, and the old expire."""
        if not self._seconds:
            return
        if touch.contacts is not None:
            for row, finger in enumerate(touch.fingers):
                self._last[finger] = RememberedContact(finger, touch.contacts, row, stamp)
        expired = [finger for finger, last in self._last.items() if stamp - last.stamp > self._seconds]
        for finger in expired:
            del self._last[finger]

    def of_others(self, touch: FingertipContacts) -> list[RememberedContact]:
        """What is remembered of fingers that do not touch now."""
        return [last for finger, last in self._last.items() if finger not in touch.fingers]

    def forget(self, finger: str) -> None:
        """Drops a contact that does not fit."""
        self._last.pop(finger, None)

    def only(self, fingers: tuple[str, ...]) -> None:
        """Drops all contacts but those of some fingers: a new grasp."""
        self._last = {finger: last for finger, last in self._last.items() if finger in fingers}


def with_remembered(
    touch: FingertipContacts, remembered: list[RememberedContact], process_noise: Array, stamp: float
) -> Contacts | None:
    """The contacts of now and, after them, those remembered, less certain by what the object has moved since.

    `process_noise` (6,): variance of the object's motion in the palm, per second.
    """
    if touch.contacts is None:
        return None
    if not remembered:
        return touch.contacts
    parts = [touch.contacts, *(last.contacts.select([last.row]) for last in remembered)]
    covariance = np.concatenate([part.covariance for part in parts])
    for i, last in enumerate(remembered, start=len(touch.contacts)):
        covariance[i] += np.diag(process_noise * max(stamp - last.stamp, 0.0))
    return Contacts(
        np.concatenate([part.points_palm for part in parts]),
        np.concatenate([part.normals_palm for part in parts]),
        covariance=covariance,
    )
