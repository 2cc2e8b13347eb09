"""Intrinsic contact sensing (eq. 7) in plain NumPy: the slow truth of `handsight.contact.kernels.sensing`.

Its formulas are derived in `handsight.contact.kernels.sensing`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.checks import MAX_LOAD, Array
from handsight.contact import Fingertip, Reason

GRAZING = 1e-6
"""A push counts as one from this cosine (on the sphere) on; below, the wrench's axis misses the surface."""


class Sensed(NamedTuple):
    """What `ContactBatch` says."""

    reasons: NDArray[np.int8]
    rows: NDArray[np.intp]
    points: Array
    normals: Array
    forces: Array
    forces_normal: Array
    torques: Array
    covariances: Array


def sense(F: Array, M: Array, fingertip: Fingertip, sigmas: Array) -> Sensed:
    """What forces and torques (n, 3) say; `sigmas` (6) of a reading of both."""
    reasons = np.full(len(F), Reason.FREE, dtype=np.int8)
    reasons[~(np.abs(np.hstack([F, M])) <= MAX_LOAD).all(axis=1)] = Reason.INVALID  # NaN is not below either
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        strength = np.hypot(np.hypot(F[:, 0], F[:, 1]), F[:, 2])
        loaded = np.flatnonzero((reasons != Reason.INVALID) & (strength >= fingertip.min_force))
        push = _push(F[loaded], M[loaded], fingertip)
        reasons[loaded] = _judge(push, fingertip)
        touching = reasons[loaded] == Reason.CONTACT
        return _sensed(reasons, loaded[touching], _taken(push, touching), fingertip, sigmas)


class _Push(NamedTuple):
    """Solutions of eq. 7 on the unit sphere."""

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
    grazing = ~(c < -GRAZING * np.sqrt(ff))
    length = np.linalg.norm(q, axis=1, keepdims=True)
    # The length is |f|² + κ², but for rounding: dividing by it lands on the surface.
    return _Push(F, q / np.where(length > 0, length, 1.0), c, kappa, grazing)


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


def _sensed(
    reasons: NDArray[np.int8], rows: NDArray[np.intp], push: _Push, fingertip: Fingertip, sigmas: Array
) -> Sensed:
    """The contacts back from the sphere."""
    W = 1 / fingertip.semi_axes
    steepness = np.linalg.norm(push.q * W, axis=1)
    return Sensed(
        reasons=reasons,
        rows=rows,
        points=push.q * fingertip.semi_axes,
        normals=_normals(push.q, fingertip),
        forces=push.forces,
        forces_normal=-push.c / steepness,
        torques=-push.kappa * steepness / W.prod(),
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
    by_reading = np.concatenate([by_force, by_torque], axis=-1) * sigmas

    normals, steepness = _normals(q, fingertip), np.linalg.norm(q * W, axis=1)
    flat = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    normal_by_q = -flat * W / steepness[:, None, None]
    spread = np.concatenate([by_reading / W[:, None], normal_by_q @ by_reading], axis=1)
    return spread @ spread.swapaxes(-1, -2)


def _normals(q: Array, fingertip: Fingertip) -> Array:
    """(k, 3) into the tip, the way the object pushes."""
    outward = q / fingertip.semi_axes
    return np.asarray(-outward / np.linalg.norm(outward, axis=1, keepdims=True), dtype=np.float64)


def _taken(push: _Push, rows: NDArray[np.bool_]) -> _Push:
    return _Push(*(values[rows] for values in push))
