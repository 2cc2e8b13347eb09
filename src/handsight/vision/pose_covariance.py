"""The covariance of a pose from a depth image, by errors that the image's points share."""

import numpy as np
from numpy.typing import NDArray

from handsight._kernels.image import depth_term
from handsight._kernels.image.vision_records import DEPTH_ERROR
from handsight.camera import Camera
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.vision.candidates import Candidates, center_depths
from handsight.vision.depth_noise import DepthNoise

PIXEL = 12**-0.5
"""Error of a pose along each axis because pixels are whole numbers: it is common to all points [pixels]."""
UNKNOWN = 0.5, 0.9
"""Sigma along a direction that no point observes, of a shift and of radius times a turn [diameters]."""


def depth_errors(camera: Camera, noise: DepthNoise, z: Array) -> NDArray[np.void]:
    """Returns DEPTH_ERROR (k,) of points at depths z (k,) [m]."""
    errors = np.zeros(len(z), dtype=DEPTH_ERROR)
    variance = noise.sigma(z) ** 2
    errors["own"], errors["shared"] = variance * (1 - noise.correlated), variance * noise.correlated
    errors["smooth"], errors["offset"] = (noise.smooth * z**2) ** 2, noise.offset**2
    errors["shared_decay"] = (camera.matrix[0, 0] / noise.correlation) ** 2
    errors["smooth_decay"] = (camera.matrix[0, 0] / noise.smooth_length) ** 2
    return errors


def pose_covariances(informed: Array, unknown: Array, image_variance: Array) -> Array:
    """Returns the covariances (k, 6, 6) of poses by (δp, radius δθ) of their centres: (A S⁻¹ A + U)⁻¹ + v.

    informed (k, 2, 6, 6): the information A of the points and the covariance S of their summed pull, as
    `depth_covariance.inform` fills them in. unknown (6,): the diagonal of U, which is known without any point.
    image_variance (k,): v, of what all points are off by together [m²].
    """
    values, vectors = np.linalg.eigh(informed)
    # S is summed over some of the pairs of points, and may be less than nothing along a direction.
    values = np.maximum(values, 0)
    values[:, 1] += 1e-3 * np.trace(informed[:, 1], axis1=1, axis2=2)[:, None] / 6 + 1e-12
    values[:, 1] = 1 / values[:, 1]
    A, S_inverse = np.moveaxis((vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2), 1, 0)
    covariance = np.linalg.inv(A @ S_inverse @ A + np.diag(unknown)) + image_variance[:, None, None] * np.eye(
        6
    )
    return np.asarray((covariance + np.swapaxes(covariance, 1, 2)) / 2)


def center_covariances(
    model: ObjectModel, camera: Camera, points: NDArray[np.void], candidates: Candidates, noise: DepthNoise
) -> Array:
    """Returns (k, 6, 6) of CANDIDATE (k,) by (δp [m], δθ [rad]) of the object's centre along the camera's axes.

    Of DEPTH_POINT (n,) those within a candidate's bound count, with the errors of `noise`. The error of the model and
    that of whole pixels come on top.
    """
    z, informed = center_depths(model, candidates), np.empty((len(candidates), 2, 6, 6))
    errors = depth_errors(camera, noise, z)
    depth_term.inform_all(*model.record[:2], points, errors, candidates, informed)
    # The model's normals, which differ from the object's, say of a turn what the object does not.
    spurious = candidates["weight"] * model.sigma_normal**2 / 2
    informed[:, 0, range(3, 6), range(3, 6)] -= spurious[:, None]
    unknown = 1 / np.repeat(np.multiply(UNKNOWN, model.diameter), 3) ** 2
    image_variance = (PIXEL * z / camera.matrix[0, 0]) ** 2 + model.sigma_point**2
    scale = np.repeat([1.0, model.radius], 3)
    return pose_covariances(informed, unknown, image_variance) / np.outer(scale, scale)
