"""Contacts of fingers that have let go: the object is still where they felt it, for a while."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.tracking.touch import Touch


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """One finger's last contact."""

    finger: str
    contacts: Contacts
    """Those it was last among, in the palm frame."""
    row: int
    """Which of them it is."""
    stamp: float
    """When that was [s]."""

    @property
    def contact(self) -> Contacts:
        """It alone."""
        return self.contacts.select([self.row])


class Memory:
    """The last contact of each finger that touches no more."""

    def __init__(self, seconds: float) -> None:
        """How long a contact is kept; 0: not at all."""
        self._seconds = seconds
        self._felt: dict[str, Remembered] = {}

    def feel(self, touch: Touch, stamp: float) -> None:
        """Takes note of what is touched now; a finger's new contact replaces its old one, and the old expire."""
        if not self._seconds:
            return
        if touch.contacts is not None:
            for row, finger in enumerate(touch.fingers):
                self._felt[finger] = Remembered(finger, touch.contacts, row, stamp)
        expired = [finger for finger, kept in self._felt.items() if stamp - kept.stamp > self._seconds]
        for finger in expired:
            del self._felt[finger]

    def besides(self, touch: Touch) -> list[Remembered]:
        """What is remembered of fingers that do not touch now."""
        return [kept for finger, kept in self._felt.items() if finger not in touch.fingers]

    def forget(self, finger: str) -> None:
        """Drops a contact that does not fit."""
        self._felt.pop(finger, None)

    def only(self, fingers: tuple[str, ...]) -> None:
        """Drops all contacts but those of some fingers: a new grip."""
        self._felt = {finger: kept for finger, kept in self._felt.items() if finger in fingers}


def together(touch: Touch, remembered: list[Remembered], walk: Array, stamp: float) -> Contacts | None:
    """Contacts now and, after them, those remembered, as uncertain as the object's walk (6,) a second has made them."""
    if touch.contacts is None:
        return None
    if not remembered:
        return touch.contacts
    parts = [touch.contacts, *(kept.contact for kept in remembered)]
    covariance = np.concatenate([part.covariance for part in parts])
    for i, kept in enumerate(remembered, start=len(touch.contacts)):
        covariance[i] += np.diag(walk * max(stamp - kept.stamp, 0.0))
    return Contacts(
        np.concatenate([part.points_palm for part in parts]),
        np.concatenate([part.normals_palm for part in parts]),
        covariance=covariance,
    )
