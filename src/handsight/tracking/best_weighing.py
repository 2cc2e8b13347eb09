"""What a recording tells of an object's weight: the best of all weighings in it."""

from collections.abc import Iterable

import numpy as np

from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.objects.symmetry import kept_center
from handsight.observation import Observation
from handsight.tracking.replay import Tally, replay
from handsight.tracking.tracker import Tracker
from handsight.tracking.weight_update import ObjectWeight

ENOUGH_DIRECTIONS = 2
"""Of gravity: of one, the centre's height along it is open."""


def best_weight(observations: Iterable[Observation], tracker: Tracker) -> tuple[ObjectWeight | None, str]:
    """Returns the weighing whose centre of mass in the object is known best, and, where none is believed, why.

    `tracker`: of a model without a centre of mass, else what comes out is what was put in.
    """
    best: ObjectWeight | None = None
    reason = "the object was never in the air"
    for _ in replay(observations, tracker, Tally()):
        found = tracker.weight
        if found is None:
            continue
        if found.reason:
            reason = found.reason
        elif found.directions < ENOUGH_DIRECTIONS:
            reason = "gravity had one direction in the palm all the time: tilt the hand by 20° about two axes"
        elif best is None or np.trace(found.covariance) < np.trace(best.covariance):
            best = found
    return best, "" if best is not None else reason


def center_of(found: ObjectWeight, model: ObjectModel) -> tuple[Array, float]:
    """Returns the centre of mass (3,) that the object's symmetries allow [m], and its largest sigma."""
    zero = kept_center(model.symmetries, np.zeros(3))
    kept = np.column_stack([kept_center(model.symmetries, axis) - zero for axis in np.eye(3)])
    covariance = kept @ found.covariance @ kept.T
    return kept_center(model.symmetries, found.center_object), float(
        np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 1e-8))
    )
