"""The depth camera at the shoulder: its calibrated pose, the error of that pose, and the errors of its depth."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import fftfreq, irfft2, rfft2
from scipy.ndimage import minimum_filter
from scipy.special import ndtri

from handsight import checks, se3
from handsight.camera import Depth
from handsight.checks import Array
from handsight.simulation.scenario import Nuisances, Scenario
from handsight.simulation.scene import IMAGE_SIZE, SCENE
from handsight.vision import DepthNoise

TARGET = np.array([0.0, 0.02, 0.07])
"""The point that the camera faces, and about which its calibration is turned, in the world [m]."""
INTRINSICS = np.diag([SCENE.focal_length, SCENE.focal_length, 1.0])
INTRINSICS[:2, 2] = (np.array(IMAGE_SIZE) - 1) / 2
"""The camera matrix (3, 3) [pixels]; the centres of pixels have integer coordinates."""
EDGE = 0.02
"""How much nearer a surface at less than 1 m must be for depth to be lost beside it [m]; at z > 1 m it is `EDGE` z², as
a step in disparity is."""


def camera_facing(eye: ArrayLike, at: ArrayLike) -> Array:
    """Returns T_world_camera (4, 4) of an upright camera at `eye` (3,) [m] that faces the point `at` (3,) [m].

    Optical frame: x right, y down, z forward.
    """
    origin = checks.finite(eye, "eye", (3,))
    z = checks.unit(checks.finite(at, "at", (3,)) - origin, "at - eye", (3,))
    x = checks.unit(np.cross(z, [0.0, 0, 1]), "at - eye, seen from above", (3,))
    return se3.compose(np.column_stack([x, np.cross(z, x), z]), origin)


CALIBRATED_CAMERA = camera_facing([-0.45, 0.50, 0.60], TARGET)  # T_world_camera (4, 4) of the robot's rig


def calibration_error(nuisances: Nuisances, seed: int) -> Array:
    """Returns T_measured_true (4, 4) in the world: it maps true poses to where the wrong calibration places them. It is
    a constant rotation about `TARGET` and a constant shift, drawn by the seed."""
    draw = np.random.default_rng((seed, 4)).normal(size=6)
    # The mean length of a Gaussian in the plane is √(π/2) of its sigma.
    plane = nuisances.camera_position / np.sqrt(np.pi / 2)
    shift = draw[:3] * [plane, plane, nuisances.camera_height]
    return moved_about_target(shift, nuisances.camera_rotation * draw[3:])


def moved_about_target(shift: Array, rotation: Array) -> Array:
    """Returns the rigid motion (4, 4) of a rotation (3,) [rad] about `TARGET`, and of a shift (3,) [m]."""
    R = se3.rotation_exp(rotation)
    return se3.compose(R, TARGET + shift - R @ TARGET)


def true_camera(scenario: Scenario) -> Array:
    """Returns the true T_camera_world (4, 4) of the robot's camera; the rig's own is wrong by `calibration_error`."""
    error = calibration_error(scenario.nuisances, int(scenario.seed))
    return np.asarray(se3.inverse(CALIBRATED_CAMERA) @ error)


def add_depth_noise(depth: Depth, noise: DepthNoise, rng: np.random.Generator, seed: int) -> Depth:
    """Returns the depth image (h, w) [m] that a camera measures of true depth (h, w) [m]; NaN where it has none.

    `rng` draws the noise of this image; `seed` (at least 0) draws the constant errors, so another seed is another
    camera. Without noise, depth in range is exact.
    """
    z = np.asarray(depth, dtype=np.float32)
    known = (z > noise.nearest) & (z < noise.farthest)  # False for NaN
    dropouts = np.full(z.shape, noise.dropouts, dtype=np.float32)
    if noise.edges > 0:  # more behind edges
        there = np.where(z > 0, z, np.float32(np.inf))
        nearest = minimum_filter(there, 2 * noise.edge_width + 1, mode="constant", cval=np.inf)
        dropouts[z > nearest + np.float32(EDGE) * np.square(np.maximum(nearest, 1))] = noise.edges
    known &= rng.random(z.shape, dtype=np.float32) >= dropouts
    z = _laterally_displaced(z, noise.lateral, rng)
    known &= (z > noise.nearest) & (z < noise.farthest)
    z = np.where(known, z, np.float32(1))
    a, b, c = map(np.float32, noise.axial)
    step = np.float32(noise.step) * z * z
    # The axial noise includes rounding, which is uniform over a step.
    sigma = np.sqrt(np.maximum(np.square(a + z * (b + z * c)) - step * step / 12, 0))
    # Part of the noise is correlated; both parts come from the same numbers, half an image apart.
    drawn, share = _white(z.shape, rng), np.float32(noise.correlated)
    grain = _smoothed(drawn, noise.correlation)
    grain *= np.sqrt(share)
    grain += np.sqrt(1 - share) * np.roll(drawn, (z.shape[0] // 2, z.shape[1] // 2), axis=(0, 1))
    offset, smooth = _constant_errors(z.shape, noise.smooth_length, seed)
    z = z + sigma * grain + (np.float32(noise.offset) * offset + np.float32(noise.smooth) * smooth * z * z)
    if noise.step > 0:
        disparity = np.rint(1 / (np.float32(noise.step) * np.maximum(z, np.float32(0.01))))
        z = np.asarray(1 / (np.float32(noise.step) * np.maximum(disparity, 1)), dtype=np.float32)
    return np.where(known, z, np.float32(np.nan))


def _laterally_displaced(z: Depth, sigma: float, rng: np.random.Generator) -> Depth:
    """Returns the image (h, w) in which each pixel has the depth of a pixel near it, `sigma` pixels along each axis."""
    if sigma == 0:
        return z
    offsets = np.rint(sigma * _quantiles(256)).astype(np.int32)  # whole pixels, a byte for each axis
    largest = int(offsets.max())
    around = np.pad(z, largest, mode="edge")
    width = around.shape[1]
    pairs = (offsets[:, None] * width + offsets).ravel()
    places = pairs[rng.integers(1 << 16, size=z.shape, dtype=np.uint16)]
    places += width * np.arange(largest, largest + z.shape[0], dtype=np.int32)[:, None]
    places += np.arange(largest, largest + z.shape[1], dtype=np.int32)
    return np.asarray(around.ravel()[places])


@lru_cache(maxsize=8)
def _constant_errors(shape: tuple[int, ...], length: float, seed: int) -> tuple[np.float32, Depth]:
    """Returns one camera's standard normal offset, and its smooth field (h, w) of unit variance."""
    rng = np.random.default_rng((seed, 10))
    return np.float32(rng.normal()), _smoothed(_white(shape, rng), length)


def _white(shape: tuple[int, ...], rng: np.random.Generator) -> Depth:
    """Returns (h, w) standard normal numbers, rounded to 65 536 values, which takes a third of the time."""
    return _quantiles(1 << 16)[rng.integers(1 << 16, size=shape, dtype=np.uint16)]


@lru_cache(maxsize=2)
def _quantiles(number: int) -> Depth:
    """Returns (number,) equally likely values of a standard normal distribution."""
    return np.asarray(ndtri((np.arange(number) + 0.5) / number), dtype=np.float32)


def _smoothed(white: Depth, length: float) -> Depth:
    """Returns noise (h, w) of unit variance and correlation exp(-d²/length²) at distance d [pixels], periodic."""
    rows, columns = (np.exp(-0.5 * np.square(np.pi * length * fftfreq(n))) for n in white.shape)
    scale = (np.square(rows).mean() * np.square(columns).mean()) ** -0.5
    weights = np.outer(scale * rows, columns[: len(columns) // 2 + 1]).astype(np.float32)
    return np.asarray(irfft2(rfft2(white) * weights, s=white.shape), dtype=np.float32)
