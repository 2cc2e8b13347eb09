"""Candidate poses in a camera, as the records that the kernels of vision take, and their covariances.

A covariance is by errors that the points of a depth image share.
"""

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array
from handsight.correction.kernels import distinct_poses
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.kernels import depth_term
from handsight.vision.kernels.vision_records import CANDIDATE, DEPTH_ERROR

Candidates = NDArray[np.void]
NOTHING_KNOWN = np.zeros((6, 6))  # the information of a pose without prior knowledge
UNKNOWN = 0.5, 0.9
"""Sigma along a direction that no point observes, of a shift and of radius times a turn [diameters]."""
MODEL_ERROR = 1e-3
"""Sigma by which an object that was made is off from its model, of a shift and of radius times a turn [m]."""


def candidates_at(Ts: Array) -> Candidates:
    """Returns CANDIDATE (k,) at poses (k, 4, 4) in the camera."""
    candidates = np.zeros(len(Ts), dtype=CANDIDATE)
    candidates["pose"]["rotation"] = Ts[:, :3, :3]
    candidates["pose"]["position"] = Ts[:, :3, 3]
    return candidates


def poses_of(candidates: Candidates) -> Array:
    """Returns the poses (..., 4, 4) in the camera of CANDIDATE (...)."""
    return se3.compose(candidates["pose"]["rotation"], candidates["pose"]["position"])


def center_depths(model: ObjectModel, candidates: Candidates) -> Array:
    """Returns the depths (k,) of the object's centre [m]; 1 mm where it is not in front of the camera."""
    z = candidates["pose"]["position"][:, 2] + candidates["pose"]["rotation"][:, 2] @ model.center_object
    return np.asarray(np.maximum(z, 1e-3))


def depth_errors(
    camera: Camera, noise: DepthNoise, z: Array, unknown: tuple[float, float], sigma_pose: float = 0.0
) -> NDArray[np.void]:
    """Returns DEPTH_ERROR (k,) of points on bodies whose centres are at depths z (k,) [m].

    unknown: sigma of a pose along a direction that no point observes, of a shift and of radius times a turn [m].
    sigma_pose: of the pose along each axis, beside that of whole pixels [m].
    """
    focal = camera.matrix[0, 0]
    variance = noise.sigma(z) ** 2
    errors = np.zeros(len(z), dtype=DEPTH_ERROR)
    errors["own"] = variance * (1 - noise.correlated)
    errors["shared"] = variance * noise.correlated
    errors["smooth"] = (noise.smooth * z**2) ** 2
    errors["offset"] = noise.offset**2
    errors["shared_decay"] = (focal / noise.correlation) ** 2
    errors["smooth_decay"] = (focal / noise.smooth_length) ** 2
    errors["pose"] = (z / focal) ** 2 / 12 + sigma_pose**2  # pixels are whole numbers: uniform over one
    errors["known_shift"] = unknown[0] ** -2
    errors["known_turn"] = unknown[1] ** -2
    return errors


def pose_covariances(
    model: ObjectModel, camera: Camera, points: NDArray[np.void], candidates: Candidates, noise: DepthNoise
) -> Array:
    """Returns (k, 6, 6) of CANDIDATE (k,) by (δp [m], δθ [rad]) of the object's origin along the camera's axes.

    Of DEPTH_POINT (n,) those within a candidate's bound count, with the errors of `noise`. The error of the model and
    that of whole pixels are added.
    """
    unknown = (UNKNOWN[0] * model.diameter, UNKNOWN[1] * model.diameter)
    z = center_depths(model, candidates)
    errors = depth_errors(camera, noise, z, unknown, float(np.hypot(model.sigma_point, MODEL_ERROR)))
    errors["normal"] = model.sigma_normal**2 / 2
    informed = np.empty((len(candidates), 2, 6, 6))
    covariances = np.empty((len(candidates), 6, 6))
    depth_term.pose_covariances(*model.record[:2], points, errors, candidates, informed, covariances)
    return covariances


def distinct(
    model: ObjectModel, candidates: Candidates, score: Array, most: int, spacing: float
) -> Candidates:
    """Returns the best candidates, each farther than `spacing` [diameters] from all better ones, modulo symmetry."""
    axes = model.symmetries.axes
    kept = np.empty(most, dtype=np.int64)
    about = axes[0][0] if axes else model.center_object
    group = model.symmetries.rotations, np.array([axis for _, axis in axes]).reshape(-1, 3)
    limits = np.array([*about, model.radius, spacing * model.diameter])
    order = np.argsort(-score, kind="stable")
    return candidates[kept[: distinct_poses.distinct_candidates(group, limits, candidates, order, kept)]]


def surface_distances(
    model: ObjectModel, points: Array, within: float, candidates: Candidates
) -> NDArray[np.float32]:
    """Returns the distances (k, n) [m] of points (n, 3) from the surface at CANDIDATE (k,); infinity where they are not
    `within` it [m]."""
    distances = np.empty((len(candidates), len(points)), dtype=np.float32)
    depth_term.surface_distances(*model.record[:2], points, within, candidates, distances)
    return distances
