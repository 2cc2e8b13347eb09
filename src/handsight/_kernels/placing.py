"""Sensed contacts from their tips into the palm, with the joints' errors. Twin: `handsight.tracking.placing`."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner


@inner
def _turn(R: Any, block: Any, out: Any, row: int, column: int) -> None:
    """`out[row:, column:] = R block Rᵀ`, 3 x 3 each."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += R[i, k] * block[row + k, column + m] * R[j, m]
            out[row + i, column + j] = total


@inner
def _leave_tangent(C: Any, n: Any) -> None:
    """Takes out of a covariance (6, 6) what a unit normal cannot do: change along itself."""
    for i in range(6):
        along = C[i, 3] * n[0] + C[i, 4] * n[1] + C[i, 5] * n[2]
        for j in range(3):
            C[i, 3 + j] -= along * n[j]
    for j in range(6):
        along = C[3, j] * n[0] + C[4, j] * n[1] + C[5, j] * n[2]
        for i in range(3):
            C[3 + i, j] -= along * n[i]


@entry
def place(
    points: Any, normals: Any, covariances: Any, Ts: Any, own: Any, by_joint: Any, variance: float
) -> None:
    """Moves contacts (k, 3), (k, 3), (k, 6, 6) in place by `Ts` (k, 4, 4), and adds what else is uncertain of them.

    `own` (k, 2): variance per axis of point and normal. `by_joint` (k, 6, j): how each point moves and turns by each
    joint, whose own variance is `variance`; overwritten with how point and normal change.
    """
    turned = np.empty((6, 6))
    for c in range(len(points)):
        R, p, n, C, J = Ts[c], points[c], normals[c], covariances[c], by_joint[c]
        for row in range(0, 6, 3):
            for column in range(0, 6, 3):
                _turn(R, C, turned, row, column)
        x, y, z = p[0], p[1], p[2]
        u, v, w = n[0], n[1], n[2]
        for i in range(3):
            p[i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + R[i, 3]
            n[i] = R[i, 0] * u + R[i, 1] * v + R[i, 2] * w
        for j in range(J.shape[1]):
            a, b, d = J[3, j], J[4, j], J[5, j]
            J[3, j], J[4, j], J[5, j] = b * n[2] - d * n[1], d * n[0] - a * n[2], a * n[1] - b * n[0]
        for i in range(6):
            for j in range(6):
                total = 0.0
                for k in range(J.shape[1]):
                    total += J[i, k] * J[j, k]
                C[i, j] = turned[i, j] + variance * total
            C[i, i] += own[c, i // 3]
        _leave_tangent(C, n)


def warm() -> None:
    """Compiles the kernel, or loads it."""
    one = np.zeros((1, 3))
    place(one, one.copy(), np.zeros((1, 6, 6)), np.eye(4)[None], np.zeros((1, 2)), np.zeros((1, 6, 1)), 0.0)
