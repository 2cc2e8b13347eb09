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

UNKNOWN = 0.5, 0.9
"""Sigma along a direction that no point observes, of a shift and of radius times a turn [diameters]."""


def depth_errors(
    camera: Camera, noise: DepthNoise, z: Array, unknown: tuple[float, float], sigma_pose: float = 0.0
) -> NDArray[np.void]:
    """Returns DEPTH_ERROR (k,) of points on bodies whose centres are at depths z (k,) [m].

    unknown: sigma of a pose along a direction that no point observes, of a shift and of radius times a turn [m].
    sigma_pose: of the pose along each axis, beside that of whole pixels [m].
    """
    focal, variance = camera.matrix[0, 0], noise.sigma(z) ** 2
    errors = np.zeros(len(z), dtype=DEPTH_ERROR)
    errors["own"], errors["shared"] = variance * (1 - noise.correlated), variance * noise.correlated
    errors["smooth"], errors["offset"] = (noise.smooth * z**2) ** 2, noise.offset**2
    errors["shared_decay"] = (focal / noise.correlation) ** 2
    errors["smooth_decay"] = (focal / noise.smooth_length) ** 2
    errors["pose"] = (z / focal) ** 2 / 12 + sigma_pose**2  # pixels are whole numbers: uniform over one
    errors["known_shift"], errors["known_turn"] = unknown[0] ** -2, unknown[1] ** -2
    return errors


def pose_covariances(
    model: ObjectModel, camera: Camera, points: NDArray[np.void], candidates: Candidates, noise: DepthNoise
) -> Array:
    """Returns (k, 6, 6) of CANDIDATE (k,) by (δp [m], δθ [rad]) of the object's origin along the camera's axes.

    Of DEPTH_POINT (n,) those within a candidate's bound count, with the errors of `noise`. The error of the model and
    that of whole pixels are added.
    """
    unknown = UNKNOWN[0] * model.diameter, UNKNOWN[1] * model.diameter
    errors = depth_errors(camera, noise, center_depths(model, candidates), unknown, model.sigma_point)
    errors["normal"] = model.sigma_normal**2 / 2
    informed, covariances = np.empty((len(candidates), 2, 6, 6)), np.empty((len(candidates), 6, 6))
    depth_term.pose_covariances(*model.record[:2], points, errors, candidates, informed, covariances)
    return covariances
