"""Grips that contacts bound and do not fix: two fingers and a thumb on opposite sides, vision far off."""

import numpy as np

import handsight as hs
from handsight import se3
from shared import scenes
from testbed.report import Array

NOISE = (1.6e-3, float(np.deg2rad(4)))
"""Of a contact per axis: what joint offsets of 1 degree leave."""
PLANE_MEAN, TURN = 0.080, np.deg2rad(10)
"""Vision's error in the table's plane on average [m], and of the turn, root mean square [rad]."""
ON_TABLE, IN_SPACE = 0.003, PLANE_MEAN / np.sqrt(np.pi / 2)  # a Rayleigh length has this mean
"""One standard deviation of the height [m]: where the table is known, and where it is not."""


def gripped(
    surface: scenes.Surface, rng: np.random.Generator, height: float
) -> tuple[hs.Contacts, hs.PosePrior, Array]:
    """Contacts, vision, its covariance stated truthfully, and the true pose; the table's normal is the object's z."""
    T = se3.random(rng, spread=0.1)
    R = T[:3, :3]
    contacts = scenes.touched(T, surface, NOISE, rng)
    sigma = np.array([IN_SPACE, IN_SPACE, height, *[TURN / np.sqrt(3)] * 3])
    wrong = sigma * rng.normal(size=6)
    T_vision = se3.moved(T, np.concatenate([R @ wrong[:3], R @ wrong[3:]]))
    return contacts, hs.PosePrior(T_vision, se3.rotate_covariance(R, np.diag(sigma**2))), T
