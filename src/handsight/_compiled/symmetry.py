"""Poses to and from records and matrices, and the equivalent poses of a symmetric object."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.records import AXIS, MOST_ROTATIONS, NO_SYMMETRY
from handsight._compiled.so3 import rotation_about, rotation_log
from handsight._compiled.vec3 import (
    Pose,
    apply,
    dot,
    matmul,
    matrix,
    mul,
    store,
    store33,
    sub,
    transpose,
    vector,
)


@inner
def pose_of(record: Any) -> Pose:
    """Returns the pose of a POSE record."""
    return matrix(record.rotation), vector(record.position)


@inner
def store_pose(pose: Pose, record: Any) -> None:
    """Writes a POSE record."""
    store33(pose[0], record.rotation)
    store(pose[1], record.position)


@inner
def transform_of(T: Any) -> Pose:
    """Returns the pose of a transform (4, 4)."""
    return matrix(T), vector(T[:3, 3])


@inner
def store_transform(pose: Pose, T: Any) -> None:
    """Writes a transform (4, 4)."""
    store33(pose[0], T)
    store(pose[1], T[:3, 3])
    T[3, 0] = T[3, 1] = T[3, 2] = 0.0
    T[3, 3] = 1.0


@inner
def _equivalent(symmetry: Any, k: int, pose: Pose, reference: Pose) -> Pose:
    """Returns a pose times the k-th element of the symmetry group and, for an object with an axis, spun about it to be
    nearest to the reference."""
    R, p = transform_of(symmetry.rotation[k])
    R = matmul(pose[0], R)
    p = apply(pose, p)
    if symmetry.kind == AXIS:
        # The axis goes through the origin. The trace of Q exp(φ a) is c cos φ - s sin φ and what does not depend on φ.
        axis = vector(symmetry.axis[0])
        Q = matmul(transpose(reference[0]), R)
        s = dot(axis, (Q[2][1] - Q[1][2], Q[0][2] - Q[2][0], Q[1][0] - Q[0][1]))
        c = Q[0][0] + Q[1][1] + Q[2][2] - dot(axis, mul(Q, axis))
        length = np.sqrt(c * c + s * s)
        if length > 1e-12:
            R = matmul(R, rotation_about(axis, c / length, -s / length))
    return R, p


@inner
def nearest(model: Any, pose: Pose, reference: Pose) -> Pose:
    """Returns the equivalent of a pose nearest to the reference in |δp|² + radius² |δθ|²; of equal ones the first."""
    symmetry, radius = model.symmetry, model.radius
    if symmetry.kind == NO_SYMMETRY:
        return pose
    costs = np.empty(MOST_ROTATIONS)
    least = np.inf
    for k in range(symmetry.rotations):
        R, p = _equivalent(symmetry, k, pose, reference)
        shift = sub(p, reference[1])
        turn = rotation_log(matmul(R, transpose(reference[0])))
        costs[k] = dot(shift, shift) + radius * radius * dot(turn, turn)
        least = min(least, costs[k])
    chosen = 0
    # A tie to within rounding goes to the earlier element, so that the answer does not change from call to call.
    while chosen < symmetry.rotations and not costs[chosen] <= least * (1 + 1e-9) + 1e-18:
        chosen += 1
    if chosen == symmetry.rotations:
        return pose
    return _equivalent(symmetry, chosen, pose, reference)


@inner
def are_distinct(model: Any, a: Pose, b: Pose, limits: Any) -> bool:
    """Returns whether two poses differ by more than a shift of the object's center [m] or a turn [rad], modulo
    symmetry."""
    near = nearest(model, a, b)
    center = vector(model.center)
    gap = sub(apply(near, center), apply(b, center))
    if dot(gap, gap) > limits[0] * limits[0]:
        return True
    turn = rotation_log(matmul(near[0], transpose(b[0])))
    return dot(turn, turn) > limits[1] * limits[1]


@entry
def equivalent(model: Any, Ts: Any, T_reference: Any, out: Any) -> None:
    """Fills `out` (n, 4, 4) with the equivalents of poses (n, 4, 4) nearest to the reference (4, 4)."""
    for k in range(len(Ts)):
        store_transform(nearest(model[0], transform_of(Ts[k]), transform_of(T_reference)), out[k])
