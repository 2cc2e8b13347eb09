"""Sensed contacts from their tips into the palm, in NumPy: what `handsight._kernels.placing` computes."""

import numpy as np

from handsight import se3
from handsight.checks import Array


def place(
    points: Array, normals: Array, covariances: Array, Ts: Array, own: Array, by_joint: Array, variance: float
) -> None:
    """Moves contacts (k, 3), (k, 3), (k, 6, 6) in place by `Ts` (k, 4, 4), and adds what else is uncertain of them.

    `own` (k, 2): variance per axis of point and normal. `by_joint` (k, 6, j): how each point moves and turns by each
    joint, whose own variance is `variance`; overwritten with how point and normal change. A unit normal does not change
    along itself: nothing is kept there.
    """
    R = Ts[:, :3, :3]
    points[:] = (R @ points[..., None])[..., 0] + Ts[:, :3, 3]
    normals[:] = (R @ normals[..., None])[..., 0]
    # A turn ω of the tip moves its normal by ω × n.
    by_joint[:, 3:] = -se3.skew(normals) @ by_joint[:, 3:]
    turn = np.zeros_like(covariances)
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    covariance = turn @ covariances @ turn.swapaxes(-1, -2)
    covariance += variance * by_joint @ by_joint.swapaxes(-1, -2)
    covariance[:, range(6), range(6)] += np.repeat(own, 3, axis=1)
    tangent = np.zeros_like(covariance)
    tangent[:, :3, :3] = np.eye(3)
    tangent[:, 3:, 3:] = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    covariances[:] = tangent @ covariance @ tangent
