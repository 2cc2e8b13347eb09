"""The contact of a fingertip and the object, sensed by the wrench on the tip (eq. 7), or why there is none.

Arguments are checked here. `handsight._kernels.touch.sensing` derives the formulas and computes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache, lru_cache
from typing import Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.touch.sensing_records import TIP_CONTACT
from handsight.checks import Array
from handsight.contact.fingertips import Fingertip
from handsight.errors import InvalidInput
from handsight.representation import short_repr

ReasonName = Literal["free", "off_cap", "beyond_friction", "invalid"]


class Reason(IntEnum):
    """A `Reason` is the result of sensing one wrench; its numbers are those in `ContactBatch.reasons`."""

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
    """A `Contact` is where one fingertip touches the object, in the tip's (surface's) frame unless `moved`."""

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
        return np.asarray(self.force - self.force_normal * self.normal, dtype=np.float64)

    def moved(self, T_new_old: Array) -> Contact:
        """Returns the same contact in another frame; `T_new_old` (4, 4) maps coordinates of this frame to it."""
        T = se3.check(T_new_old, "T_new_old")
        R, covariance = T[:3, :3], symmetric(se3.rotate_covariance(T[:3, :3], self.covariance))
        vectors = R @ self.point + T[:3, 3], R @ self.normal, R @ self.force
        return Contact(*vectors, self.force_normal, self.torque, covariance)


_new = object.__new__
_point, _normal, _force, _force_normal, _torque, _covariance = (
    vars(Contact)[name].__set__ for name in Contact.__slots__
)


def new_contact(vectors: Array, force_normal: float, torque: float, covariance: Array) -> Contact:
    """Returns a `Contact` in half the time of its `__init__`; `vectors` (3, 3) are its point, normal and force."""
    contact = _new(Contact)
    # Each by its index: unpacking an array takes three times as long.
    _point(contact, vectors[0])
    _normal(contact, vectors[1])
    _force(contact, vectors[2])
    _force_normal(contact, force_normal)
    _torque(contact, torque)
    _covariance(contact, covariance)
    return contact


@dataclass(frozen=True, slots=True)
class NoContact:
    """A `NoContact` says why a wrench is that of no contact; it is false as a truth value."""

    reason: ReasonName
    """One of the names of `Reason`; `invalid` occurs in batches only."""

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True, slots=True, eq=False)
class ContactBatch:
    """A `ContactBatch` has a reason for each of n wrenches, and the k contacts among them, in the tip's frame.

    `len(batch)` is n and `batch[i]` is wrench i's `Contact` or `NoContact`. The arrays hold the contacts
    only, so no row of them stands for a missing one.
    """

    reasons: NDArray[np.int8]  # (n,) `Reason` of each wrench
    rows: NDArray[np.intp]  # (k,) number of the wrench of each contact, ascending
    records: NDArray[np.void]  # (k,) the contacts as records of point, normal, force, force_normal, torque
    fingertip: Fingertip  # the tip that sensed the wrenches
    sigmas: Array  # (6,) standard deviation per axis of a reading's force [N] and torque [N m]
    _covariances: Array | None = field(default=None, init=False, repr=False)

    __repr__ = short_repr

    @property
    def points(self) -> Array:
        """(k, 3) positions on the tip [m]."""
        return np.asarray(self.records["point"])

    @property
    def normals(self) -> Array:
        """(k, 3) unit vectors in which the object pushes."""
        return np.asarray(self.records["normal"])

    @property
    def forces(self) -> Array:
        """(k, 3) forces of the object on the tip [N]."""
        return np.asarray(self.records["force"])

    @property
    def forces_normal(self) -> Array:
        """(k,) normal forces [N], above zero."""
        return np.asarray(self.records["force_normal"])

    @property
    def forces_tangential(self) -> Array:
        """(k, 3) parts of `forces` in the tangent planes [N]."""
        return np.asarray(self.forces - self.forces_normal[:, None] * self.normals)

    @property
    def torques(self) -> Array:
        """(k,) local torques about the normals [N m]."""
        return np.asarray(self.records["torque"])

    @property
    def covariances(self) -> Array:
        """(k, 6, 6) covariances of (point [m], normal) from the sensor's noise alone; computed at the first use."""
        if self._covariances is None:
            from handsight._kernels.touch import sensing

            out = np.empty((len(self.rows), 6, 6))
            sensing.covariances(self.records, self.fingertip.record, self.sigmas, out)
            object.__setattr__(self, "_covariances", out)
            return out
        return self._covariances

    def __len__(self) -> int:
        return len(self.reasons)

    @overload
    def __getitem__(self, i: int) -> Contact | NoContact: ...
    @overload
    def __getitem__(self, i: slice) -> list[Contact | NoContact]: ...
    def __getitem__(self, i: int | slice) -> Contact | NoContact | list[Contact | NoContact]:
        if isinstance(i, slice):
            return [self[j] for j in range(*i.indices(len(self)))]
        if not -len(self) <= i < len(self):
            raise IndexError(f"wrench {i} of {len(self)}")
        i = i % len(self)
        name = REASON_NAMES[self.reasons[i]]
        if name != "contact":
            return NoContact(name)
        k = int(np.searchsorted(self.rows, i))
        point, normal, force, force_normal, torque = self.records[k]
        return Contact(point, normal, force, float(force_normal), float(torque), self.covariances[k])


def symmetric(matrices: Array) -> Array:
    """Returns matrices (..., m, m) made exactly symmetric."""
    return np.asarray((matrices + np.swapaxes(matrices, -1, -2)) / 2, dtype=np.float64)


SIGMA_FORCE = 1e-2  # default standard deviation of a force reading, per axis [N]
SIGMA_TORQUE = 5e-5  # default standard deviation of a torque reading, per axis [N m]


