"""How far the palm's pose may be off that a depth image gives."""

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import hand_term
from handsight._kernels.image.depth_covariance import LEAST
from handsight.checks import Array, Indices
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.object.first_pose import poses_of
from handsight.vision.object.pose_covariance import PIXEL, errors_of
from handsight.vision.palm.hand_appearance import PlacedHand
from handsight.vision.palm.palm_search import Picture

UNKNOWN = 0.5, 1.8
"""Of a direction that no point sees [the hand's size, rad]."""
PAIRED = 150
"""Points whose errors are compared with each other's, for the others too."""


def palm_covariance(
    picture: Picture,
    hand: PlacedHand,
    candidate: NDArray[np.void],
    stage: tuple[Indices, float],
    noise: DepthNoise,
) -> Array:
    """Returns (6, 6) of CANDIDATE (1,) by (δp, δθ) of the palm along the camera's axes.

    stage: rows of the points that are seen (k,), and Tukey's bound [m]. Points err as the noise has it: each by itself,
    with its neighbours, with all. On top of that come pixels' places and what constant errors of the joints do, to
    first order: how the weighted fit leans when a joint is off.
    """
    rows, bound = stage
    T, camera = poses_of(candidate)[0], picture.camera
    skin, out = np.ascontiguousarray(hand.skin[:, rows]), np.empty((len(rows), 8))
    hand_term.rows_of(camera.record, picture.arrays, skin, candidate["pose"].copy(), bound, out)
    used = out[:, 0] > 0
    weight, lines, rows = out[used, 0], out[used, 2:], rows[used]
    normals, arm = lines[:, :3].copy(), T[:3, :3] @ hand.middle
    lines[:, 3:] -= np.cross(arm + T[:3, 3], normals)
    scale, points = np.repeat([1.0, hand.radius], 3), se3.apply(T, skin[0, used])
    lines = lines / scale
    information = np.einsum("m,mi,mj->ij", weight, lines, lines)
    z = max(float(T[2, 3] + arm[2]), 1e-3)
    slopes = points[:, :2] / points[:, 2:]
    pulls = (weight * np.einsum("mi,mi->m", normals, points) / points[:, 2])[:, None] * lines
    S = _spread(pulls, slopes, errors_of(camera, noise, np.array([z]))[0])
    S += (LEAST * np.trace(S) / 6 + 1e-12) * np.eye(6)
    unknown = np.repeat([1 / (2 * UNKNOWN[0]) ** 2, 1 / UNKNOWN[1] ** 2], 3) / hand.radius**2
    about = np.linalg.inv(information @ np.linalg.solve(S, information) + np.diag(unknown))
    about += (PIXEL * z / camera.matrix[0, 0]) ** 2 * np.eye(6)
    if hand.sigma_joint > 0:
        by_joints = np.einsum("mi,ij,mjk->mk", normals, T[:3, :3], hand.by_joints(rows))
        tied = information + (weight.sum() + 1e-9) * 1e-9 * np.eye(6)
        leans = np.linalg.solve(tied, np.einsum("m,mi,mk->ik", weight, lines, by_joints))
        about += hand.sigma_joint**2 * leans @ leans.T
    to_palm = se3.point_jacobian(-arm) / scale
    covariance = to_palm @ about @ to_palm.T
    return np.asarray((covariance + covariance.T) / 2)


def _spread(pulls: Array, slopes: Array, error: Array) -> Array:
    """Returns (6, 6) the covariance of the sum of pulls (m, 6) of points at slopes (m, 2); what neighbours share by a
    few.

    error: as of `depth_term.inform_all`.
    """
    own, near, smooth, all_ = error[:4]
    total = pulls.sum(axis=0)
    few, distance2 = pulls[:PAIRED], ((slopes[:PAIRED, None] - slopes[None, :PAIRED]) ** 2).sum(axis=-1)
    shared = near * np.exp(-distance2 * error[4]) + smooth * np.exp(-distance2 * error[5])
    np.fill_diagonal(shared, 0.0)
    pairs = len(pulls) * (len(pulls) - 1) / max(len(few) * (len(few) - 1), 1)
    S = (own + near + smooth) * pulls.T @ pulls + all_ * np.outer(total, total) + pairs * few.T @ shared @ few
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0)) @ vectors.T)
