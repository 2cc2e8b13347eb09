"""What pulls an object out of a hand that holds still: a person's hand, as it were, which yields and lets go."""

import math
from typing import get_args

import numpy as np

from handsight.checks import Array
from handsight.simulation.scenario import STEPS_PER_SECOND, Profile, Scenario

BEGINS, LASTS = 3.4, 3.0
"""When it pulls [s], as `motion.PULLED` has it: the object is lifted and at rest by then."""
STEP, RISE, PER_SECOND = 0.5, 0.05, 1.5
"""Length of a step of the force and how long it takes to rise [s]; how often a sine comes back [1/s]."""
SLOWEST, FASTEST = 0.03, 0.1
"""How fast the object may slip along the tips until the pull follows no more [m/s]; drawn between."""
FLIES = 0.3
"""The same however it moves [m/s]."""
NEAREST, FARTHEST = 0.005, 0.02
"""How far it slips before it is let go [m]; drawn between."""

ALONG = 0.03
"""It pulls along what the tips press on, not off them: this is the variance of its direction's part across all of them
in parts of that along all."""


class Pull:
    """One draw of it: where to, how fast, how far; `wrench` is what it does to the object now."""

    def __init__(self, scenario: Scenario, normals_palm: Array) -> None:
        """The scenario's motion must be a profile; `normals_palm` (n, 3): of the tips' contacts with the object."""
        rng = np.random.default_rng((int(scenario.seed), 11))
        direction, axis = rng.normal(size=(2, 3))
        across = normals_palm.T @ normals_palm / max(len(normals_palm), 1)
        direction = np.linalg.solve(np.linalg.cholesky(across + ALONG * np.eye(3)).T, direction)
        self._force = scenario.nuisances.pull_force * direction / np.linalg.norm(direction)
        self._torque = scenario.nuisances.pull_torque * axis / np.linalg.norm(axis)
        self._speed, self._far = rng.uniform(SLOWEST, FASTEST), rng.uniform(NEAREST, FARTHEST)
        self._profile, self._slipped = scenario.motion, 0.0

    def wrench(self, time: float, slips: float, moves: float) -> Array:
        """(6,) force [N] and torque [N m] along the palm's axes, for the simulator's next step.

        `slips`: how fast the object slips along the tips [m/s]; `moves`: how fast it moves at all [m/s].
        """
        since = time - BEGINS
        self._slipped += slips / STEPS_PER_SECOND
        if not 0 <= since <= LASTS or self._slipped > self._far:
            return np.zeros(6)
        yields = max(0.0, 1 - max(slips / self._speed, moves / FLIES) ** 4)  # in vain, once it is fast
        return yields * height(self._profile, since) * np.concatenate([self._force, self._torque])


def height(profile: str, since: float) -> float:
    """How strong a pull is, in parts of its greatest force, so long after its begin [s]."""
    share = since / LASTS
    if profile == "ramp":
        return share
    if profile == "steps":
        steps, within = divmod(since, STEP)
        return min(1.0, (steps + min(within / RISE, 1.0)) * STEP / LASTS)
    return share * (1 - math.cos(2 * math.pi * PER_SECOND * since)) / 2


def pulls(motion: str) -> bool:
    """Whether a motion is one in which the object is pulled."""
    return motion in get_args(Profile)
