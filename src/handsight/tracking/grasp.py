"""The fingers over time: whether they grasp the object, and the last contacts of those that have let go."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.tracking.smoother import process_variance

GraspChange = Literal["grasped", "regrasped", "released"]


RELEASE_AFTER = 0.2
"""The object is released once nothing was touched for so long [s]: contacts flicker while fingers close."""
LIFTED_HEIGHT = 0.005  # a palm that rose by so much since the grasp has lifted the object [m]
MIN_FINGERS = 2  # so many fingers that stay hold the object in place while others come and go


@dataclass(frozen=True, slots=True)
class GraspState:
    """Says whether the object is grasped and lifted."""

    grasped: bool = False
    lifted: bool = False
    """Whether the palm has risen by `LIFTED_HEIGHT` since the grasp."""
    fingers: frozenset[str] = frozenset()
    """The fingers that touched last."""
    touched_at: float = -math.inf
    """When any finger last touched [s]."""
    lowest: float | None = None
    """Lowest height of the palm in the world since the grasp [m]; None where it is unknown."""
    since: float = -math.inf
    """When the object was last grasped or released [s]."""

    def after(
        self, fingers: tuple[str, ...], stamp: float, T_world_palm: Array | None
    ) -> tuple["GraspState", GraspChange | None]:
        """Returns the state after an observation in which `fingers` touch, and the change of the grasp, if any.

        "regrasped" means that so few of the fingers have stayed that the object may have moved.
        """
        now = frozenset(fingers)
        grasped = self.grasped
        lowest = self.lowest
        touched_at = stamp if now else self.touched_at
        change: GraspChange | None = None
        if grasped and stamp - touched_at > RELEASE_AFTER:
            grasped = False
            lowest = None
            change = "released"
        elif now and not grasped:
            grasped = True
            change = "grasped"
        elif now and now != self.fingers and len(now & self.fingers) < MIN_FINGERS:
            change = "regrasped"
        lifted = grasped and self.lifted
        if grasped and T_world_palm is not None:
            height = float(T_world_palm[2, 3])
            lowest = height if lowest is None else min(lowest, height)
            lifted = height >= lowest + LIFTED_HEIGHT
        last = now if now or change == "released" else self.fingers
        since = self.since if grasped == self.grasped else stamp
        return GraspState(grasped, lifted, last, touched_at, lowest, since), change


class LastContact(NamedTuple):
    """The last contact of one finger."""

    contacts: Contacts
    """All contacts of that observation, in the palm frame."""
    row: int
    """The row of the finger's own."""
    stamp: float
    """[s]"""


@dataclass(frozen=True, eq=False)
class ContactMemory:
    """Keeps the last contact of each finger: after it lets go, the object stays there for a while."""

    seconds: float
    """How long a contact is kept; 0: not at all."""
    process_noise: Array
    """(6,) variance of the object's motion in the palm, per second."""
    last: Mapping[str, LastContact] = field(default_factory=dict)
    """By finger."""

    def after(self, fingers: tuple[str, ...], contacts: Contacts | None, stamp: float) -> "ContactMemory":
        """Returns the memory with the contacts of fingers that touch, and without those that are too old."""
        if not self.seconds:
            return self
        last = {f: old for f, old in self.last.items() if f in fingers or stamp - old.stamp <= self.seconds}
        if contacts is not None:
            last |= {finger: LastContact(contacts, row, stamp) for row, finger in enumerate(fingers)}
        return replace(self, last=last)

    def only(self, fingers: Iterable[str]) -> "ContactMemory":
        """Returns the memory with the contacts of these fingers alone."""
        kept = {finger: old for finger, old in self.last.items() if finger in fingers}
        return replace(self, last=kept)

    def added(self, fingers: tuple[str, ...], contacts: Contacts, stamp: float) -> tuple[Contacts, list[str]]:
        """Returns the given contacts followed by the remembered ones of other fingers, and the names of these fingers.

        The covariance of a remembered contact is inflated by the object's random walk since its stamp.
        """
        others = {finger: old for finger, old in self.last.items() if finger not in fingers}
        if not others:
            return contacts, []
        every = contacts
        more = [np.zeros((len(contacts), 6, 6))]
        for old in others.values():
            every = every.joined(old.contacts.select([old.row]))
            variance = process_variance(self.process_noise, max(stamp - old.stamp, 0.0))
            more.append(np.diag(variance)[None])
        covariance = every.covariance + np.concatenate(more)
        return Contacts(every.points_palm, every.normals_palm, covariance=covariance), list(others)
