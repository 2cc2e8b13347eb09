"""Rigid transforms as (..., 4, 4) float64 arrays, one or a stack of them.

`T_a_b` maps b-coordinates to a: `p_a = T_a_b @ p_b`. Neighbours cancel:
`T_palm_object = T_palm_camera @ T_camera_object`.

A *perturbation* `(δp, δθ)`, translation [m] first, rotation [rad] second, turns `(p, R)` into `(p + δp, exp(δθ) @ R)`,
both along the outer frame's axes. Covariances and Jacobians of a pose refer to this perturbation (as in ROS'
PoseWithCovariance).
"""

import numpy as np
from numpy.typing import ArrayLike

from handsight.checks import MAX_DISTANCE, Array, finite, unit, within
from handsight.errors import InvalidInput, InvalidTransform


def check(T: ArrayLike, name: str) -> Array:
    """Returns a copy of `T` (4, 4) if it is a rigid transform on or near a robot; raises InvalidTransform."""
    try:
        array = finite(T, name, (4, 4))
        within(array[:3, 3], f"{name}: translation", MAX_DISTANCE, "metres")
    except InvalidInput as error:
        raise InvalidTransform(str(error)) from None
    R = array[:3, :3]
    # Huge entries would overflow.
    drift = np.abs(R.T @ R - np.eye(3)).max() if np.abs(R).max() < 2 else np.inf
    if not drift < 1e-6:
        raise InvalidTransform(f"{name}: rotation is not orthonormal (drift {drift:.1e})")
    if np.linalg.det(R) < 0:
        raise InvalidTransform(f"{name}: expected a rotation, got a reflection (determinant -1)")
    if np.abs(array[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise InvalidTransform(f"{name}: expected the last row [0, 0, 0, 1], got {array[3].tolist()}")
    return array


def rounded(T: ArrayLike, name: str) -> Array:
    """Returns the rigid transform nearest to a matrix (4, 4) with rounded numbers, as other programs write them.

    Raises InvalidTransform as `check` does, where the rotation is off by more than a thousandth.
    """
    matrix = np.array(T, dtype=np.float64)
    if matrix.shape == (4, 4) and np.isfinite(matrix).all() and np.abs(matrix[:3, :3]).max() < 2:
        U, values, V = np.linalg.svd(matrix[:3, :3])
        if np.abs(values - 1).max() <= 1e-3:
            matrix[:3, :3] = U @ V
    return check(matrix, name)


def compose(R: Array, p: Array) -> Array:
    """Returns transforms (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3) [m]."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1.0
    return T


def translation(p: ArrayLike) -> Array:
    """Returns the transform (4, 4) of a translation (3,) [m] alone."""
    return compose(np.eye(3), np.asarray(p))


def inverse(T_a_b: Array) -> Array:
    """Returns `T_b_a`, by transposing the rotation."""
    Rt = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return compose(Rt, -np.einsum("...ij,...j->...i", Rt, T_a_b[..., :3, 3]))


def apply(T_a_b: Array, points_b: Array) -> Array:
    """Returns the points (..., n, 3) [m] in a's coordinates."""
    moved_points = points_b @ np.swapaxes(T_a_b[..., :3, :3], -1, -2) + T_a_b[..., None, :3, 3]
    return np.asarray(moved_points, dtype=np.float64)


_SKEW = np.zeros((3, 9))
_SKEW[2, 1] = _SKEW[0, 5] = _SKEW[1, 6] = -1.0
_SKEW[1, 2] = _SKEW[2, 3] = _SKEW[0, 7] = 1.0
_UNSKEW = _SKEW.T / 2
_TINY = 1e-300  # the least squared angle: it keeps sin x / x from 0 / 0


def skew(v: Array) -> Array:
    """Returns the matrices (..., 3, 3) with `skew(v) @ x = v × x`."""
    return np.asarray((v @ _SKEW).reshape(*v.shape, 3))


def point_jacobian(arm: Array) -> Array:
    """Returns the derivatives (..., 6, 6) of (δp, δθ) at a point of a body by (δp, δθ) at the body's origin.

    `arm` (..., 3) leads from the origin to the point, along the outer frame's axes [m]. The point moves by
    δp - [arm]ₓ δθ, because a rotation acts over the lever arm; the first three rows are the derivative of the point.
    """
    J = np.eye(6) + np.zeros((*arm.shape[:-1], 1, 1))
    J[..., :3, 3:] = -skew(arm)
    return J


def rotation_exp(w: Array) -> Array:
    """Returns the rotations (..., 3, 3) about the axes `w` (..., 3), by angles of their lengths [rad] (Rodrigues)."""
    half = 0.5 * np.sqrt(np.maximum((w * w).sum(axis=-1), _TINY))[..., None, None]
    # (1 - cos x)/x² = (sin(x/2)/(x/2))²/2 and sin x/x = sin(x/2)/(x/2) cos(x/2): nothing cancels near 0.
    ratio = np.sin(half) / half
    S = skew(w)
    return np.asarray(np.eye(3) + (ratio * np.cos(half)) * S + (0.5 * ratio * ratio) * (S @ S))


def rotation_log(R: Array) -> Array:
    """Returns the rotation vectors (..., 3) [rad], of length ≤ π; accurate near 0 and near π."""
    vector = R.reshape(*R.shape[:-2], 9) @ _UNSKEW  # sin(angle) axis
    sine = np.sqrt(np.maximum((vector * vector).sum(axis=-1), _TINY))
    cosine = (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1) / 2
    if not (cosine < -0.9).any():
        return np.asarray((np.arctan2(sine, cosine) / sine)[..., None] * vector)
    # Near half a turn the sine vanishes, so it no longer gives the axis; the quaternion does.
    q = quaternion_from_rotation(R)
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    angle = 2 * np.arctan2(sine, q[..., 3])
    small = sine < 1e-9
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, sine))
    return np.asarray(factor[..., None] * q[..., :3])


