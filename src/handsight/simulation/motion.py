"""The hand's motion: fingers close on an object, then the palm moves over the table, up, and turns."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.simulation.tables import tables

CLOSED_AT = 0.7
"""When the servos' targets are those of the closed hand [s]."""
FREE_AT = 1.0
"""When the object is let go [s]."""
AT_REST = 1.4
"""When the object is at rest in the hand [s]."""
MOVES_AT = 1.9
"""When the palm may move [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A closing motion of the hand around an object."""

    T_palm_middle: Array
    """(4, 4) when the fingers begin to close; `middle` is the middle of the object's bounds, with the object's axes."""
    opening: Mapping[str, float]
    """Servo targets of the open hand by joint [rad]; 0 for joints that are not named."""
    closed: Mapping[str, float]  # servo targets of the closed hand by joint [rad]
    height: float  # height of `middle` above the table [m]
    R_world_palm: Array = field(default_factory=lambda: np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]))
    """(3, 3) when the fingers begin to close; by default fingers point along x, the palm faces y, the thumb is up."""


def _built_in(name: str) -> Grasp:
    """Returns a grasp of the Shadow hand from the table."""
    found = tables()["grasps"][name]
    upright = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    R_palm_object = upright @ se3.rotation_exp(np.array([0.0, 0.0, found["turn"]]))
    return Grasp(
        T_palm_middle=se3.compose(R_palm_object, np.array(found["position_palm"])),
        opening=found["opening"],
        closed=found["closed"],
        height=found["height"],
    )


CAN = _built_in("can")
BOX = _built_in("box")
POWER_CAN = _built_in("power_can")


def perturbed(grasp: Grasp, rng: np.random.Generator) -> Grasp:
    """Returns the grasp with the object displaced by at most 3 mm and 3°, and the joints' targets by 1°, per axis."""
    degree = math.radians(1.0)
    shift = rng.uniform(-0.003, 0.003, 3)
    turn = rng.uniform(-3 * degree, 3 * degree, 3)
    aim = rng.uniform(-degree, degree, len(grasp.closed))
    closed = dict(zip(grasp.closed, aim + list(grasp.closed.values()), strict=True))
    T_palm_middle = se3.moved(grasp.T_palm_middle, np.concatenate([shift, turn]))
    return replace(grasp, T_palm_middle=T_palm_middle, closed=closed)


def _legs(rows: list[list[float]]) -> Array:
    """Returns legs (m, 7), with their angles in radians."""
    legs = np.array(rows)
    legs[:, 4:] = np.deg2rad(legs[:, 4:])
    return legs


LEGS = {name: _legs(rows) for name, rows in tables()["legs"].items()}
"""By motion, its legs (m, 7) once the object is in the hand: duration [s], then at the end x, y, z [m], the turn about
the vertical, the tilt about the forearm, and the tilt about the horizontal across it [rad]."""


def least_jerk(s: Array) -> Array:
    """Returns positions from 0 to 1 at shares `s` of the time, at rest at both ends (Flash and Hogan 1985)."""
    return s**3 * (10 - 15 * s + 6 * s * s)


def palm_poses(legs: Array, times: Array, T_world_palm: Array, pivot: Array) -> Array:
    """Returns Ts_world_palm (n, 4, 4) at `times` (n,) after the start [s]; the palm is at rest at the end of each leg.

    It starts at `T_world_palm` (4, 4) and turns about `pivot` (3,) [m]; `legs` (m, 7) are as in `LEGS`.
    """
    ends = np.cumsum(legs[:, 0])
    i = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
    s = np.clip(1 - (ends[i] - times) / legs[i, 0], 0, 1)
    begins = np.vstack([np.zeros(6), legs[:-1, 1:]])
    now = begins[i] + least_jerk(s)[:, None] * (legs[i, 1:] - begins[i])
    heading, tilt, pitch = (
        se3.rotation_exp(now[:, 3 + k, None] * np.eye(3)[axis]) for k, axis in enumerate((2, 0, 1))
    )
    R = heading @ tilt @ pitch
    return se3.compose(R, pivot + now[:, :3] - R @ pivot) @ T_world_palm
