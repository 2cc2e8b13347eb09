"""Intrinsic contact sensing: a wrench on a fingertip to where and how the object touches it (eq. 7).

The object pushes with force F at p, and twists by a local torque along the normal. About the centre of the
ellipsoid pᵀA p = 1 the torque is M = p × F + k A p: four equations for p and k. Bicchi, Salisbury and Brock
(1993) solve them through a quartic in k whose answer is 0/0 where k vanishes. Here, instead:

* With W = √A, q = W p, f = W F, m = |W| W⁻¹ M, κ = |W| k, eq. 7 becomes that of the unit sphere,
  q × f + κ q = m, |q| = 1: an ellipsoid is a sphere seen through W.
* c = q·f obeys c κ = f·m and c² - κ² = |f|² - |m|², that is (c + iκ)² = |f|² - |m|² + 2i f·m. One complex
  square root gives both, and the object can only push: Re(c + iκ) < 0. Nothing cancels, and κ = 0 is no
  special case.
* q = (c f + κ m + f × m) / (|f|² + κ²); for κ = 0 this is where the wrench's axis pierces the sphere.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact.contact import Contact, ContactBatch, NoContact, Reason, symmetric
from handsight.contact.fingertip import Ellipsoid, Fingertip, Sphere
from handsight.errors import InvalidInput

SIGMA_FORCE = 1e-2
"""Default noise of a force reading, one standard deviation per axis [N]."""
SIGMA_TORQUE = 5e-5
"""Default noise of a torque reading, one standard deviation per axis [N m]."""
GRAZING = 1e-6
"""A push counts as one from this cosine (on the sphere) on; below, the wrench's axis misses the surface."""
VANISHING = 1e-150
"""A force this much smaller than its torque, in doubles, has no direction left."""


def contact_from_wrench(
    force: ArrayLike,
    torque: ArrayLike,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
) -> Contact | NoContact:
    """Where and how the object touches the tip, in the tip's (surface's) frame, or `NoContact` and why.

    `force` (3,) [N] and `torque` (3,) [N m] are what the object exerts on the tip, bias and weight removed:
    in the surface's frame about its centre, or, where the fingertip has a `T_surface_sensor`, in the sensor's
    frame about the sensor's origin. The sigmas are one standard deviation per axis of the reading (a number,
    or three, along the axes it comes in); the contact's covariance follows from them by the implicit function
    theorem.

    One contact per tip is assumed; two at once show, at best, as `beyond_friction` or `off_cap`.
    Raises InvalidInput for NaN, infinity or a wrong shape. Source: eq. 7; Bicchi, Salisbury and Brock (1993).
    """
    forces = checks.finite(force, "force", (3,))[None]
    torques = checks.finite(torque, "torque", (3,))[None]
    batch = contacts_from_wrenches(
        forces, torques, fingertip, sigma_force=sigma_force, sigma_torque=sigma_torque
    )
    return batch[0]


def contacts_from_wrenches(
    forces: ArrayLike,
    torques: ArrayLike,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
) -> ContactBatch:
    """The contacts of many wrenches on one tip, and a reason for every wrench that is none.

    `forces` (n, 3) [N] and `torques` (n, 3) [N m], frames and sigmas as in `contact_from_wrench`. A row with
    NaN or infinity gets `Reason.INVALID` and the others are still answered. Raises InvalidInput for a wrong
    shape.
    """
    if not isinstance(fingertip, Ellipsoid | Sphere):
        raise InvalidInput(f"fingertip: expected an Ellipsoid or a Sphere, got {type(fingertip).__name__}")
    F, M = _readings(forces, "forces"), _readings(torques, "torques")
    if len(F) != len(M):
        raise InvalidInput(f"torques: expected as many rows as forces ({len(F)}), got {len(M)}")
    sigmas = np.concatenate([_sigma(sigma_force, "sigma_force"), _sigma(sigma_torque, "sigma_torque")])

    reasons = np.full(len(F), Reason.FREE, dtype=np.int8)
    reasons[~(np.isfinite(F).all(axis=1) & np.isfinite(M).all(axis=1))] = Reason.INVALID
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        strength = np.hypot(np.hypot(F[:, 0], F[:, 1]), F[:, 2])
        loaded = np.flatnonzero((reasons != Reason.INVALID) & (strength >= fingertip.min_force))
        push = _push(F[loaded], M[loaded], fingertip)
        reasons[loaded] = _judge(push, fingertip)
        touching = reasons[loaded] == Reason.CONTACT
        return _batch(reasons, loaded[touching], _taken(push, touching), fingertip, sigmas)


class _Push(NamedTuple):
    """Solutions of eq. 7 on the unit sphere, for forces and torques divided by `scale`."""

    scale: Array
    """(k,) a power of two, so that dividing by it is exact."""
    forces: Array
    """(k, 3) along the surface's axes."""
    q: Array
    """(k, 3) the point on the unit sphere."""
    c: Array
    """(k,) q · f; negative where the object pushes."""
    kappa: Array
    """(k,)"""
    grazing: NDArray[np.bool_]
    """(k,) bool: no push, the axis misses."""