def quaternion_from_rotation(R: Array) -> Array:
    """Returns unit `quaternion_xyzw` (..., 4), the largest component positive (Shepperd's choice of divisor)."""
    a, b, c, d, e, f, g, h, i = R.reshape(-1, 9).T
    # Column k of the symmetric 4 x 4 matrix 4 q qᵀ is q scaled by 4 q_k: take the longest.
    x = 1 + a - e - i
    y = 1 - a + e - i
    z = 1 - a - e + i
    w = 1 + a + e + i
    columns = (
        (x, b + d, c + g, h - f),
        (b + d, y, f + h, c - g),
        (c + g, f + h, z, d - b),
        (h - f, c - g, d - b, w),
    )
    q = np.array(columns)[np.argmax([x, y, z, w], axis=0), :, np.arange(len(x))]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.asarray(q.reshape(*R.shape[:-2], 4), dtype=np.float64)


def rotation_from_quaternion(quaternion_xyzw: Array) -> Array:
    """Returns the rotations (..., 3, 3) of quaternions (..., 4), which need not have length 1."""
    q = quaternion_xyzw / np.linalg.norm(quaternion_xyzw, axis=-1, keepdims=True)
    S = skew(q[..., :3])
    return np.asarray(np.eye(3) + 2 * (q[..., 3, None, None] * S + S @ S))


def moved(T: Array, perturbation: Array) -> Array:
    """Returns `T` (..., 4, 4) after the perturbation (δp, δθ): `p + δp`, `exp(δθ) @ R`."""
    shift = perturbation[..., :3]
    turn = perturbation[..., 3:]
    return compose(rotation_exp(turn) @ T[..., :3, :3], T[..., :3, 3] + shift)


def difference(T: Array, T_reference: Array) -> Array:
    """Returns the perturbation (δp, δθ), (..., 6), with `moved(T_reference, δ) = T`."""
    w = rotation_log(T[..., :3, :3] @ np.swapaxes(T_reference[..., :3, :3], -1, -2))
    return np.concatenate([T[..., :3, 3] - T_reference[..., :3, 3], w], axis=-1)


def rotate_covariance(R_a_b: Array, covariance_b: Array) -> Array:
    """Returns a covariance or information (6, 6) of (δp, δθ) along a's axes, from one along b's axes."""
    B = np.zeros((6, 6))
    B[:3, :3] = B[3:, 3:] = R_a_b
    return np.asarray(B @ covariance_b @ B.T, dtype=np.float64)


def random(rng: np.random.Generator, size: int | None = None, *, spread: float = 1.0) -> Array:
    """Returns random transforms (4, 4) or (size, 4, 4): rotation uniform on SO(3), position N(0, spread²) [m]."""
    lead = () if size is None else (size,)
    R = rotation_from_quaternion(rng.normal(size=(*lead, 4)))
    return compose(R, spread * rng.normal(size=(*lead, 3)))


def from_position_quaternion(position: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """Returns the transform (4, 4) of a ROS pose; raises InvalidInput where the quaternion is zero or not finite."""
    R = rotation_from_quaternion(unit(quaternion_xyzw, "quaternion_xyzw", (4,)))
    return compose(R, finite(position, "position", (3,)))


def position_quaternion(T: Array) -> dict[str, Array]:
    """Returns the position and the `quaternion_xyzw` of a transform (4, 4), by their names in files."""
    return {"position": T[:3, 3], "quaternion_xyzw": quaternion_from_rotation(T[:3, :3])}


def perpendicular(vectors: Array) -> Array:
    """Returns unit vectors (..., 3) at right angles to vectors (..., 3), none of which is zero."""
    side = np.cross(vectors, np.eye(3)[np.abs(vectors).argmin(axis=-1)])
    return np.asarray(side / np.linalg.norm(side, axis=-1, keepdims=True))


def axes_along(first: Array, second: Array) -> Array:
    """Returns axes (3, 3), the columns: a direction (3,), the part of a second one across it, and their product."""
    x = first / np.linalg.norm(first)
    y = second - (second @ x) * x
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def directions(n: int) -> Array:
    """Returns n unit vectors (n, 3), evenly distributed over the sphere (a Fibonacci lattice)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    angle = np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
