"""What fingertips' sensors read while they touch nothing: a bias that their calibration does not know.

A tip that goes through the air bears itself alone. What it reads beyond that, the same in its own axes wherever it
goes, is its sensor's bias; what it touched would change on the way.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from handsight.checks import Array
from handsight.contact import compensate
from handsight.forces.loads import Ts_palm_sensor
from handsight.observation import Observation
from handsight.rig import Rig

WAY = 0.005
"""A tip that has gone so far in the palm over a window pushes nothing along by chance [m]."""
LARGEST = 0.5
"""More than this is a load, or a sensor that is broken [N]."""
UNSTEADY = 0.001
"""Readings that noise alone spreads so far with that chance change by more than noise."""


def read_in_air(rig: Rig, observations: Sequence[Observation]) -> Array:
    """(t, 6) mean load of each tip by its sensor, in the sensor's frame [N], [N m]; NaN where it may touch something:
    where it has hardly moved, or its load has changed, or is too large.

    `observations` of a short while, with joints and T_world_palm; nothing may be `lacking` in them.
    """
    ends = [Ts_palm_sensor(rig, dict(o.joint_positions or {})) for o in (observations[0], observations[-1])]
    far = np.linalg.norm(ends[1][:, :3, 3] - ends[0][:, :3, 3], axis=1) > WAY
    found = np.full((len(rig.fingers), 6), np.nan)
    R_palm_world = np.asarray(observations[-1].T_world_palm)[:3, :3].T
    limit = chdtri(3 * (len(observations) - 1), UNSTEADY)
    for i, (name, finger) in enumerate(rig.fingers.items()):
        if not far[i]:
            continue
        readings = np.array([o.wrenches[name] for o in observations])
        gravity = ends[1][i, :3, :3].T @ R_palm_world @ rig.gravity
        loads = np.hstack(compensate(readings[:, :3], readings[:, 3:], gravity, finger.calibration))
        mean = loads.mean(axis=0)
        spread = ((loads[:, :3] - mean[:3]) ** 2).sum() / finger.sigma_force**2
        if spread < limit and np.linalg.norm(mean[:3]) < LARGEST:
            found[i] = mean
    return found
