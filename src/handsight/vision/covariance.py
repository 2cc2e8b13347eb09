"""How far a pose that a depth image gives may be off."""

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import depth_term
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.vision.camera import PinholeCamera
from handsight.vision.depth_noise import DepthNoise

PIXEL = 12**-0.5
"""What an image is off by aside, as no mean shows: what a whole number of pixels leaves open [pixels]."""
UNKNOWN = 0.5, 0.9
"""Of a direction that no point sees, a shift and radius times a turn [diameters]: half the object, any turn."""


def pose_covariances(
    model: ObjectModel,
    camera: PinholeCamera,
    seen: NDArray[np.void],
    looks: NDArray[np.void],
    noise: DepthNoise,
) -> Array:
    """(k, 6, 6) of LOOK (k,) by (δp, δθ) of the object's origin along the camera's axes.

    Of SEEN (n,) those within a look's bound count, with errors that they share as the noise has it: a pixel's own, its
    neighbours', a smooth bias and one of the whole image. On top of that come pixels' places and the model's error.
    """
    z = np.maximum((looks["pose"]["position"] + looks["pose"]["rotation"] @ model.center_object)[:, 2], 1e-3)
    told = np.empty((len(looks), 3, 6, 6))
    depth_term.inform_all(*model.record[:2], seen, _errors(model, camera, noise, z), looks, told)
    return told[:, 2]


def _errors(model: ObjectModel, camera: PinholeCamera, noise: DepthNoise, z: Array) -> Array:
    """(k, 11) as kernels take them, of objects at depths z (k,) [m]."""
    variance, slope, D = noise.sigma(z) ** 2, camera.matrix[0, 0], model.diameter
    errors = np.zeros((len(z), 11))
    errors[:, 0], errors[:, 1] = variance * (1 - noise.correlated), variance * noise.correlated
    errors[:, 2], errors[:, 3] = (noise.smooth * z**2) ** 2, noise.offset**2
    errors[:, 4:6] = [(slope / length) ** 2 for length in (noise.correlation, noise.smooth_length)]
    errors[:, 7] = (PIXEL * z / slope) ** 2 + model.sigma_point**2
    # What the model's own normals, that are not quite those of the object, make up of a turn.
    errors[:, 8] = model.sigma_normal**2 / 2
    errors[:, 9:] = [1 / (UNKNOWN[0] * D) ** 2, 1 / (UNKNOWN[1] * D) ** 2]
    return errors
