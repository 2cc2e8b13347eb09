"""While the same fingers touch an object that does not slip, the answer moves by no more than its own sigma.

One wrong reading would else make a correction that rejects a finger, doubts the table or moves the object, and the next
one would take it all back.
"""

from dataclasses import replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.correction.estimate import point_uncertainty
from handsight.objects import ObjectModel
from handsight.tracking.track_state import Correction

CONFIRM_AFTER = 0.1
"""For so long corrections must dispute the last answer before one of them counts [s]."""


def disputed(
    model: ObjectModel, last: Correction, new: PoseEstimate, creep: Array, now: float
) -> Correction | None:
    """Returns the last correction, propagated to `now`, where a new one disputes it that does not count yet.

    A correction disputes the last one if it moves the object's middle, or turns it, by more than sigma, rejects a
    contact, or fits no pose. It counts once corrections have done so for `CONFIRM_AFTER`; before a larger step sigma
    grows by the step. `creep` (6,): variance of the object's motion since the last correction [m², rad²].
    """
    known = last.estimate
    if not known.consistent:
        return None
    T, middle = known.T_palm_object, model.center_object
    T_new = model.nearest(new.T_palm_object, T)
    turn = se3.difference(T_new, T)[3:]
    shift = (T_new - T)[:3, :3] @ middle + (T_new - T)[:3, 3]
    steps = np.array([shift @ shift, turn @ turn])
    # The variance of the turn about its axis, times the turn's square.
    along = float(turn @ (known.bounded_covariance[3:, 3:] + np.diag(creep[3:])) @ turn)
    far = steps[0] > last.variance + creep[0] or steps[1] ** 2 > along
    rejects = bool(new.outliers) and not known.outliers
    if not far and not rejects and new.consistent:
        return None
    since = now if last.disputed_at is None else last.disputed_at
    variance = creep
    if now - since >= CONFIRM_AFTER - 1e-9:
        if not far or not new.consistent:
            return None
        variance = creep + np.repeat(steps, 3)
    kept = known.inflated(variance)
    _, of_middle = point_uncertainty(kept, model, middle)
    return replace(last, estimate=kept, stamp=now, variance=of_middle, disputed_at=since)
