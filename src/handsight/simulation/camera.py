"""The depth camera at the shoulder: where it is, where the robot believes it to be, what is wrong with its depth."""

from functools import lru_cache, reduce

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import fftfreq, irfft2, rfft2
from scipy.special import ndtri

from handsight import checks, se3
from handsight.camera import Depth
from handsight.checks import Array, Mask
from handsight.simulation.scenario import Nuisances
from handsight.simulation.scene import IMAGE_SIZE, SCENE
from handsight.vision import DepthNoise

EYE, TARGET = np.array([-0.45, 0.50, 0.60]), np.array([0.0, 0.02, 0.07])
"""In the world [m]; what it looks at is the scene's middle too."""
INTRINSICS = np.array(
    [
        [SCENE.focal_length, 0, (IMAGE_SIZE[0] - 1) / 2],
        [0, SCENE.focal_length, (IMAGE_SIZE[1] - 1) / 2],
        [0, 0, 1.0],
    ]
)
"""Pixel centres at whole numbers."""
EDGE = 0.02
"""Within 1 m, a jump to something nearer beside which depth is lost [m]; beyond, it is more by the depth's square, as
disparity is."""


def camera_facing(eye: ArrayLike, at: ArrayLike) -> Array:
    """Returns T_world_camera (4, 4) of a camera at `eye` (3,) [m], upright, that looks at a point (3,) [m].

    Optical frame: x right, y down, z forward.
    """
    origin = checks.finite(eye, "eye", (3,))
    z = checks.unit(checks.finite(at, "at", (3,)) - origin, "at - eye", (3,))
    x = checks.unit(np.cross(z, [0.0, 0, 1]), "at - eye, seen from above", (3,))
    return se3.compose(np.column_stack([x, np.cross(z, x), z]), origin)


BELIEVED_CAMERA = camera_facing(EYE, TARGET)
"""T_world_camera (4, 4) as it was calibrated."""


def displacement(nuisances: Nuisances, seed: int) -> Array:
    """Returns T_believed_true (4, 4), in the world: what the wrong calibration does to all that the camera sees.

    A turn about the scene's middle and a shift, both constant.
    """
    draw = np.random.default_rng((seed, 4)).normal(size=6)
    # The mean length of a Gaussian in the plane is √(π/2) of its sigma.
    plane = nuisances.camera_position / np.sqrt(np.pi / 2)
    shift = draw[:3] * [plane, plane, nuisances.camera_height]
    R = se3.rotation_exp(nuisances.camera_rotation * draw[3:])
    return se3.compose(R, TARGET + shift - R @ TARGET)


def spoil(depth: Depth, noise: DepthNoise, rng: np.random.Generator, seed: int) -> Depth:
    """Returns what a camera makes of the true depth (h, w) [m], NaN where it gives none.

    `rng` draws what comes anew with each image, `seed` (at least 0) what is constant: that is another camera's with
    another seed. Without noise what is in range is exact.
    """
    z = np.asarray(depth, dtype=np.float32)
    known = _in_range(z, noise) & (rng.random(z.shape, dtype=np.float32) >= _lost(z, noise))
    z = _beside(z, noise.lateral, rng)
    known &= _in_range(z, noise)
    z = np.where(known, z, np.float32(1))
    a, b, c = map(np.float32, noise.axial)
    step = np.float32(noise.step) * z * z
    # Rounding is noise too, evenly spread over a step.
    sigma = np.sqrt(np.maximum(np.square(a + z * (b + z * c)) - step * step / 12, 0))
    sigma *= _grain(noise, z.shape, rng)
    z = z + sigma + _constant(noise, z, seed)
    if noise.step > 0:
        disparity = np.rint(1 / (np.float32(noise.step) * np.maximum(z, np.float32(0.01))))
        z = np.asarray(1 / (np.float32(noise.step) * np.maximum(disparity, 1)), dtype=np.float32)
    return np.where(known, z, np.float32(np.nan))