def _push(F: Array, M: Array, fingertip: Fingertip) -> _Push:
    """The one push that explains each wrench (the other root of eq. 7 is the pull from the other side)."""
    largest = np.maximum(np.abs(F).max(axis=1, initial=0.0), np.abs(M).max(axis=1, initial=0.0))
    # Exponents are those of the doubles themselves: no finite wrench over- or underflows below.
    scale = np.ldexp(1.0, np.frexp(largest)[1] - 1)
    F, M = F / scale[:, None], M / scale[:, None]
    T = fingertip.T_surface_sensor
    if T is not None:
        F = F @ T[:3, :3].T
        M = M @ T[:3, :3].T + np.cross(T[:3, 3], F)
    W = 1 / fingertip.semi_axes
    f, m = F * W, M * (W.prod() / W)

    ff, mm = (f * f).sum(axis=1), (m * m).sum(axis=1)
    root = -np.sqrt((ff - mm) + 2j * (f * m).sum(axis=1))
    c, kappa = root.real, root.imag
    q = c[:, None] * f + kappa[:, None] * m + np.cross(f, m)
    grazing = ~(c < -np.maximum(GRAZING * np.sqrt(ff), VANISHING))
    length = np.linalg.norm(q, axis=1, keepdims=True)
    # The length is |f|² + κ², but for rounding: dividing by it lands on the surface.
    return _Push(scale, F, q / np.where(length > 0, length, 1.0), c, kappa, grazing)


def _judge(push: _Push, fingertip: Fingertip) -> NDArray[np.int8]:
    """(k,) reasons."""
    reasons = np.full(len(push.c), Reason.CONTACT, dtype=np.int8)
    if fingertip.max_friction is not None:
        normals = _normals(push.q, fingertip)
        normal = (push.forces * normals).sum(axis=1)
        tangential = np.linalg.norm(push.forces - normal[:, None] * normals, axis=1)
        reasons[tangential > fingertip.max_friction * normal] = Reason.BEYOND_FRICTION
    if fingertip.cap is not None:
        reasons[push.q[:, 2] * fingertip.semi_axes[2] < fingertip.cap] = Reason.OFF_CAP
    reasons[push.grazing] = Reason.OFF_CAP
    return reasons


def _batch(
    reasons: NDArray[np.int8], rows: NDArray[np.intp], push: _Push, fingertip: Fingertip, sigmas: Array
) -> ContactBatch:
    """The contacts back from the sphere and the scale."""
    W = 1 / fingertip.semi_axes
    steepness = np.linalg.norm(push.q * W, axis=1)
    return ContactBatch(
        reasons=reasons,
        rows=rows,
        points=push.q * fingertip.semi_axes,
        normals=_normals(push.q, fingertip),
        forces=_rescaled(push.forces, push.scale[:, None]),
        forces_normal=_rescaled(-push.c / steepness, push.scale),
        torques=_rescaled(-push.kappa * steepness / W.prod(), push.scale),
        covariances=_covariances(push, fingertip, sigmas),
    )


def _covariances(push: _Push, fingertip: Fingertip, sigmas: Array) -> Array:
    """(k, 6, 6) of (point, normal), by the implicit function theorem.

    On the sphere δq is tangent and κ δq - c q × δq is the tangent part of r = δm - q × δf, so
    δq = (κ P + c [q]×) r / (κ² + c²), P = I - q qᵀ.
    """
    W = 1 / fingertip.semi_axes
    q, kappa, c = push.q, push.kappa[:, None, None], push.c[:, None, None]
    cross = se3.skew(q)
    by_r = (kappa * (np.eye(3) - q[:, :, None] * q[:, None, :]) + c * cross) / (kappa**2 + c**2)
    by_torque = by_r * (W.prod() / W)
    by_force = -(by_r @ cross) * W
    T = fingertip.T_surface_sensor
    if T is not None:
        by_force = (by_force + by_torque @ se3.skew(T[:3, 3])) @ T[:3, :3]
        by_torque = by_torque @ T[:3, :3]
    by_reading = np.concatenate([by_force, by_torque], axis=-1) * (sigmas / push.scale[:, None, None])

    normals, steepness = _normals(q, fingertip), np.linalg.norm(q * W, axis=1)
    flat = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    normal_by_q = -flat * W / steepness[:, None, None]
    spread = np.concatenate([by_reading / W[:, None], normal_by_q @ by_reading], axis=1)
    return symmetric(spread @ spread.swapaxes(-1, -2))


def _normals(q: Array, fingertip: Fingertip) -> Array:
    """(k, 3) into the tip, the way the object pushes."""
    outward = q / fingertip.semi_axes
    return np.asarray(-outward / np.linalg.norm(outward, axis=1, keepdims=True), dtype=np.float64)


def _taken(push: _Push, rows: NDArray[np.bool_]) -> _Push:
    return _Push(
        push.scale[rows],
        push.forces[rows],
        push.q[rows],
        push.c[rows],
        push.kappa[rows],
        push.grazing[rows],
    )


def _rescaled(values: Array, scale: Array) -> Array:
    """`values * scale`, kept finite where only the product overflows."""
    most = np.finfo(np.float64).max
    return np.clip(values * scale, -most, most)


def _readings(value: ArrayLike, name: str) -> Array:
    """`value` as float64 (n, 3); NaN and infinity pass, they are a row's own matter."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        raise InvalidInput(f"{name}: expected numbers of shape (n, 3), got {checks.brief(value)}") from None
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
        came = f"shape {array.shape}" if array.dtype.kind in "iuf" else checks.brief(value)
        raise InvalidInput(f"{name}: expected numbers of shape (n, 3), got {came}")
    return array.astype(np.float64)


def _sigma(value: ArrayLike, name: str) -> Array:
    """(3,) positive."""
    array = checks.finite(value, name, (3,) if np.ndim(value) else ())
    if not (array > 0).all():
        raise InvalidInput(f"{name}: expected a number above 0, or three, got {checks.brief(value)}")
    return np.broadcast_to(array, (3,))
