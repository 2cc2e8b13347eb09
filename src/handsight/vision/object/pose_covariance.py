"""How far a pose that a depth image gives may be off."""

import numpy as np
from numpy.typing import NDArray

from handsight._kernels.image import depth_term
from handsight.camera import Camera
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import DepthNoise

PIXEL = 12**-0.5
"""What an image is off by aside, as no mean shows: what a whole number of pixels leaves open [pixels]."""
UNKNOWN = 0.5, 0.9
"""Of a direction that no point sees, a shift and radius times a turn [diameters]: half the object, any turn."""


def pose_covariances(
    model: ObjectModel,
    camera: Camera,
    points: NDArray[np.void],
    candidates: NDArray[np.void],
    noise: DepthNoise,
) -> Array:
    """Returns (k, 6, 6) of CANDIDATE (k,) by (δp, δθ) of the object's origin along the camera's axes.

    Of DEPTH_POINT (n,) those within a look's bound count, with errors that they share as the noise has it: a pixel's
    own, its neighbours', a smooth bias and one of the whole image. On top of that come pixels' places and the model's
    error.
    """
    z = np.maximum(
        (candidates["pose"]["position"] + candidates["pose"]["rotation"] @ model.center_object)[:, 2], 1e-3
    )
    pulls = np.empty((len(candidates), 3, 6, 6))
    depth_term.inform_all(*model.record[:2], points, _errors(model, camera, noise, z), candidates, pulls)
    return pulls[:, 2]


def errors_of(camera: Camera, noise: DepthNoise, z: Array) -> Array:
    """Returns (k, 6) as kernels take them, of points at depths z (k,) [m]: variances [m²], and lengths by 1/slope²."""
    variance, slope = noise.sigma(z) ** 2, camera.matrix[0, 0]
    lengths = [(slope / length) ** 2 for length in (noise.correlation, noise.smooth_length)]
    biases = (noise.smooth * z**2) ** 2, noise.offset**2
    columns = [variance * (1 - noise.correlated), variance * noise.correlated, *biases, *lengths]
    return np.stack(np.broadcast_arrays(*columns), axis=1)


def _errors(model: ObjectModel, camera: Camera, noise: DepthNoise, z: Array) -> Array:
    """Returns (k, 11): those of the points, and what the object and the image add."""
    errors = np.zeros((len(z), 11))
    errors[:, :6] = errors_of(camera, noise, z)
    errors[:, 7] = (PIXEL * z / camera.matrix[0, 0]) ** 2 + model.sigma_point**2
    # What the model's own normals, that are not quite those of the object, make up of a turn.
    errors[:, 8] = model.sigma_normal**2 / 2
    errors[:, 9:] = [1 / (part * model.diameter) ** 2 for part in UNKNOWN]
    return errors
