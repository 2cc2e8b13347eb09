"""The covariance of the palm's pose from a depth image."""

import numpy as np

from handsight import se3
from handsight._kernels.image import depth_covariance, hand_term
from handsight.checks import Array, Indices
from handsight.gaussian_pose import GaussianPose
from handsight.vision.candidates import Candidates, poses_of
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.palm.palm_search import Picture
from handsight.vision.pose_covariance import depth_errors


def palm_covariance(
    picture: Picture, candidate: Candidates, rows: Indices, bound: float, noise: DepthNoise
) -> Array:
    """Returns (6, 6) of CANDIDATE (1,) by (δp, δθ) of the palm along the camera's axes.

    rows (k,): the visible points; bound: Tukey's [m]. The errors of points are those of `noise`. Those of whole
    pixels are added, and those of constant errors of the joints, to first order: a weighted fit follows a joint that is
    off.
    """
    T, hand, camera, compared = poses_of(candidate)[0], picture.hand, picture.camera, 150
    skin, fitted = np.ascontiguousarray(hand.skin[:, rows]), np.empty((len(rows), 8))
    hand_term.rows_of(camera.record, picture.arrays, skin, candidate["pose"].copy(), bound, fitted)
    used = fitted[:, 0] > 0
    weights, normals = fitted[used, 0], np.ascontiguousarray(fitted[used, 2:5])
    points, center = se3.apply(T, skin[0, used]), se3.apply(T, hand.middle[None])[0]
    z = np.maximum(center[2:], 1e-3)
    # Along a direction that no point observes: half the hand's size, and 1.8 rad.
    errors = depth_errors(camera, noise, z, (hand.radius, 1.8 * hand.radius))
    informed, covariance = np.empty((2, 6, 6)), np.empty((6, 6))
    depth_covariance.inform_points(weights, points, normals, center, hand.radius, errors, compared, informed)
    depth_covariance.covariance_of(informed, errors, covariance)
    if hand.sigma_joint > 0:
        lines = np.hstack([normals, np.cross(points - center, normals) / hand.radius])
        by_joints = np.einsum("mi,ij,mjk->mk", normals, T[:3, :3], hand.by_joints(rows[used]))
        information = informed[0] + (weights.sum() + 1e-9) * 1e-9 * np.eye(6)
        follows = np.linalg.solve(information, np.einsum("m,mi,mk->ik", weights, lines, by_joints))
        covariance = covariance + hand.sigma_joint**2 * follows @ follows.T
    scale = np.repeat([1.0, hand.radius], 3)
    covariance = GaussianPose(T, covariance / np.outer(scale, scale)).at_point(-hand.middle).covariance
    return np.asarray((covariance + covariance.T) / 2)
