"""What pulls an object out of a hand that holds still: a person's hand, as it were, which yields and lets go."""

import math
from typing import NamedTuple, get_args

import numpy as np

from handsight.checks import Array
from handsight.simulation.scenario import SCENARIO, Profile, Scenario


class PullOptions(NamedTuple):
    """`PullOptions` say how something pulls at the object until it slips."""

    begin: float = 3.4
    """When it pulls, as `motion.PULLED` has it: the object is lifted and at rest by then [s]."""
    duration: float = 3.0  # how long [s]
    step: float = 0.5  # length of a step of the force [s]
    rise: float = 0.05  # how long it takes to rise [s]
    frequency: float = 1.5  # of a sine [1/s]
    min_speed: float = 0.03
    """How fast the object may slip along the tips until the pull follows no more, least draw [m/s]."""
    max_speed: float = 0.1  # largest draw [m/s]
    flying_speed: float = 0.3  # the same however it moves [m/s]
    min_travel: float = 0.005  # how far it slips before it is let go, least draw [m]
    max_travel: float = 0.02  # largest draw [m]
    normal_share: float = 0.03
    """It pulls along what the tips press on, not off them: the variance of its direction's part across all of them in
    parts of that along all.
    """


PULL = PullOptions()


class Pull:
    """A `Pull` is one draw of it: where to, how fast, how far; `wrench` is what it does to the object now."""

    def __init__(self, scenario: Scenario, normals_palm: Array) -> None:
        """The scenario's motion must be a profile; `normals_palm` (n, 3): of the tips' contacts with the object."""
        rng = np.random.default_rng((int(scenario.seed), 11))
        direction, axis = rng.normal(size=(2, 3))
        across = normals_palm.T @ normals_palm / max(len(normals_palm), 1)
        direction = np.linalg.solve(np.linalg.cholesky(across + PULL.normal_share * np.eye(3)).T, direction)
        self._force = scenario.nuisances.pull_force * direction / np.linalg.norm(direction)
        self._torque = scenario.nuisances.pull_torque * axis / np.linalg.norm(axis)
        self._speed, self._far = (
            rng.uniform(PULL.min_speed, PULL.max_speed),
            rng.uniform(PULL.min_travel, PULL.max_travel),
        )
        self._profile, self._slipped = scenario.motion, 0.0

    def wrench(self, time: float, slips: float, moves: float) -> Array:
        """Returns (6,) force [N] and torque [N m] along the palm's axes, for the simulator's next step.

        `slips`: how fast the object slips along the tips [m/s]; `moves`: how fast it moves at all [m/s].
        """
        since = time - PULL.begin
        self._slipped += slips / SCENARIO.steps_per_second
        if not 0 <= since <= PULL.duration or self._slipped > self._far:
            return np.zeros(6)
        yields = max(
            0.0, 1 - max(slips / self._speed, moves / PULL.flying_speed) ** 4
        )  # in vain, once it is fast
        return yields * height(self._profile, since) * np.concatenate([self._force, self._torque])


def height(profile: str, since: float) -> float:
    """Returns how strong a pull is, in parts of its greatest force, so long after its begin [s]."""
    share = since / PULL.duration
    if profile == "ramp":
        return share
    if profile == "steps":
        steps, within = divmod(since, PULL.step)
        return min(1.0, (steps + min(within / PULL.rise, 1.0)) * PULL.step / PULL.duration)
    return share * (1 - math.cos(2 * math.pi * PULL.frequency * since)) / 2


def pulls(motion: str) -> bool:
    """Returns whether a motion is one in which the object is pulled."""
    return motion in get_args(Profile)
