"""A prior on the pose as evidence: vision's or, without vision, a weak one on the position alone.

The six residuals are the shift of a pivot, which is a point that no declared symmetry moves, and the rotation vector of
the turn. For an object with a declared axis the turn is the swing of the axis alone: a spin about it costs nothing.
"""

import math
from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, factor, from_eigen, scale_turns
from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_six_rows, scaled
from handsight._compiled.records import NO_PRIOR, VISION_PRIOR, WEAK_PRIOR
from handsight._compiled.so3 import IDENTITY, log_derivative, rotation_exp, rotation_log
from handsight._compiled.vec3 import (
    Mat33,
    Pose,
    Vec3,
    add,
    add33,
    apply,
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
    store,
    store33,
    sub,
    sub33,
    transpose,
    vector,
)
from handsight.correction.kernels.contact_term import Frame, distance_row

IN_TAIL = 6.0
"""Minus two log of the share of vision's poses that are in the tail of its errors: one in twenty."""
TAIL_FREEDOM = 4.0
"""Degrees of freedom of the tail's Student's t. With fewer its own mass would be large where contacts leave much
open."""
LEAST_IN_TAIL = 15.0
"""Squared residuals up to which none is in the tail, however many are measured."""


@inner
def weak_position_prior(model: Any, center: Vec3, prior: Any) -> None:
    """Fills in the prior of an answer without vision: the object's center ~ N(contact centroid, radius²) per axis.

    It chooses among equal minima, and is not part of the information that is reported.
    """
    prior.kind = WEAK_PRIOR
    prior.has_axis = 0
    store(vector(model.center), prior.pivot_object)
    store((0.0, 0.0, 0.0), prior.axis_object)
    store(center, prior.pivot_palm)
    store33(IDENTITY, prior.rotation)
    prior.information[:] = 0.0
    for k in range(3):
        prior.information[k, k] = 1 / (model.radius * model.radius)


@inner
def _pivot(model: Any) -> Vec3:
    """Returns the object's middle or, of an object with axes, the point on them nearest to it.

    A pose is Gaussian in the shift of a point of the object. Vision sees the object, wherever its origin is: an origin
    far beside it moves along an arc as the object turns.
    """
    symmetry = model.symmetry
    center = vector(model.center)
    if symmetry.axes == 0:
        return center
    on_axis = vector(symmetry.pivot)
    if symmetry.axes > 1:
        return on_axis
    axis = vector(symmetry.axis[0])
    return add(on_axis, scale(axis, dot(axis, sub(center, on_axis))))


