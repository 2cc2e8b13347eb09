"""The hand's motion: fingers close on an object, then the palm moves over the table, up, and turns.

The grasps on can and box were found by random search on the Shadow hand (J3 spread, J2 knuckle, J1 middle; a tendon
couples the last joint of a finger to its middle one).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.simulation.scene import BOX_SIZE, CAN_SIZE


class MotionOptions(NamedTuple):
    """`MotionOptions` are the times of the hand's motion, and by how much a scenario varies its grasp."""

    closed: float = 0.7  # when the servos' targets are those of the closed hand [s]
    free: float = 1.0  # when the object is let go [s]
    at_rest: float = 1.4  # when the object is at rest in the hand [s]
    moves: float = 1.9  # when the palm may move [s]
    max_shift: float = 0.003  # half width of the object's uniform position, per axis [m]
    max_rotation: float = float(np.deg2rad(3.0))  # half width of its uniform rotation [rad]
    max_aim: float = float(np.deg2rad(1.0))  # half width of the joints' uniform targets [rad]


MOTION = MotionOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A `Grasp` is a closing motion of the hand around an object."""

    T_palm_middle: Array
    """(4, 4) when the fingers begin to close; `middle` is the middle of the object's bounds, with the object's axes."""
    opening: Mapping[str, float]
    """Servo targets of the open hand by joint [rad]; 0 for joints that are not named."""
    closed: Mapping[str, float]  # servo targets of the closed hand by joint [rad]
    height: float  # height of `middle` above the table [m]
    R_world_palm: Array = field(default_factory=lambda: np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]))
    """(3, 3) when the fingers begin to close; by default fingers point along x, the palm faces y, the thumb is up."""


def _joints(**of_finger: Mapping[int, float]) -> dict[str, float]:
    joints = {f"{finger}J{k}": angle for finger, angles in of_finger.items() for k, angle in angles.items()}
    return {f"robot0:{joint}": angle for joint, angle in joints.items()}


_UPRIGHT = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""R_palm_object with the object's z along the palm's x, which is up."""

CAN = Grasp(
    height=CAN_SIZE[1] / 2,
    T_palm_middle=se3.compose(_UPRIGHT, np.array([0.0142, -0.0884, 0.0923])),
    opening=_joints(TH={4: -0.45, 3: 1.22, 2: 0.18, 1: -0.2, 0: -1.3}),
    closed=_joints(
        FF={3: 0.35, 2: 0.87, 1: 0.53},
        MF={3: 0.01, 2: 0.94, 1: 0.63},
        RF={3: -0.04, 2: 1.22, 1: 0.24},
        LF={4: 0.35, 3: -0.28, 2: 0.77, 1: 0.39},
        TH={4: 0.31, 3: 1.22, 2: 0.18, 1: -0.52, 0: -1.36},
    ),
)
BOX = Grasp(
    height=BOX_SIZE[2] / 2,
    T_palm_middle=se3.compose(
        _UPRIGHT @ se3.rotation_exp(np.array([0.0, 0.0, -0.315])), np.array([-0.0023, -0.0897, 0.1001])
    ),
    opening=_joints(TH={4: -0.6, 3: 1.15, 2: 0.21, 1: -0.22, 0: -0.61}),
    closed=_joints(
        FF={3: 0.0, 2: 0.68, 1: 0.61},
        MF={3: 0.0, 2: 0.74, 1: 0.57},
        TH={4: 0.0, 3: 1.15, 2: 0.21, 1: -0.22, 0: -0.61},
    ),
)
POWER_CAN = Grasp(
    height=CAN_SIZE[1] / 2,
    T_palm_middle=se3.compose(_UPRIGHT, np.array([-0.041, -0.0481, 0.061])),
    opening=_joints(TH={4: -0.96, 3: 0.53, 2: 0.0, 1: 0.0, 0: 0.0}),
    closed=_joints(
        FF={2: 1.12, 1: 1.08},
        MF={2: 1.57, 1: 0.95},
        RF={2: 1.20, 1: 0.86},
        LF={2: 0.62, 1: 1.57},
        TH={4: -0.02, 3: 0.53, 2: -0.09, 1: -0.44, 0: -1.02},
    ),
)
"""Fingers press the can on the palm, its upper end in front of the palm's middle."""


def perturbed(grasp: Grasp, rng: np.random.Generator) -> Grasp:
    """Returns the grasp with the object and the joints' targets displaced by uniform draws of `MotionOptions`."""
    shift = rng.uniform(-MOTION.max_shift, MOTION.max_shift, 3)
    turn = rng.uniform(-MOTION.max_rotation, MOTION.max_rotation, 3)
    aim = rng.uniform(-MOTION.max_aim, MOTION.max_aim, len(grasp.closed))
    closed = {joint: angle + a for (joint, angle), a in zip(grasp.closed.items(), aim, strict=True)}
    T_palm_middle = se3.moved(grasp.T_palm_middle, np.concatenate([shift, turn]))
    return replace(grasp, T_palm_middle=T_palm_middle, closed=closed)


