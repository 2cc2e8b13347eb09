"""The contact of a fingertip and the object, the reason where there is none, and a batch of both."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.checks import Array
from handsight.contact.fingertips import Fingertip
from handsight.representation import short_repr

ReasonName = Literal["free", "off_cap", "beyond_friction", "invalid"]


class Reason(IntEnum):
    """Result of sensing one wrench; its numbers are those in `ContactBatch.reasons`."""

    CONTACT = 0  # the wrench is that of a contact
    FREE = 1  # the force is weaker than the tip's `min_force`
    OFF_CAP = 2
    """No push within the cap has that wrench: it is a pull, a contact beside the cap, or its axis misses the tip."""
    BEYOND_FRICTION = 3
    """The wrench needs more friction than the tip's `max_friction`: there are two contacts, or a bias."""
    INVALID = 4  # the reading contains NaN, infinity or more than any tip can bear


REASON_NAMES: tuple[Literal["contact"] | ReasonName, ...] = ("contact", *get_args(ReasonName))
"""Names of the reasons, at their numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Where one fingertip touches the object, in the tip's (surface's) frame unless `moved`."""

    point: Array
    """(3,) position on the tip's surface [m]."""
    normal: Array
    """(3,) unit vector in which the object pushes the tip: the object's outward normal, minus the tip's."""
    force: Array
    """(3,) force of the object on the tip [N]."""
    force_normal: float
    """Normal force `force · normal`, above zero [N]."""
    torque: float
    """Local torque of the object on the tip about `normal` [N m]; as a vector, `torque * normal`."""
    covariance: Array
    """(6, 6) covariance of (point [m], normal) from the sensor's noise alone; of rank 2, because the point stays on the
    surface and the normal follows the point."""

    __repr__ = short_repr

    @property
    def force_tangential(self) -> Array:
        """The part (3,) of `force` in the tangent plane [N]."""
        return self.force - self.force_normal * self.normal

    def moved(self, T_new_old: Array) -> "Contact":
        """Returns the same contact in another frame; `T_new_old` (4, 4) maps coordinates of this frame to it."""
        T = se3.check(T_new_old, "T_new_old")
        R = T[:3, :3]
        covariance = symmetric(se3.rotate_covariance(T[:3, :3], self.covariance))
        vectors = R @ self.point + T[:3, 3], R @ self.normal, R @ self.force
        return Contact(*vectors, self.force_normal, self.torque, covariance)


@dataclass(frozen=True, slots=True)
class NoContact:
    """Why a wrench is that of no contact; it is false as a truth value."""

    reason: ReasonName
    """One of the names of `Reason`; `invalid` occurs in batches only."""

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True, eq=False)
class ContactBatch:
    """A reason for each of n wrenches, and the k contacts among them, in the tip's frame.

    `len(batch)` is n and `batch[i]` is wrench i's `Contact` or `NoContact`. The arrays hold the contacts
    only, so no row of them stands for a missing one.
    """

    reasons: NDArray[np.int8]  # (n,) `Reason` of each wrench
    rows: NDArray[np.intp]  # (k,) number of the wrench of each contact, ascending
    records: NDArray[np.void]  # (k,) the contacts as records of point, normal, force, force_normal, torque
    fingertip: Fingertip  # the tip that sensed the wrenches
    sigmas: Array  # (6,) standard deviation per axis of a reading's force [N] and torque [N m]

    __repr__ = short_repr

    @property
    def points(self) -> Array:
        """(k, 3) positions on the tip [m]."""
        return self.records["point"]

    @property
    def normals(self) -> Array:
        """(k, 3) unit vectors in which the object pushes."""
        return self.records["normal"]

    @property
    def forces(self) -> Array:
        """(k, 3) forces of the object on the tip [N]."""
        return self.records["force"]

    @property
    def forces_normal(self) -> Array:
        """(k,) normal forces [N], above zero."""
        return self.records["force_normal"]

    @property
    def forces_tangential(self) -> Array:
        """(k, 3) parts of `forces` in the tangent planes [N]."""
        return self.forces - self.forces_normal[:, None] * self.normals

    @property
    def torques(self) -> Array:
        """(k,) local torques about the normals [N m]."""
        return self.records["torque"]

    @cached_property
    def covariances(self) -> Array:
        """(k, 6, 6) covariances of (point [m], normal) from the sensor's noise alone; computed at the first use."""
        from handsight.contact.kernels import sensing

        out = np.empty((len(self.rows), 6, 6))
        sensing.covariances(self.records, self.fingertip.record, self.sigmas, out)
        return out

    def __len__(self) -> int:
        return len(self.reasons)

    def __getitem__(self, i: int) -> Contact | NoContact:
        name = REASON_NAMES[self.reasons[i]]
        if name != "contact":
            return NoContact(name)
        k = int(np.searchsorted(self.rows, i % len(self)))
        point, normal, force, force_normal, torque = self.records[k]
        return Contact(point, normal, force, float(force_normal), float(torque), self.covariances[k])


def symmetric(matrices: Array) -> Array:
    """Returns matrices (..., m, m) made exactly symmetric."""
    return (matrices + np.swapaxes(matrices, -1, -2)) / 2
