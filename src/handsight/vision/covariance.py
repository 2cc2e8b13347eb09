"""How far a pose that a depth image gives may be off."""

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels import depth_term
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.vision.camera import PinholeCamera
from handsight.vision.depth_noise import DepthNoise

PIXEL = 12**-0.5
"""What an image is off by aside, as no mean shows: what a whole number of pixels leaves open [pixels]."""
UNKNOWN = 0.5, 0.9
"""Of a direction that no point sees, a shift and radius times a turn [diameters]: half the object, any turn."""
LEAST = 1e-3
"""Of the points' covariance in any direction, by its mean."""


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
    R, scale = looks["pose"]["rotation"], np.repeat([1.0, model.radius], 3)
    arms = R @ model.center_object
    z = np.maximum((looks["pose"]["position"] + arms)[:, 2], 1e-3)
    told = np.empty((len(looks), 2, 6, 6))
    depth_term.inform_all(*model.record[:2], seen, errors_of(camera, noise, z), looks, told)
    A, S = (told / np.outer(scale, scale)).swapaxes(0, 1)
    # What the model's own normals, that are not quite those of the object, make up of a turn.
    A = A - (looks["weight"] * model.sigma_normal**2 / 2)[:, None, None] * np.diag([0, 0, 0, 1, 1, 1])
    values, vectors = np.linalg.eigh(A)
    A = (vectors * np.maximum(values, 0)[:, None]) @ vectors.swapaxes(1, 2)
    least = LEAST * np.trace(S, axis1=1, axis2=2) / 6 + 1e-12
    information = A @ np.linalg.inv(S + least[:, None, None] * np.eye(6)) @ A
    unknown = np.repeat([1 / UNKNOWN[0] ** 2, 1 / UNKNOWN[1] ** 2], 3) / model.diameter**2
    aside = (PIXEL * z / camera.matrix[0, 0]) ** 2 + model.sigma_point**2
    about_center = np.linalg.inv(information + np.diag(unknown)) + aside[:, None, None] * np.eye(6)
    to_origin = np.zeros((len(looks), 6, 6)) + np.eye(6)
    to_origin[:, :3, 3:] = se3.skew(arms)
    to_origin /= scale
    covariances = to_origin @ about_center @ to_origin.swapaxes(1, 2)
    return np.asarray((covariances + covariances.swapaxes(1, 2)) / 2)


def errors_of(camera: PinholeCamera, noise: DepthNoise, z: Array) -> Array:
    """(k, 7) as kernels take them, of objects at depths z (k,) [m]."""
    variance, slope = noise.sigma(z) ** 2, camera.matrix[0, 0]
    lengths = [(slope / length) ** 2 for length in (noise.correlation, noise.smooth_length)]
    biases = (noise.smooth * z**2) ** 2, noise.offset**2
    columns = [variance * (1 - noise.correlated), variance * noise.correlated, *biases, *lengths, 0.0]
    return np.stack(np.broadcast_arrays(*columns), axis=1)
