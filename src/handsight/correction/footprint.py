"""Where to begin with an array of taxels: along what contacts leave open, where the object covers what it should.

Under a face a point that should be outside says that the face is too deep, not which way it ends: the evidence has no
slope there, and a descent stays where vision was. So poses are drawn from what contacts alone leave open, and begun
from where all evidence together is likeliest.
"""

from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.estimate import PoseEstimate
from handsight.correction.outside import Outside
from handsight.correction.problem import Problem
from handsight.correction.solve import cost


class FootprintOptions(NamedTuple):
    """`FootprintOptions` say how poses are drawn that leave a skin's footprint as it is."""

    draws: int = 384  # poses of a round
    rounds: int = 3  # rounds, each drawn around the likeliest poses of the one before
    kept: int = 12  # likeliest poses of a round that the next is drawn around
    shrink: float = 0.3  # how much closer each round draws
    seed: int = 5  # of the draws, the same for every problem


FOOTPRINT = FootprintOptions()


def less_certain(estimate: PoseEstimate, outside: object) -> PoseEstimate:
    """Returns the estimate as uncertain as the array is that its evidence was relative to, if there was one."""
    if not isinstance(outside, Outside) or outside.skin is None:
        return estimate
    return estimate.inflated(np.asarray(outside.skin) ** 2)


def likely_starts(problem: Problem, estimate: PoseEstimate) -> Array:
    """Returns (K, 4, 4) poses that the whole problem is likeliest at, drawn around an estimate of its contacts
    alone."""
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    rng = np.random.default_rng(FOOTPRINT.seed)
    values, vectors = np.linalg.eigh(estimate.bounded_covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    best = estimate.T_palm_object_maximum[None]
    for k in range(FOOTPRINT.rounds):
        around = best[np.arange(FOOTPRINT.draws) % len(best)]
        drawn = se3.moved(around, FOOTPRINT.shrink**k * rng.normal(size=(FOOTPRINT.draws, 6)) @ root.T)
        poses = np.concatenate([best, drawn])
        best = poses[np.argsort(cost(problem, poses, used), kind="stable")[: FOOTPRINT.kept]]
    return best
