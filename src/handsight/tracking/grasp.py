"""The fingers over time: whether the hand grasps the object, and the last contacts of fingers that have let go."""

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
    """The object is released after nothing was touched for so long [s]: contacts flicker as fingers close."""
    min_fingers: int = 2  # fingers that stay and hold the object in place while others come and go


GRASP = GraspDetection()


class GraspState:
    """A `GraspState` says whether the object is grasped, over time."""

    def __init__(self) -> None:
        """Starts with nothing grasped."""
        self.grasped = False
        self._fingers: frozenset[str] = frozenset()
        self._touched_at = -float("inf")
        self._height: float | None = None

    def update(self, fingers: tuple[str, ...], stamp: float) -> GraspChange | None:
        """Returns whether a grasp has begun or ended, or has changed fingers so that the object may have moved."""
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
        """Returns whether an object that stood when it was grasped still does, by the palm's `height` in the world
        [m]."""
        if self._height is None:
            self._height = height
        return height < self._height + LIFTED


class ContactMemory:
    """A `ContactMemory` keeps the last contact of each finger that has let go: the object stays there for a while.

    Its methods bind its attributes anew and change none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, seconds: float, process_noise: Array) -> None:
        """`seconds`: how long a contact is kept; `process_noise` (6,): variance of the object's motion per second."""
        self._seconds, self._process_noise = seconds, process_noise
        self._last: dict[str, tuple[Contacts, int, float]] = {}
        """By finger: the contacts among which its last one was, in the palm frame, its row, and the stamp [s]."""

    def update(self, fingers: tuple[str, ...], contacts: Contacts | None, stamp: float) -> None:
        """Keeps the contacts of now in place of their fingers' old ones, and drops those that are too old."""
        if not self._seconds:
            return
        if contacts is not None:
            self._last = self._last | {finger: (contacts, row, stamp) for row, finger in enumerate(fingers)}
        if any(stamp - last[2] > self._seconds for last in self._last.values()):
            self._last = {
                finger: last for finger, last in self._last.items() if stamp - last[2] <= self._seconds
            }

    def added(self, fingers: tuple[str, ...], contacts: Contacts, stamp: float) -> tuple[Contacts, list[str]]:
        """Returns the contacts of now followed by those of other fingers, and the names of these.

        To the covariance of a remembered contact that of the object's motion since then is added.
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
        """Drops all contacts but those of some fingers, such as those of a new grasp."""
        self._last = {finger: last for finger, last in self._last.items() if finger in fingers}
