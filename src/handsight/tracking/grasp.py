"""The fingers over time: whether the hand grasps the object, and the last contacts of fingers that have let go."""

from typing import Literal, NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.tracking.smoother import process_variance

GraspChange = Literal["grasped", "regrasped", "released"]


class GraspDetection(NamedTuple):
    """A `GraspDetection` says when an object is grasped, lifted and released."""

    release_after: float = 0.2
    """The object is released after nothing was touched for so long [s]: contacts flicker as fingers close."""
    lifted: float = 0.005  # a palm that rose by so much since the grasp has lifted the object [m]
    min_fingers: int = 2  # fingers that stay and hold the object in place while others come and go


GRASP = GraspDetection()


class GraspState:
    """A `GraspState` says whether the object is grasped and lifted, over time."""

    def __init__(self) -> None:
        """Starts with nothing grasped."""
        self.grasped = self.lifted = False
        self._fingers: frozenset[str] = frozenset()
        self._touched_at = -float("inf")
        self._lowest: float | None = None
        """Height of the palm in the world, its lowest since the grasp [m]."""

    def update(
        self, fingers: tuple[str, ...], stamp: float, T_world_palm: Array | None
    ) -> GraspChange | None:
        """Returns whether a grasp has begun or ended, or has changed fingers so that the object may have moved."""
        now = frozenset(fingers)
        if now:
            self._touched_at = stamp
        change: GraspChange | None = None
        if self.grasped and stamp - self._touched_at > GRASP.release_after:
            self.grasped = self.lifted = False
            self._lowest, change = None, "released"
        elif now and not self.grasped:
            self.grasped, change = True, "grasped"
        elif now and now != self._fingers and len(now & self._fingers) < GRASP.min_fingers:
            change = "regrasped"
        if now or change == "released":
            self._fingers = now
        if self.grasped and T_world_palm is not None:
            height = float(T_world_palm[2, 3])
            self._lowest = height if self._lowest is None else min(self._lowest, height)
            self.lifted = height >= self._lowest + GRASP.lifted
        return change


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
        """Replaces the contacts of fingers that touch, and drops those that are too old."""
        if not self._seconds:
            return
        if contacts is not None:
            self._last = self._last | {finger: (contacts, row, stamp) for row, finger in enumerate(fingers)}
        if any(stamp - last[2] > self._seconds for last in self._last.values()):
            self._last = {
                finger: last for finger, last in self._last.items() if stamp - last[2] <= self._seconds
            }

    def added(self, fingers: tuple[str, ...], contacts: Contacts, stamp: float) -> tuple[Contacts, list[str]]:
        """Returns the given contacts followed by those of other fingers, and the names of these fingers.

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
