"""The fingers over time: whether they grasp the object, and the last contacts of those that have let go."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.observation import seconds
from handsight.tracking.smoother import process_variance

GraspChange = Literal["grasped", "regrasped", "released"]


RELEASE_AFTER = 0.2
"""The object is released once nothing was touched for so long [s]: contacts flicker while fingers close."""
LIFTED_HEIGHT = 0.005  # a palm that rose by so much since the grasp has lifted the object [m]
MIN_FINGERS = 2  # so many fingers that stay hold the object in place while others come and go


@dataclass(frozen=True, slots=True)
class GraspState:
    """Says whether the object is grasped and lifted."""

    touched: Mapping[str, float] = field(default_factory=dict)
    """By finger that holds the object, when it last touched [s]."""
    lowest: float | None = None
    """Lowest height of the palm in the world since the grasp [m]; None where it is unknown."""
    lifted: bool = False
    """Whether the palm is higher by `LIFTED_HEIGHT` or more."""
    carried: bool = False
    """Whether it has been since the grasp: where the palm is tilted, it may be lower than an object in the air."""
    since: float = -math.inf
    """When the object was last grasped or released [s]."""
    changed: float = -math.inf
    """When the object may have moved last, as it was grasped, regrasped or released [s]."""

    @property
    def grasped(self) -> bool:
        """Whether any finger holds the object."""
        return bool(self.touched)

    @property
    def lasted(self) -> float:
        """How long the object was held, up to when it was last touched [s]; 0 where it is not."""
        return seconds(max(self.touched.values()), self.since) if self.touched else 0.0

    def after(
        self, fingers: tuple[str, ...], stamp: float, T_world_palm: Array | None
    ) -> tuple["GraspState", GraspChange | None]:
        """Returns the state after an observation in which `fingers` touch, and the change of the grasp, if any.

        A finger has let go once it has not touched for `RELEASE_AFTER`. "regrasped" means that so few of the fingers
        have stayed that the object may have moved.
        """
        touched = {**self.touched, **dict.fromkeys(fingers, stamp)}
        touched = {name: at for name, at in touched.items() if seconds(stamp, at) <= RELEASE_AFTER}
        change: GraspChange | None = None
        if bool(touched) != self.grasped:
            change = "grasped" if touched else "released"
        elif touched.keys() != self.touched.keys():
            staying = touched.keys() & self.touched.keys()
            change = "regrasped" if len(staying) < MIN_FINGERS else None
        lowest = self.lowest if touched and self.grasped else None
        lifted = self.lifted and bool(touched)
        if touched and T_world_palm is not None:
            height = float(T_world_palm[2, 3])
            lowest = height if lowest is None else min(lowest, height)
            lifted = height >= lowest + LIFTED_HEIGHT
        carried = lifted or (self.carried and bool(touched))
        since = stamp if change in ("grasped", "released") else self.since
        changed = self.changed if change is None else stamp
        return GraspState(touched, lowest, lifted, carried, since, changed), change


def slid(T_before: Array, T_now: Array) -> Array:
    """Returns the motion (4, 4) in the world of an object that a palm slides over a table: as the palm's, from its pose
    T_world_palm (4, 4) before to that now, but at the same height and without tilt."""
    turn = T_now[:3, :3] @ T_before[:3, :3].T
    yaw = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    R = se3.rotation_exp(np.array([0.0, 0.0, yaw]))
    there = np.array([*T_now[:2, 3], T_before[2, 3]])
    return se3.compose(R, there - R @ T_before[:3, 3])


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
        last = {
            f: old
            for f, old in self.last.items()
            if f in fingers or seconds(stamp, old.stamp) <= self.seconds
        }
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
            variance = process_variance(self.process_noise, max(seconds(stamp, old.stamp), 0.0))
            more.append(np.diag(variance)[None])
        covariance = every.covariance + np.concatenate(more)
        return Contacts(every.points_palm, every.normals_palm, covariance=covariance), list(others)
