"""A prior on the pose as evidence: vision's, or the weak one on the position that stands in for it when blind.

Judged at a pivot that no symmetry moves, and by the swing of the axis alone: a spin about it costs nothing.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.math.dense6 import eigen
from handsight._kernels.math.simd import accumulate
from handsight._kernels.math.vec3 import (
    Mat33,
    Vec3,
    add,
    add33,
    block,
    cross,
    dot,
    matmul,
    matrix,
    mul,
    norm,
    outer,
    scale,
    scale33,
    skew,
    store,
    store33,
    sub,
    sub33,
    transpose,
    vector,
)
from handsight._kernels.records import NO_PRIOR, VISION_PRIOR, WEAK_PRIOR
from handsight._kernels.runtime.compilation import inner

IDENTITY: Mat33 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@inner
def weak_position_prior(model: Any, center: Vec3, prior: Any) -> None:
    """Fills in the prior of an answer without vision: object center ~ N(contact centroid, radius²) per axis.

    It selects among equal minima, and is excluded from the information that is reported.
    """
    prior.kind, prior.has_axis = WEAK_PRIOR, 0
    store(vector(model.center), prior.pivot_object)
    store((0.0, 0.0, 0.0), prior.axis_object)
    store(center, prior.pivot_palm)
    store33(IDENTITY, prior.rotation)
    prior.information[:] = 0.0
    for k in range(3):
        prior.information[k, k] = 1 / (model.radius * model.radius)


@inner
def vision_prior(model: Any, vision: Any, prior: Any, u: Any) -> None:
    """Fills in the evidence of a pose and its covariance about an object so symmetric."""
    symmetry, R = model.symmetry, matrix(vision.pose.rotation)
    _information(vision.covariance, model.radius, prior.information, u)
    prior.kind, prior.has_axis = VISION_PRIOR, symmetry.axes
    arm = mul(R, vector(symmetry.pivot))
    store(vector(symmetry.pivot), prior.pivot_object)
    store((symmetry.axis[0, 0], symmetry.axis[0, 1], symmetry.axis[0, 2]), prior.axis_object)
    store(add(vector(vision.pose.position), arm), prior.pivot_palm)
    store33(R, prior.rotation)
    # δp of the origin is that of the pivot less what the turn does to the arm between: Fᵀ Λ F, F = [1, [arm]x; 0, 1].
    lever, information = skew(arm), prior.information
    A, B, D = block(information, 0, 0), block(information, 0, 3), block(information, 3, 3)
    AF = matmul(A, lever)
    B_new = add33(AF, B)
    mixed = matmul(transpose(lever), B)
    D_new = add33(add33(D, matmul(transpose(lever), AF)), add33(mixed, transpose(mixed)))
    _store_blocks(A, B_new, D_new, information)
    for k in range(symmetry.axes):
        _forget_spin(mul(R, vector(symmetry.axis[k])), information)


@inner
def _information(covariance: Any, radius: float, out: Any, u: Any) -> None:
    """Fills `out` (6, 6) with the inverse of a covariance (6, 6), no deviation below 1e-5 of the radius."""
    scaled, vectors, values = u.matrix, u.vectors, u.values
    for i in range(6):
        for j in range(6):
            scaled[i, j] = covariance[i, j] * ((1.0 if i < 3 else radius) * (1.0 if j < 3 else radius))
    eigen(scaled, values, vectors)
    for k in range(6):
        values[k] = 1 / max(values[k], (1e-5 * radius) ** 2)
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += vectors[i, k] * values[k] * vectors[j, k]
            out[i, j] = total * ((1.0 if i < 3 else radius) * (1.0 if j < 3 else radius))


@inner
def _store_blocks(A: Mat33, B: Mat33, D: Mat33, out: Any) -> None:
    """Fills `out` (6, 6) = [A, B; Bᵀ, D]."""
    for i in range(3):
        for j in range(3):
            out[i, j], out[3 + i, 3 + j] = A[i][j], D[i][j]
            out[i, 3 + j] = out[3 + j, i] = B[i][j]


@inner
def _forget_spin(axis: Vec3, information: Any) -> None:
    """Takes what is known of the turn about an axis of the palm out of an information (6, 6)."""
    by_shift, by_turn = mul(block(information, 0, 3), axis), mul(block(information, 3, 3), axis)
    along = max(dot(axis, by_turn), 1e-300)
    turned = by_shift + by_turn
    for i in range(6):
        for j in range(6):
            information[i, j] -= turned[i] * turned[j] / along


@inner
def turn_between(prior: Any, R: Mat33) -> tuple[Vec3, Mat33]:
    """Returns the rotation vector from the prior's rotation, or axis, to R, and its derivative by a turn of R."""
    if prior.has_axis:
        axis = vector(prior.axis_object)
        return swing(mul(matrix(prior.rotation), axis), mul(R, axis))
    turn = rotation_log(matmul(R, transpose(matrix(prior.rotation))))
    return turn, _log_derivative(turn)


@inner
def swing(axis_from: Vec3, axis_to: Vec3) -> tuple[Vec3, Mat33]:
    """Returns the shortest rotation vector from one axis to another, and its derivative by a turn of the other.

    With n the vector's direction and angle α, a turn δθ changes it by (n nᵀ + α / sin α (n × from)(n × to)ᵀ) δθ:
    nothing about the axis itself.
    """
    product = cross(axis_from, axis_to)
    sine = norm(product)
    if sine < 1e-9:
        return product, sub33(IDENTITY, outer(axis_to, axis_to))
    stretch = np.arctan2(sine, dot(axis_to, axis_from)) / sine
    n = scale(product, 1 / sine)
    sideways = scale33(outer(cross(n, axis_from), cross(n, axis_to)), stretch)
    return scale(product, stretch), add33(outer(n, n), sideways)


