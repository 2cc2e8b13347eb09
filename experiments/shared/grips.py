"""Grips in which contacts bound a slide without fixing it: two fingers oppose a thumb, and vision is far off."""

import numpy as np

import handsight as hs
from handsight import se3
from testbed import scenes
from testbed.report import Array

NOISE = (1.6e-3, float(np.deg2rad(4)))
"""Noise of a contact per axis, as joint offsets of 1 degree cause it."""
PLANE_MEAN, TURN = 0.080, np.deg2rad(10)
"""Mean length of vision's error in the table's plane [m], and root mean square of its rotation [rad]."""
ON_TABLE, IN_SPACE = 0.003, PLANE_MEAN / np.sqrt(np.pi / 2)  # a Rayleigh length has this mean
"""Standard deviations of the height [m]: with a known table, and without."""


def gripped(
    surface: scenes.Surface, rng: np.random.Generator, height: float
) -> tuple[hs.Contacts, hs.PosePrior, Array]:
    """Returns contacts, vision's pose with its true covariance, and the true pose; the object's z is vertical."""
    T = se3.random(rng, spread=0.1)
    R = T[:3, :3]
    contacts = scenes.touched(T, surface, NOISE, rng)
    sigma = np.array([IN_SPACE, IN_SPACE, height, *[TURN / np.sqrt(3)] * 3])
    wrong = sigma * rng.normal(size=6)
    T_vision = se3.moved(T, np.concatenate([R @ wrong[:3], R @ wrong[3:]]))
    return contacts, hs.PosePrior(T_vision, se3.rotate_covariance(R, np.diag(sigma**2))), T
