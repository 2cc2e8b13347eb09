"""How far a pose that depth points settle may be off, by errors that they share; and what that leaves its surface."""

from typing import Any

import numpy as np

from handsight._kernels.math.dense6 import eigen, factor, in_metres, solve
from handsight._kernels.math.simd import local
from handsight._kernels.math.so3 import rotation_exp
from handsight._kernels.math.vec3 import Mat33, Vec3, add, cross, matrix, mul, scale, sub, tmul, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.records import UNCERTAINTY
from handsight._kernels.runtime.compilation import entry, inner

LEAST = 1e-3
"""Of the points' covariance in any direction, by its mean."""
LEAST_KNOWN = 3
"""Directions of a pose along which its surface is tried."""


@inner
def covariance_of(information: Any, error: Any, arm: Vec3, radius: float, weight: float, u: Any) -> None:
    """Fills in `information[2]`, by (δp, δθ) of a frame's origin, from `information[0]`, `information[1]` (A, S) of
    its centre, an arm away.

    (A S⁻¹ A + what is known anyway)⁻¹ + what an image is off aside; error: as of `depth_term.inform_all`.
    """
    A, X = u.matrix, u.by_touch
    in_metres(information[1], radius, u.wider)
    trace = 0.0
    for i in range(6):
        trace += u.wider[i, i]
    eigen(u.wider, u.values, u.vectors)
    for k in range(6):
        # That of many points is drawn from some of their pairs, and may be less than nothing.
        u.values[k] = 1 / (max(u.values[k], 0.0) + LEAST / 6 * trace + 1e-12)
    _composed(u.values, u.vectors, u.factor)
    in_metres(information[0], radius, A)
    for i in range(3, 6):
        A[i, i] -= weight * error[8]
    eigen(A, u.values, u.vectors)
    for k in range(6):
        u.values[k] = max(u.values[k], 0.0)
    _composed(u.values, u.vectors, A)
    for i in range(6):
        for j in range(6):
            X[i, j] = 0.0
            for k in range(6):
                X[i, j] += u.factor[i, k] * A[k, j]
    for i in range(6):
        for j in range(6):
            u.wider[i, j] = error[9 if i < 3 else 10] if i == j else 0.0
            for k in range(6):
                u.wider[i, j] += (A[i, k] * X[k, j] + A[j, k] * X[k, i]) / 2
    _inverse(u.wider, error[7], u)
    in_metres(u.wider, radius, u.wider)
    moved_origin(u.wider, arm, information[2])


@inner
def _composed(values: Any, vectors: Any, out: Any) -> None:
    """Fills `out` (6, 6) with the symmetric matrix of eigenvalues (6) and eigenvectors in columns."""
    for i in range(6):
        for j in range(6):
            out[i, j] = 0.0
            for k in range(6):
                out[i, j] += values[k] * vectors[i, k] * vectors[j, k]


@inner
def _inverse(symmetric: Any, floor: float, u: Any) -> None:
    """Inverts a matrix in place, with `floor` on its diagonal."""
    factor(symmetric, 6, 0.0, u.factor)
    for j in range(6):
        for i in range(6):
            u.row[i] = 1.0 if i == j else 0.0
        solve(u.factor, 6, u.row, u.column)
        for i in range(6):
            symmetric[i, j] = u.column[i] + (floor if i == j else 0.0)


@inner
def moved_origin(covariance: Any, arm: Vec3, out: Any) -> None:
    """Fills `out` = JPJᵀ for J = [1, [arm]x; 0, 1], symmetric."""
    for j in range(6):
        turned = cross(arm, (covariance[3, j], covariance[4, j], covariance[5, j]))
        for i in range(3):
            out[i, j], out[3 + i, j] = covariance[i, j] + turned[i], covariance[3 + i, j]
    for i in range(6):
        turned = cross(arm, (out[i, 3], out[i, 4], out[i, 5]))
        for j in range(3):
            out[i, j] += turned[j]
    for i in range(6):
        for j in range(i):
            out[i, j] = out[j, i] = (out[i, j] + out[j, i]) / 2


@inner
def _along_object(covariance: Any, R: Mat33, center: Vec3, radius: float, u: Any) -> None:
    """Fills `u.matrix` with the covariance of the object's centre, a turn by what it moves, along the object's axes."""
    moved_origin(covariance, scale(mul(R, center), -1.0), u.wider)
    for a in range(0, 6, 3):
        for j in range(6):
            part = tmul(R, (u.wider[a, j], u.wider[a + 1, j], u.wider[a + 2, j]))
            for i in range(3):
                u.factor[a + i, j] = part[i]
    for a in range(0, 6, 3):
        for i in range(6):
            part = tmul(R, (u.factor[i, a], u.factor[i, a + 1], u.factor[i, a + 2]))
            for j in range(3):
                u.matrix[i, a + j] = part[j] * (radius if i >= 3 else 1.0) * (radius if a else 1.0)


@entry
def largest_shift(model: Any, nodes: Any, rotation: Any, covariance: Any) -> float:
    """Returns how far the surface is off at most [m] after one deviation along any of the least known directions.

    covariance (6, 6): of (δp, δθ) of the object's origin along the camera's axes. A turn that the object looks the same
    after leaves its surface where it is.
    """
    u, radius, center = local(UNCERTAINTY), model[0].radius, vector(model[0].center)
    _along_object(covariance, matrix(rotation), center, radius, u)
    eigen(u.matrix, u.values, u.vectors)
    largest = 0.0
    for _ in range(LEAST_KNOWN):
        k = np.argmax(u.values)
        length = np.sqrt(max(u.values[k], 0.0))
        u.values[k] = -1.0
        shift = scale((u.vectors[0, k], u.vectors[1, k], u.vectors[2, k]), length)
        E = rotation_exp(scale((u.vectors[3, k], u.vectors[4, k], u.vectors[5, k]), length / radius))
        for m in range(len(model[0].samples)):
            point = add(mul(E, sub(vector(model[0].samples[m, 0]), center)), add(center, shift))
            largest = max(largest, abs(field_at(nodes, model[0].fine, point)[0]))
    return largest
