"""The fingers over time: whether the hand grasps something, and where those that have let go felt it last."""

from typing import Literal, NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.forces.object_weight import LIFTED
from handsight.tracking.smoother import process_variance

GraspChange = Literal["grasped", "regrasped", "released"]


class GraspDetection(NamedTuple):
    """A `GraspDetection` says when an object is grasped and released."""

    release_after: float = 0.2
    """Nothing may be touched for so long before the object counts as released [s]: contacts flicker as fingers close.
    """
    min_fingers: int = 2  # so many fingers that stay keep an object where it is while others come and go


GRASP = GraspDetection()


class GraspState:
    """A `GraspState` says whether one object is grasped, over time."""

    def __init__(self) -> None:
        """Starts with nothing grasped at first."""
        self.grasped = False
        self._fingers: frozenset[str] = frozenset()
        self._touched_at = -float("inf")
        self._height: float | None = None

    def update(self, fingers: tuple[str, ...], stamp: float) -> GraspChange | None:
        """Returns what has changed: a grasp begun, ended, or its fingers so different that the object may have
        moved."""
        now = frozenset(fingers)
        if now:
            self._touched_at = stamp
        change: GraspChange | None = None
        if self.grasped and stamp - self._touched_at > GRASP.release_after:
            self.grasped, self._height, change = False, None, "released"
        elif now and not self.grasped:
            self.grasped, change = True, "grasped"
        elif now and now != self._fingers and len(now & self._fingers) < GRASP.min_fingers:
            change = "regrasped"
        if now or change == "released":
            self._fingers = now
        return change

    def on_table(self, height: float) -> bool:
        """Returns whether an object that stood when it was grasped still does; `height` of the palm in the world
        [m]."""
        if self._height is None:
            self._height = height
        return height < self._height + LIFTED


class ContactMemory:
    """A `ContactMemory` is the last contact of each finger that touches no more: the object is still there, for a
    while."""

    def __init__(self, seconds: float, process_noise: Array) -> None:
        """How long a contact is kept, 0: not at all; `process_noise` (6,): variance of the object's motion a second."""
        self._seconds, self._process_noise = seconds, process_noise
        self._last: dict[str, tuple[Contacts, int, float]] = {}
        """By finger: the contacts its last one was among, in the palm frame, which of them it is, and when [s]. Bound
        anew with each change: a tracker may come back to it."""

    def update(self, fingers: tuple[str, ...], contacts: Contacts | None, stamp: float) -> None:
        """Takes note of what is touched now; a finger's new contact replaces its old one, and the old expire."""
        if not self._seconds:
            return
        if contacts is not None:
            self._last = self._last | {finger: (contacts, row, stamp) for row, finger in enumerate(fingers)}
        if any(stamp - last[2] > self._seconds for last in self._last.values()):
            kept = ((finger, last) for finger, last in self._last.items() if stamp - last[2] <= self._seconds)
            self._last = dict(kept)

    def added(self, fingers: tuple[str, ...], contacts: Contacts, stamp: float) -> tuple[Contacts, list[str]]:
        """Returns the contacts of now and, after them, those of other fingers, whose names come too.

        Remembered ones are less certain by what the object has moved since.
        """
        others = {finger: last for finger, last in self._last.items() if finger not in fingers}
        if not others:
            return contacts, []
        parts = [contacts, *(then.select([row]) for then, row, _ in others.values())]
        covariance = np.concatenate([part.covariance for part in parts])
        ages = [max(stamp - then, 0.0) for _, _, then in others.values()]
        covariance[len(contacts) :] += [np.diag(process_variance(self._process_noise, age)) for age in ages]
        points = np.concatenate([part.points_palm for part in parts])
        normals = np.concatenate([part.normals_palm for part in parts])
        flags = np.concatenate([part.of_residual for part in parts])
        return Contacts(points, normals, covariance=covariance, of_residual=flags), list(others)

    def forget(self, finger: str) -> None:
        """Drops a contact that does not fit."""
        self._last = {other: last for other, last in self._last.items() if other != finger}

    def only(self, fingers: tuple[str, ...]) -> None:
        """Drops all contacts but those of some fingers: a new grasp."""
        self._last = {finger: last for finger, last in self._last.items() if finger in fingers}
