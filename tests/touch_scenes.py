"""For tests of the search by touch: an area, and touches of an object at a known pose, computed by casting."""

import functools

import numpy as np

import handsight as hs
from handsight import se3
from handsight.rig import Table
from handsight.search import Area, Sweep, Touch, cast

RADIUS, SIGMA_POINT, SIGMA_NORMAL = 0.009, 0.0015, float(np.deg2rad(4.0))


@functools.cache
def box():
    return hs.ObjectModel.box([0.06, 0.09, 0.14])


@functools.cache
def can():
    return hs.ObjectModel.cylinder(0.033, 0.122)


def area(half=0.12, Rs=None):
    Rs = np.eye(3)[None] if Rs is None else Rs
    return Area(np.full(2, -half), np.full(2, half), Table(height=0.0), Rs)


def touched(model, T_world_object, sweep, rng):
    """The touch of a sweep, with noise of the sigmas that it says."""
    (distance,), (normal,), _ = (values[0] for values in cast(model, T_world_object[None], [sweep], RADIUS))
    met = np.isfinite(distance)
    steps = np.arange(0.0, distance if met else sweep.length, 0.005)
    free = sweep.start_world + steps[:, None] * sweep.direction_world
    if not met:
        return Touch(free, RADIUS, 0.0025, None)
    normal = normal / np.linalg.norm(normal)
    point = sweep.at(distance) - RADIUS * normal + SIGMA_POINT * rng.normal(size=3)
    felt = se3.rotation_exp(SIGMA_NORMAL * rng.normal(size=3)) @ normal
    return Touch(free, RADIUS, 0.0025, hs.Contacts(point[None], felt[None], SIGMA_POINT, SIGMA_NORMAL))


def level(start, direction, length=0.5, height=0.1):
    return Sweep(np.array([*start, height]), np.array([*direction, 0.0]), length)
