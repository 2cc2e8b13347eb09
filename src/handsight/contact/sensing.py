"""Intrinsic contact sensing: from the wrench on a fingertip to where and how the object touches it (eq. 7).

Arguments are checked here. `handsight._kernels.touch.sensing` derives the formulas and computes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.touch.sensing_records import TIP_CONTACT
from handsight.checks import Array
from handsight.contact.contact import REASON_NAMES, Contact, ContactBatch, NoContact, Reason, new_contact
from handsight.contact.fingertips import Fingertip
from handsight.errors import InvalidInput

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