def contact_from_wrench(
    force: ArrayLike,
    torque: ArrayLike,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
) -> Contact | NoContact:
    """Returns where and how the object touches the tip, in the tip's (surface's) frame, or a `NoContact`.

    `force` (3,) [N] and `torque` (3,) [N m] are what the object exerts on the tip, bias and weight removed: in the
    surface's frame about its centre, or, where the fingertip has a `T_surface_sensor`, in the sensor's frame about the
    sensor's origin. The sigmas are one standard deviation per axis of the reading (a number, or three, along the axes
    it comes in); the contact's covariance follows from them by the implicit function theorem.

    One contact per tip is assumed; two at once are at best recognised as `beyond_friction` or `off_cap`.
    Raises InvalidInput for NaN, infinity or a wrong shape. Source: eq. 7; Bicchi, Salisbury and Brock (1993).
    """
    load = (*_reading(force, "force"), *_reading(torque, "torque"))
    _check_fingertip(fingertip)
    sigmas = _sigmas(sigma_force, sigma_torque)
    vectors, covariance = np.empty((3, 3)), np.empty((6, 6))
    reason, force_normal, local_torque = _sense_one()(load, fingertip.record, sigmas, vectors, covariance)
    if reason == Reason.INVALID:
        checks.load(force, "force", (3,))
        checks.load(torque, "torque", (3,))
    name = REASON_NAMES[reason]
    if name != "contact":
        return NoContact(name)
    return new_contact(vectors, force_normal, local_torque, covariance)


def contacts_from_wrenches(
    forces: ArrayLike,
    torques: ArrayLike,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
) -> ContactBatch:
    """Returns the contacts of many wrenches on one tip, and a reason for each wrench that is none.

    `forces` (n, 3) [N] and `torques` (n, 3) [N m], frames and sigmas as in `contact_from_wrench`. A row with
    NaN, infinity or more than any tip can bear gets `Reason.INVALID`; the other rows are not affected.
    Raises InvalidInput for a wrong shape.
    """
    _check_fingertip(fingertip)
    F, M = _readings(forces, "forces"), _readings(torques, "torques")
    n = len(F)
    if n != len(M):
        raise InvalidInput(f"torques: expected as many rows as forces ({n}), got {len(M)}")
    sigmas = _sigmas(sigma_force, sigma_torque).copy()  # of this batch alone
    from handsight._kernels.touch.sensing import sense

    reasons, rows, records = (np.empty(n, dtype=kind) for kind in (np.int8, np.intp, TIP_CONTACT))
    k = sense(F, M, fingertip.record, reasons, rows, records)
    if 2 * k < n:  # else a few contacts would keep the memory of all wrenches alive
        return ContactBatch(reasons, rows[:k].copy(), records[:k].copy(), fingertip, sigmas)
    return ContactBatch(reasons, rows[:k], records[:k], fingertip, sigmas)


@cache
def _sense_one() -> Callable[
    [tuple[float, ...], NDArray[np.void], Array, Array, Array], tuple[int, float, float]
]:
    """Returns the kernel, imported with the first contact: importing numba takes half a second."""
    from handsight._kernels.touch.sensing import sense_one

    return sense_one


def _check_fingertip(fingertip: Fingertip) -> None:
    if not isinstance(fingertip, Fingertip):
        raise InvalidInput(f"fingertip: expected an Ellipsoid or a Sphere, got {type(fingertip).__name__}")


def _reading(value: ArrayLike, name: str) -> Iterable[float]:
    """Returns three numbers; those of a float array may be not finite, which the kernel finds out sooner."""
    if type(value) is np.ndarray and value.dtype is np.dtype(np.float64) and value.shape == (3,):
        numbers: list[float] = value.tolist()
        return numbers
    return map(float, checks.finite(value, name, (3,)))


def _readings(value: ArrayLike, name: str) -> Array:
    """Returns `value` as float64 (n, 3); rows that are not finite or too large are left to the kernel."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different length
        array = np.array("")
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
        came = f"shape {array.shape}" if array.dtype.kind in "iuf" else checks.brief(value)
        raise InvalidInput(f"{name}: expected numbers of shape (n, 3), got {came}")
    # The kernel would be compiled again for another kind of array; an array of this kind is not copied.
    return np.require(array, np.float64, ["C", "A", "W", "E"])


def _sigmas(sigma_force: ArrayLike, sigma_torque: ArrayLike) -> Array:
    """Returns positive standard deviations (6,), which are cached and must not be written to."""
    if type(sigma_force) is float and type(sigma_torque) is float:
        return _isotropic_sigmas(sigma_force, sigma_torque)
    return np.concatenate([_sigma(sigma_force, "sigma_force"), _sigma(sigma_torque, "sigma_torque")])


@lru_cache(maxsize=64)
def _isotropic_sigmas(sigma_force: float, sigma_torque: float) -> Array:
    return np.concatenate([_sigma(sigma_force, "sigma_force"), _sigma(sigma_torque, "sigma_torque")])


def _sigma(value: ArrayLike, name: str) -> Array:
    """Returns positive numbers (3,)."""
    array = checks.finite(value, name, (3,) if checks.ndim(value) else ())
    if not (array > 0).all():
        raise InvalidInput(f"{name}: expected a number above 0, or three, got {checks.brief(value)}")
    if not (array >= checks.MIN_SIGMA).all() or not (array <= checks.MAX_LOAD).all():
        limits = f"{checks.MIN_SIGMA:g} to {checks.MAX_LOAD:g}"
        raise InvalidInput(f"{name}: expected numbers from {limits}, got {checks.brief(value)}")
    return np.broadcast_to(array, (3,))
