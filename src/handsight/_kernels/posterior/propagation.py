"""A pose's information after process noise, and its covariance at a point of the object."""

from typing import Any

import numpy as np

from handsight._kernels.jit import entry
from handsight._kernels.math.dense6 import eigen, in_metres
from handsight._kernels.math.stack import local
from handsight._kernels.math.vec3 import add, cross, scale, vector
from handsight._kernels.records import UNCERTAINTY


@entry
def inflate(information: Any, variance: Any) -> None:
    """Lowers an information I (6, 6), which may be singular, by process noise of variances Q (6): (I⁻¹ + Q)⁻¹.

    One axis e after the other, of variance q: I - q I e eᵀ I / (1 + q eᵀ I e) (Sherman and Morrison).
    """
    column = np.empty(6)
    for k in range(6):
        for i in range(6):
            column[i] = information[i, k]
        share = variance[k] / (1.0 + variance[k] * column[k])
        for i in range(6):
            for j in range(6):
                information[i, j] -= share * column[i] * column[j]


@entry
def at_point(information: Any, radius: float, lever: Any, covariance: Any) -> float:
    """Writes the `covariance` (3, 3) of the position of a point at the end of a `lever` (3) from the object's origin;
    returns its largest eigenvalue.

    A direction that a declared symmetry leaves at zero in the information (6, 6) adds no uncertainty.
    """
    u, arm, most = local(UNCERTAINTY), vector(lever), 0.0
    in_metres(information, radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for i in range(6):
        most = max(most, u.values[i])
        for j in range(6):
            u.matrix[i, j] = 0.0
    for k in range(6):
        if u.values[k] > 1e-9 * most:  # else it is a declared symmetry's zero
            shift = u.vectors[0, k], u.vectors[1, k], u.vectors[2, k]
            turn = scale((u.vectors[3, k], u.vectors[4, k], u.vectors[5, k]), 1 / radius)
            moved = scale(add(shift, cross(turn, arm)), 1 / np.sqrt(u.values[k]))
            for i in range(3):
                for j in range(3):
                    u.matrix[i, j] += moved[i] * moved[j]
    for i in range(3):
        for j in range(3):
            covariance[i, j] = u.matrix[i, j]
    eigen(u.matrix, u.values, u.vectors)
    largest = 0.0
    for i in range(6):
        largest = max(largest, u.values[i])
    return largest
