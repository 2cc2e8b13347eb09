"""A table as a measurement of an object that stands on it: how high its base is, and that it does not tilt."""

import numpy as np

from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.rig import Table
from handsight.tracking.smoother import PoseAndBias

GATE_CHI2 = 16.3
"""χ² of three numbers that one in a thousand exceeds: beyond it the object does not stand there."""


def on_table(state: PoseAndBias, model: ObjectModel, table: Table, T_world_palm: Array) -> PoseAndBias | None:
    """The state given that the object stands on the table; None where that is beyond the gate.

    It stands along the one of its six axes' directions that points up most.
    """
    H, innovation = _linearized(state, model, table, T_world_palm)
    noise = np.diag([table.sigma_height**2, table.sigma_tilt**2, table.sigma_tilt**2])
    S = H @ state.covariance @ H.T + noise
    if innovation @ np.linalg.solve(S, innovation) > GATE_CHI2:
        return None
    return state.updated(H, innovation, noise)


def _linearized(
    state: PoseAndBias, model: ObjectModel, table: Table, T_world_palm: Array
) -> tuple[Array, Array]:
    """Jacobian (3, 12) and innovation (3,): height of the base [m], tilt about the world's x and y [rad]."""
    R = T_world_palm[:3, :3]
    T = T_world_palm @ state.T_palm_object
    up = int(np.argmax(np.abs(T[2, :3])))
    sign = 1.0 if T[2, up] > 0 else -1.0
    axis = sign * T[:3, up]
    base = model.bounds_object[0, up] if sign > 0 else -model.bounds_object[1, up]
    # The swing that brings the axis upright; about z it says nothing.
    swing = np.array([axis[1], -axis[0]])
    sine = float(np.linalg.norm(swing))
    if sine > 1e-9:
        swing = swing / sine * np.arctan2(sine, axis[2])
    H = np.zeros((3, 12))
    H[0, :3] = R[2]
    H[1:, 3:6] = R[:2]
    return H, np.concatenate([[table.height - base - T[2, 3]], swing])
