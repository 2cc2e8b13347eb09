"""What fingertips' sensors read while they touch nothing: a bias that their calibration does not know.

A tip that goes through the air bears itself alone. What it reads beyond that, the same in its own axes wherever it
goes, is its sensor's bias; what it touched would change on the way.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from handsight.checks import Array
from handsight.contact import compensate
from handsight.forces.loads import Ts_palm_sensor
from handsight.observation import Observation
from handsight.rig import Rig


class TareOptions(NamedTuple):
    """`TareOptions` say when readings in the air are those of an unloaded sensor."""

    min_travel: float = 0.005
    """A tip that has moved this far in the palm over a window pushes nothing along by chance [m]."""
    max_force: float = 0.5  # more than this is a load, or a broken sensor [N]
    unsteady_p: float = 0.001
    """Readings that noise alone spreads this far with that chance change by more than noise."""


TARE = TareOptions()


def read_in_air(rig: Rig, observations: Sequence[Observation]) -> Array:
    """Returns (t, 6) mean load of each tip by its sensor, in the sensor's frame [N], [N m]; NaN where it may touch
    something: where it has hardly moved, or its load has changed, or is too large.

    `observations` of a short while, with joints and T_world_palm; nothing may be `lacking` in them.
    """
    ends = [Ts_palm_sensor(rig, dict(o.joint_positions or {})) for o in (observations[0], observations[-1])]
    far = np.linalg.norm(ends[1][:, :3, 3] - ends[0][:, :3, 3], axis=1) > TARE.min_travel
    found = np.full((len(rig.fingers), 6), np.nan)
    R_palm_world = np.asarray(observations[-1].T_world_palm)[:3, :3].T
    limit = chdtri(3 * (len(observations) - 1), TARE.unsteady_p)
    for i, (name, finger) in enumerate(rig.fingers.items()):
        if not far[i]:
            continue
        readings = np.array([o.wrenches[name] for o in observations])
        gravity = ends[1][i, :3, :3].T @ R_palm_world @ rig.gravity
        loads = np.hstack(compensate(readings[:, :3], readings[:, 3:], gravity, finger.calibration))
        mean = loads.mean(axis=0)
        spread = ((loads[:, :3] - mean[:3]) ** 2).sum() / finger.sigma_force**2
        if spread < limit and np.linalg.norm(mean[:3]) < TARE.max_force:
            found[i] = mean
    return found