@inner
def vision_prior(model: Any, vision: Any, prior: Any, u: Any) -> None:
    """Fills in the evidence of a pose with its covariance, for an object with these symmetries.

    No standard deviation counts as less than 1e-5 of the object's radius.
    """
    symmetry = model.symmetry
    R = matrix(vision.pose.rotation)
    radius = model.radius
    pivot = _pivot(model)
    arm = mul(R, pivot)
    prior.kind = VISION_PRIOR
    prior.has_axis = symmetry.axes
    store(pivot, prior.pivot_object)
    store(vector(symmetry.axis[0]), prior.axis_object)
    store(add(vector(vision.pose.position), arm), prior.pivot_palm)
    store33(R, prior.rotation)
    scale_turns(vision.covariance, radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for k in range(6):
        u.values[k] = 1 / max(u.values[k], (1e-5 * radius) ** 2)
    from_eigen(u.values, u.vectors, radius, prior.information)
    about_point(prior.information, arm, prior.information)
    for k in range(symmetry.axes):
        # The turn about an axis is removed, by the Schur complement.
        axis = mul(R, vector(symmetry.axis[k]))
        information = prior.information
        by_shift, by_turn = mul(block(information, 0, 3), axis), mul(block(information, 3, 3), axis)
        along = max(dot(axis, by_turn), 1e-300)
        turned = by_shift + by_turn
        for i in range(6):
            for j in range(6):
                information[i, j] -= turned[i] * turned[j] / along


@inner
def about_point(information: Any, lever: Vec3, out: Any) -> None:
    """Fills `out` (6, 6), which may be the same array, with the information by (δp, δθ) about the point at the end of a
    lever from the origin: Fᵀ Λ F with F = [1, [lever]x; 0, 1], as δp of the origin is that of the point less what the
    turn does to the lever."""
    for i in range(6):
        row = vector(information[i])
        store(add(vector(information[i, 3:]), cross(row, lever)), out[i, 3:])
        store(row, out[i])
    for j in range(6):
        store(add(vector(out[3:, j]), cross(vector(out[:, j]), lever)), out[3:, j])


@inner
def turn_between(prior: Any, R: Mat33) -> tuple[Vec3, Mat33]:
    """Returns the rotation vector from the prior's rotation, or axis, to R, and its derivative by a turn of R."""
    if prior.has_axis:
        axis = vector(prior.axis_object)
        return swing(mul(matrix(prior.rotation), axis), mul(R, axis))
    turn = rotation_log(matmul(R, transpose(matrix(prior.rotation))))
    return turn, log_derivative(turn)


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
def point_off(point_object: Any, point_palm: Any, pose: Pose) -> tuple[Vec3, Vec3]:
    """Returns where a point of the object is in the palm, and how far that is from where it should be."""
    place = apply(pose, vector(point_object))
    return place, sub(place, vector(point_palm))


@inner
def point_rows(place: Vec3, off: Vec3, frame: Frame) -> Any:
    """Returns three rows: how far a point of the object at a place is off, which moves by τ + ω × (place - center)."""
    x, y, z = IDENTITY
    return (
        distance_row(place, x, off[0], frame),
        distance_row(place, y, off[1], frame),
        distance_row(place, z, off[2], frame),
    )


@inner
def add_prior(prior: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the prior's rows, of the pivot and of the turn, where there is a prior."""
    if prior.kind == NO_PRIOR:
        return
    pivot, off = point_off(prior.pivot_object, prior.pivot_palm, pose)
    turn, D = turn_between(prior, pose[0])
    D = scale33(D, 1 / frame[1])
    still = (0.0, 0.0, 0.0)
    by_shift = point_rows(pivot, off, frame)
    by_turn = still + D[0] + (turn[0],), still + D[1] + (turn[1],), still + D[2] + (turn[2],)
    square = _squared(prior.information, off, turn)
    cost, weight = _with_tail(prior, square)
    if weight < 1.0:
        root = np.sqrt(weight)
        by_shift = scaled(by_shift[0], root), scaled(by_shift[1], root), scaled(by_shift[2], root)
        by_turn = scaled(by_turn[0], root), scaled(by_turn[1], root), scaled(by_turn[2], root)
        equations[6, 6] += cost - weight * square
    add_six_rows(prior.information, by_shift, by_turn, equations)


@inner
def _with_tail(prior: Any, square: float) -> tuple[float, float]:
    """Returns what squared residuals q of the prior cost, and their weight: those of vision as declared or, where that
    is likelier, in the tail of its errors.

    The tail is Student's t of ν = 4 degrees of freedom with the declared scale, in the k directions that vision
    measures. Minus two log of its density is c + (ν + k) log(1 + q / ν), with e^(-c / 2) = Γ(2 + k/2) / √2ᵏ times its
    share, relative to the Gaussian's peak.
    """
    if prior.kind != VISION_PRIOR or square <= LEAST_IN_TAIL:
        return square, 1.0
    freedom = 6.0 - prior.has_axis
    least = IN_TAIL - 2.0 * math.lgamma(2.0 + freedom / 2) + freedom * np.log(2.0)
    in_tail = least + (TAIL_FREEDOM + freedom) * np.log(1.0 + square / TAIL_FREEDOM)
    if square <= in_tail:
        return square, 1.0
    return in_tail, (TAIL_FREEDOM + freedom) / (TAIL_FREEDOM + square)


@inner
def _squared(information: Any, off: Vec3, turn: Vec3) -> float:
    """Returns the squared length of six residuals."""
    A, B, D = block(information, 0, 0), block(information, 0, 3), block(information, 3, 3)
    return dot(off, add(mul(A, off), scale(mul(B, turn), 2.0))) + dot(turn, mul(D, turn))


@inner
def prior_square(prior: Any, pose: Pose) -> float:
    """Returns the prior's squared residuals at a pose, as declared; 0 where there is none."""
    if prior.kind == NO_PRIOR:
        return 0.0
    _, off = point_off(prior.pivot_object, prior.pivot_palm, pose)
    turn, _ = turn_between(prior, pose[0])
    return _squared(prior.information, off, turn)


@inner
def prior_cost(prior: Any, pose: Pose) -> float:
    """Returns minus two log of the prior's density at a pose, up to a constant."""
    cost, _ = _with_tail(prior, prior_square(prior, pose))
    return cost


@inner
def prior_width(model: Any, prior: Any) -> float:
    """Returns the root mean square deviation of the surface's points by the prior, as a fraction of the diameter."""
    C = prior.covariance
    c = mul(matrix(prior.pose.rotation), vector(model.center))
    turn = C[3, 3] + C[4, 4] + C[5, 5]
    # Of the object's center: δp + δθ × c.
    spread = C[0, 0] + C[1, 1] + C[2, 2] + dot(c, c) * turn
    for i in range(3):
        for j in range(3):
            spread -= c[i] * C[3 + i, 3 + j] * c[j]
        k, m = (i + 1) % 3, (i + 2) % 3
        spread += 2 * (C[i, 3 + k] * c[m] - C[i, 3 + m] * c[k])
    return np.sqrt(spread + model.radius * model.radius * turn) / (2 * model.radius)


@inner
def spread(prior: Any, u: Any) -> None:
    """Writes what draws from a PRIOR need: the standard deviations along the object's own axes to `u.row`, and the
    Cholesky factor of the correlation to `u.factor`."""
    R = matrix(prior.pose.rotation)
    for a in range(0, 6, 3):
        for b in range(0, 6, 3):
            turned = matmul(transpose(R), matmul(block(prior.covariance, a, b), R))
            store33(turned, u.matrix[a : a + 3, b : b + 3])
    for i in range(6):
        u.row[i] = np.sqrt(max(u.matrix[i, i], 0.0)) + 1e-12
        for j in range(i + 1):
            u.wider[i, j] = u.matrix[i, j] / (u.row[i] * u.row[j])
    factor(u.wider, 6, 1e-9, u.factor)


@inner
def drawn(prior: Any, draw: Any, u: Any) -> Pose:
    """Returns a PRIOR's pose moved by a standard normal draw (6,) along the object's own axes, after `spread`."""
    R, p = matrix(prior.pose.rotation), vector(prior.pose.position)
    for i in range(6):
        value = draw[i] / u.factor[i, i]
        for j in range(i):
            value += u.factor[i, j] * draw[j]
        u.column[i] = value * u.row[i]
    turn = mul(R, (u.column[3], u.column[4], u.column[5]))
    return matmul(rotation_exp(turn), R), apply((R, p), vector(u.column))