def _in_range(z: Depth, noise: DepthNoise) -> Mask:
    """Not NaN, not infinite."""
    return (z > noise.nearest) & (z < noise.farthest)


def _lost(z: Depth, noise: DepthNoise) -> Depth | np.float32:
    """Returns the share without depth at each pixel: behind edges more."""
    if noise.edges == 0:
        return np.float32(noise.dropouts)
    height, width = z.shape
    there = np.where(z > 0, z, np.float32(np.inf))
    around = np.pad(there, noise.edge_width, constant_values=np.inf)
    sides = range(2 * noise.edge_width + 1)
    nearest = reduce(np.minimum, (around[:, k : k + width] for k in sides))
    nearest = reduce(np.minimum, (nearest[k : k + height] for k in sides))
    behind = z > nearest + np.float32(EDGE) * np.square(np.maximum(nearest, 1))
    return np.where(behind, np.float32(noise.edges), np.float32(noise.dropouts))


def _beside(z: Depth, sigma: float, rng: np.random.Generator) -> Depth:
    """Returns each pixel's depth from one that is beside it."""
    if sigma == 0:
        return z
    offsets = np.rint(sigma * _quantiles(256)).astype(np.int32)  # whole pixels, a byte for each axis
    most = int(offsets.max())
    around = np.pad(z, most, mode="edge")
    width = around.shape[1]
    places = (offsets[:, None] * width + offsets).ravel()[
        rng.integers(1 << 16, size=z.shape, dtype=np.uint16)
    ]
    places += width * np.arange(most, most + z.shape[0], dtype=np.int32)[:, None]
    places += np.arange(most, most + z.shape[1], dtype=np.int32)
    return np.asarray(around.ravel()[places])


def _grain(noise: DepthNoise, shape: tuple[int, ...], rng: np.random.Generator) -> Depth:
    """Returns (h, w) noise of unit variance, part of it correlated."""
    drawn, share = _white(shape, rng), np.float32(noise.correlated)
    # The same numbers serve twice, half an image apart.
    other = np.roll(drawn, (shape[0] // 2, shape[1] // 2), axis=(0, 1))
    grain = _smoothed(drawn, noise.correlation)
    grain *= np.sqrt(share)
    grain += np.sqrt(1 - share) * other
    return grain


def _constant(noise: DepthNoise, z: Depth, seed: int) -> Depth:
    """Returns (h, w) what is wrong in each image of one camera [m]."""
    offset, smooth = _camera(z.shape, noise.smooth_length, seed)
    return np.float32(noise.offset) * offset + np.float32(noise.smooth) * smooth * z * z


@lru_cache(maxsize=8)
def _camera(shape: tuple[int, ...], length: float, seed: int) -> tuple[np.float32, Depth]:
    """Returns a number and a field (h, w) of unit variance."""
    rng = np.random.default_rng((seed, 10))
    return np.float32(rng.normal()), _smoothed(_white(shape, rng), length)


def _white(shape: tuple[int, ...], rng: np.random.Generator) -> Depth:
    """Returns (h, w) Gaussians, of 65 536 sizes: that takes a third of the time."""
    return _quantiles(1 << 16)[rng.integers(1 << 16, size=shape, dtype=np.uint16)]


@lru_cache(maxsize=2)
def _quantiles(number: int) -> Depth:
    """Returns (number,) of a Gaussian, equally likely."""
    return np.asarray(ndtri((np.arange(number) + 0.5) / number), dtype=np.float32)


def _smoothed(white: Depth, length: float) -> Depth:
    """Returns noise of unit variance whose correlation at distance d is exp(-d²/length²), round the image's borders
    too."""
    rows, columns = (np.exp(-0.5 * np.square(np.pi * length * fftfreq(n))) for n in white.shape)
    scale = (np.square(rows).mean() * np.square(columns).mean()) ** -0.5
    weights = np.outer(scale * rows, columns[: len(columns) // 2 + 1]).astype(np.float32)
    return np.asarray(irfft2(rfft2(white) * weights, s=white.shape), dtype=np.float32)