@inner
def _log_derivative(turn: Vec3) -> Mat33:
    """Returns the derivative of the rotation vector by a further turn: 1 - [w]x/2 + b [w]x²."""
    square = dot(turn, turn)
    half = 0.5 * np.sqrt(square)
    b = 1 / 12 + half * half / 180
    if half >= 5e-3:
        b = (1 - half / np.tan(half)) / (4 * half * half)
    bent = sub33(outer(turn, turn), scale33(IDENTITY, square))
    return add33(sub33(IDENTITY, scale33(skew(turn), 0.5)), scale33(bent, b))


@inner
def rotation_exp(turn: Vec3) -> Mat33:
    """Returns the rotation of a rotation vector."""
    half = 0.5 * norm(turn)
    ratio = np.sin(half) / half if half > 1e-9 else 1.0
    S = skew(turn)
    return add33(
        IDENTITY, add33(scale33(S, ratio * np.cos(half)), scale33(matmul(S, S), 0.5 * ratio * ratio))
    )


@inner
def rotation_log(Q: Mat33) -> Vec3:
    """Returns the rotation vector of a rotation; exact near 0 and near π."""
    v = (Q[2][1] - Q[1][2]) / 2, (Q[0][2] - Q[2][0]) / 2, (Q[1][0] - Q[0][1]) / 2
    sine, trace = norm(v), Q[0][0] + Q[1][1] + Q[2][2]
    cosine = (trace - 1) / 2
    if cosine >= -0.9:
        return scale(v, np.arctan2(sine, cosine) / sine if sine >= 1e-9 else 1.0)
    # Near π the quaternion keeps the axis: the longest column of 4 q qᵀ, real part w last.
    if Q[0][0] >= Q[1][1] and Q[0][0] >= Q[2][2]:
        q, w = (1 + 2 * Q[0][0] - trace, Q[0][1] + Q[1][0], Q[0][2] + Q[2][0]), 2 * v[0]
    elif Q[1][1] >= Q[2][2]:
        q, w = (Q[0][1] + Q[1][0], 1 + 2 * Q[1][1] - trace, Q[1][2] + Q[2][1]), 2 * v[1]
    else:
        q, w = (Q[0][2] + Q[2][0], Q[1][2] + Q[2][1], 1 + 2 * Q[2][2] - trace), 2 * v[2]
    length = norm(q)
    angle = 2 * np.arctan2(length, abs(w))
    return scale(q, (-angle if w < 0 else angle) / length)


@inner
def _error(prior: Any, pose: Pose) -> tuple[Vec3, Vec3]:
    """Returns the pivot in the palm, and how far it is from the prior's."""
    R, p = pose
    pivot = add(p, mul(R, vector(prior.pivot_object)))
    return pivot, sub(pivot, vector(prior.pivot_palm))


@inner
def add_prior(prior: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the prior's rows, of the pivot and of the turn, where there is a prior."""
    if prior.kind == NO_PRIOR:
        return
    center, radius = frame
    pivot, off = _error(prior, pose)
    turn, D = turn_between(prior, pose[0])
    # The pivot moves by τ + ω × (pivot - center).
    by_turn = skew(scale(sub(center, pivot), 1 / radius))
    D = scale33(D, 1 / radius)
    still = (0.0, 0.0, 0.0)
    rows = (
        (1.0, 0.0, 0.0) + by_turn[0] + (off[0],),
        (0.0, 1.0, 0.0) + by_turn[1] + (off[1],),
        (0.0, 0.0, 1.0) + by_turn[2] + (off[2],),
        still + D[0] + (turn[0],),
        still + D[1] + (turn[1],),
        still + D[2] + (turn[2],),
    )
    accumulate(prior.information, rows, equations)


@inner
def prior_cost(prior: Any, pose: Pose) -> float:
    """Returns the prior's squared residuals at a pose; 0 where there is none."""
    if prior.kind == NO_PRIOR:
        return 0.0
    _, off = _error(prior, pose)
    turn, _ = turn_between(prior, pose[0])
    A, B, D = block(prior.information, 0, 0), block(prior.information, 0, 3), block(prior.information, 3, 3)
    return dot(off, add(mul(A, off), scale(mul(B, turn), 2.0))) + dot(turn, mul(D, turn))


@inner
def prior_width(model: Any, prior: Any) -> float:
    """Returns how far the prior lets a point of the surface be, root mean square, as a fraction of the diameter."""
    C, c = prior.covariance, mul(matrix(prior.pose.rotation), vector(model.center))
    turn = C[3, 3] + C[4, 4] + C[5, 5]
    # Of the object's center: δp + δθ × c.
    spread = C[0, 0] + C[1, 1] + C[2, 2] + dot(c, c) * turn
    for i in range(3):
        for j in range(3):
            spread -= c[i] * C[3 + i, 3 + j] * c[j]
        k, m = (i + 1) % 3, (i + 2) % 3
        spread += 2 * (C[i, 3 + k] * c[m] - C[i, 3 + m] * c[k])
    return np.sqrt(spread + model.radius * model.radius * turn) / (2 * model.radius)
