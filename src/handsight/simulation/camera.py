"""The Kinect at the shoulder: where it is, where the robot believes it to be, and what is wrong with its depth."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter

from handsight import checks, se3
from handsight.checks import Array
from handsight.simulation.scenario import Nuisances
from handsight.simulation.scene import FOCAL_LENGTH, IMAGE_SIZE

EYE, LOOKS_AT = np.array([-0.45, 0.50, 0.60]), np.array([0.0, 0.02, 0.07])
"""In the world [m]; what it looks at is the scene's middle too."""
INTRINSICS = np.array(
    [[FOCAL_LENGTH, 0, (IMAGE_SIZE[0] - 1) / 2], [0, FOCAL_LENGTH, (IMAGE_SIZE[1] - 1) / 2], [0, 0, 1.0]]
)
"""Pixel centres at whole numbers."""
NEAR, FAR = 0.4, 4.0
"""What its depth covers [m]."""
STEP = 2.85e-3
"""Of depth at 1 m [m]; it grows with the depth's square, for what is measured is disparity."""
DROPOUT, EDGE = 0.004, 0.02
"""Share of pixels without depth; a jump between neighbours at which the farther one loses it [m]."""
SHADOWED_BY = np.array([[0, 0, 1, 0, 0], [0, 1, 0, 1, 1], [0, 0, 1, 0, 0]])
"""These neighbours: beside something nearer the projector's pattern is in shadow, to its left over two pixels."""


def looking(eye: ArrayLike, at: ArrayLike) -> Array:
    """T_world_camera (4, 4) of a camera at `eye` (3,) [m], upright, that looks at a point (3,) [m].

    Optical frame: x right, y down, z forward.
    """
    origin = checks.finite(eye, "eye", (3,))
    z = checks.unit(checks.finite(at, "at", (3,)) - origin, "at - eye", (3,))
    x = checks.unit(np.cross(z, [0.0, 0, 1]), "at - eye, seen from above", (3,))
    return se3.compose(np.column_stack([x, np.cross(z, x), z]), origin)


BELIEVED_CAMERA = looking(EYE, LOOKS_AT)
"""T_world_camera (4, 4) as it was calibrated."""


def displacement(nuisances: Nuisances, seed: int) -> Array:
    """T_believed_true (4, 4), in the world: what the wrong calibration does to all that the camera sees.

    A turn about the scene's middle and a shift, both constant.
    """
    draw = np.random.default_rng((seed, 4)).normal(size=6)
    # The mean length of a Gaussian in the plane is √(π/2) of its sigma.
    plane = nuisances.camera_position / np.sqrt(np.pi / 2)
    shift = draw[:3] * [plane, plane, nuisances.camera_height]
    R = se3.rotation_exp(nuisances.camera_rotation * draw[3:])
    return se3.compose(R, LOOKS_AT + shift - R @ LOOKS_AT)


def kinect(depth: NDArray[np.float32], amount: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Depth (h, w) [m] as a Kinect gives it, NaN where it gives none; `amount` 0: all that is in range.

    Noise: Nguyen, Izadi and Lovell (2012), axial; quantisation grows with the depth's square.
    """
    z = depth.astype(np.float64)
    valid = (z > NEAR) & (z < FAR)
    if amount > 0:
        z = z + amount * (0.0012 + 0.0019 * (z - 0.4) ** 2) * rng.normal(size=z.shape)
        disparity = np.round(1 / (amount * STEP * np.maximum(z, NEAR / 2)))
        z = 1 / (amount * STEP * np.maximum(disparity, 1))
        nearest = minimum_filter(depth, footprint=SHADOWED_BY, mode="constant", cval=np.inf)
        valid &= (rng.random(z.shape) > amount * DROPOUT) & (depth - nearest <= EDGE)
    return np.where(valid, z, np.nan).astype(np.float32)