LEGS = np.array([  # duration [s], then at its end: x, y, z [m], turn about the vertical, tilt about the forearm [deg]
    (0.5, 0.00, 0.00, 0.00, 0, 0),
    (1.5, 0.00, 0.10, 0.00, 0, 0),
    (2.0, 0.00, -0.06, 0.00, 0, 0),
    (1.0, 0.02, 0.00, 0.00, 0, 0),
    (1.5, 0.02, 0.00, 0.12, 0, 0),
    (3.0, 0.02, 0.00, 0.12, 75, 0),
    (1.5, 0.02, 0.00, 0.12, 75, 15),
    (3.0, 0.02, 0.00, 0.12, 10, 0),
    (2.5, 0.02, 0.00, 0.16, 75, 0),
    (0.5, 0.02, 0.00, 0.16, 75, 0),
])  # fmt: skip
"""(10, 6) legs of a manipulation, once the object is in the hand [s, m, rad]; a mere grasp has only the first."""
LEGS[:, 4:] = np.deg2rad(LEGS[:, 4:])
PULLED = np.array([
    (0.5, 0.00, 0.00, 0.00, 0, 0),
    (1.0, 0.00, 0.00, 0.08, 0, 0),
    (0.5, 0.00, 0.00, 0.08, 0, 0),
    (3.5, 0.00, 0.00, 0.08, 0, 0),
    (1.2, 0.00, 0.00, 0.08, 0, np.deg2rad(20)),
    (0.8, 0.00, 0.00, 0.08, 0, np.deg2rad(20)),
])  # fmt: skip
"""(6, 6) legs of a motion in which the object is pulled: during the fourth."""
WEIGH_LEGS = np.array([  # the last column: tilt about the horizontal across the forearm [deg]
    (0.5, 0.00, 0.00, 0.00, 0, 0, 0),
    (1.2, 0.00, 0.00, 0.12, 0, 0, 0),
    (0.6, 0.00, 0.00, 0.12, 0, 0, 0),
    *((1.0, 0.00, 0.00, 0.12, 0, 20, 0), (0.6, 0.00, 0.00, 0.12, 0, 20, 0)),
    *((1.2, 0.00, 0.00, 0.12, 0, 0, 20), (0.6, 0.00, 0.00, 0.12, 0, 0, 20)),
    *((1.2, 0.00, 0.00, 0.12, 0, -20, 0), (0.6, 0.00, 0.00, 0.12, 0, -20, 0)),
    *((1.2, 0.00, 0.00, 0.12, 0, 0, -20), (0.6, 0.00, 0.00, 0.12, 0, 0, -20)),
    *((1.0, 0.00, 0.00, 0.12, 0, 0, 0), (0.6, 0.00, 0.00, 0.12, 0, 0, 0)),
    *((0.6, 0.00, 0.06, 0.12, 0, 0, 0), (0.6, 0.00, -0.06, 0.15, 0, 0, 0)),
    *((0.5, 0.04, 0.06, 0.12, 0, 0, 0), (0.5, 0.00, -0.06, 0.16, 0, 0, 0)),
])  # fmt: skip
"""(17, 7) legs of a weighing: after the lift five orientations, then faster and faster to and fro."""
WEIGH_LEGS[:, 4:] = np.deg2rad(WEIGH_LEGS[:, 4:])


def least_jerk(s: Array) -> Array:
    """Returns positions from 0 to 1 at shares `s` of the time, at rest at both ends (Flash and Hogan 1985)."""
    return np.asarray(s**3 * (10 - 15 * s + 6 * s * s))


def palm_poses(legs: Array, times: Array, T_world_palm: Array, pivot: Array) -> Array:
    """Returns Ts_world_palm (n, 4, 4) at `times` (n,) after the start [s]; the palm is at rest at the end of each leg.

    It starts at `T_world_palm` (4, 4) and turns about `pivot` (3,) [m]. `legs` (m, 6 or 7): as `LEGS` or `WEIGH_LEGS`.
    """
    ends = np.cumsum(legs[:, 0])
    i = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
    s = np.clip(1 - (ends[i] - times) / legs[i, 0], 0, 1)
    begins = np.vstack([np.zeros(legs.shape[1] - 1), legs[:-1, 1:]])
    now = begins[i] + least_jerk(s)[:, None] * (legs[i, 1:] - begins[i])
    R = se3.rotation_exp(now[:, 3:4] * [0.0, 0, 1]) @ se3.rotation_exp(now[:, 4:5] * [1.0, 0, 0])
    if legs.shape[1] > 6:
        R = R @ se3.rotation_exp(now[:, 5:6] * [0.0, 1, 0])
    return np.asarray(se3.compose(R, pivot + now[:, :3] - R @ pivot) @ T_world_palm)
