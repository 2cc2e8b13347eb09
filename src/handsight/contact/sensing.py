"""Intrinsic contact sensing: from the wrench on a fingertip to where and how the object touches it (eq. 7).

Arguments are checked here. `handsight.contact.kernels.sensing` derives the formulas and computes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.contact.contact import REASON_NAMES, Contact, ContactBatch, NoContact
from handsight.contact.fingertips import Fingertip
from handsight.contact.kernels.sensing_records import TIP_CONTACT
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
    from handsight.contact.kernels.sensing import sense_one  # importing numba takes half a second

    F = checks.load(force, "force", (3,))
    M = checks.load(torque, "torque", (3,))
    _check_fingertip(fingertip)
    sigmas = _sigmas(sigma_force, sigma_torque)
    vectors = np.empty((3, 3))
    covariance = np.empty((6, 6))
    load = (*F.tolist(), *M.tolist())
    reason, force_normal, local_torque = sense_one(load, fingertip.record, sigmas, vectors, covariance)
    name = REASON_NAMES[reason]
    if name != "contact":
        return NoContact(name)
    point, normal, pushed = vectors
    return Contact(point, normal, pushed, force_normal, local_torque, covariance)


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
    F = _readings(forces, "forces")
    M = _readings(torques, "torques")
    n = len(F)
    if n != len(M):
        raise InvalidInput(f"torques: expected as many rows as forces ({n}), got {len(M)}")
    sigmas = _sigmas(sigma_force, sigma_torque)
    from handsight.contact.kernels.sensing import sense

    reasons, rows, records = (np.empty(n, dtype=kind) for kind in (np.int8, np.intp, TIP_CONTACT))
    k = sense(F, M, fingertip.record, reasons, rows, records)
    # Copies, as a few contacts would keep the memory of all wrenches alive.
    return ContactBatch(reasons, rows[:k].copy(), records[:k].copy(), fingertip, sigmas)


def _check_fingertip(fingertip: Fingertip) -> None:
    if not isinstance(fingertip, Fingertip):
        raise InvalidInput(f"fingertip: expected an Ellipsoid or a Sphere, got {type(fingertip).__name__}")


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
    """Returns positive standard deviations (6,)."""
    return np.concatenate([_sigma(sigma_force, "sigma_force"), _sigma(sigma_torque, "sigma_torque")])


def _sigma(value: ArrayLike, name: str) -> Array:
    """Returns positive numbers (3,)."""
    array = checks.finite(value, name, (3,) if checks.ndim(value) else ())
    if array.min() < checks.MIN_SIGMA or array.max() > checks.MAX_LOAD:
        limits = f"{checks.MIN_SIGMA:g} to {checks.MAX_LOAD:g}"
        raise InvalidInput(f"{name}: expected a number from {limits}, or three, got {checks.brief(value)}")
    return np.broadcast_to(array, (3,))
