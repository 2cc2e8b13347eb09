"""Where the palm goes: over the table, up, round."""

from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.simulation.scenario import Motion

HELD, FREED, KEPT = 0.3, 0.4, 0.5
"""After closing [s]: the object is still held in place; it is let go and settles in the hand; the palm waits."""
_LEGS = (
    # seconds, then where at their end: x, y, z [m], turn about the vertical, tilt about the forearm [deg]
    (KEPT, 0.00, 0.00, 0.00, 0, 0),
    (1.5, 0.00, 0.10, 0.00, 0, 0),
    (2.0, 0.00, -0.06, 0.00, 0, 0),
    (1.0, 0.02, 0.00, 0.00, 0, 0),
    (1.5, 0.02, 0.00, 0.12, 0, 0),
    (3.0, 0.02, 0.00, 0.12, 75, 0),
    (1.5, 0.02, 0.00, 0.12, 75, 15),
    (3.0, 0.02, 0.00, 0.12, 10, 0),
    (2.5, 0.02, 0.00, 0.16, 75, 0),
    (0.5, 0.02, 0.00, 0.16, 75, 0),
)


@dataclass(frozen=True, slots=True)
class PalmPath:
    """How the palm moves from where the grasp was made."""

    T_world_palm: Array
    """(4, 4) at first."""
    pivot: Array
    """(3,) in the world: the point that turns leave in place."""
    legs: Array
    """(n, 6): duration [s], and at its end shift [m], turn, tilt [rad]."""

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.legs[:, 0].sum())

    def at(self, times: Array) -> Array:
        """Ts_world_palm (n, 4, 4) that many seconds (n,) after the start; at rest at the end of each leg."""
        ends = np.cumsum(self.legs[:, 0])
        i = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
        s = np.clip(1 - (ends[i] - times) / self.legs[i, 0], 0, 1)
        smooth = s**3 * (10 - 15 * s + 6 * s * s)  # least jerk
        begins = np.vstack([np.zeros(5), self.legs[:-1, 1:]])
        now = begins[i] + smooth[:, None] * (self.legs[i, 1:] - begins[i])
        turn, tilt = now[:, 3:4] * [0.0, 0, 1], now[:, 4:5] * [1.0, 0, 0]
        R = se3.rotation_exp(turn) @ se3.rotation_exp(tilt)
        return np.asarray(se3.compose(R, self.pivot + now[:, :3] - R @ self.pivot) @ self.T_world_palm)


def palm_path(motion: Motion, T_world_palm: Array, pivot: Array) -> PalmPath:
    """What the palm does once the object is in the hand."""
    legs = np.array(_LEGS if motion == "manipulate" else _LEGS[:1], dtype=np.float64)
    legs[:, 4:] = np.deg2rad(legs[:, 4:])
    return PalmPath(T_world_palm, pivot, legs)
