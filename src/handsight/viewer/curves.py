"""What is plotted of answers over time."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.evaluation import Truths, pose_errors
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.tracking import State
from handsight.viewer.moment import Moment

MOST = 300
"""Moments that are plotted."""


class Curves(NamedTuple):
    """`Curves` are uncertainty, error and state over time."""

    times: Array
    """(n,) ascending, since a recording's beginning or until now [s]."""
    sigmas: Array
    """(n,) of the position [mm], NaN where nothing is known."""
    errors: Array | None
    """(n,) of the object's middle [mm], NaN where the truth is not known; None where it never is."""
    states: Sequence[State]
    """n of them."""
    slips: Sequence[tuple[float, float]] = ()
    """From when to when the object slipped [s]."""


def curves(moments: Sequence[Moment], model: ObjectModel, truths: Truths) -> Curves:
    """Returns the curves of moments in order of stamp, of many as many as can be told apart, the first and the last
    among them."""
    places = np.linspace(0, len(moments) - 1, min(len(moments), MOST)).astype(int)
    shown = [moments[k] for k in places]
    times = np.array([moment.stamp - moments[0].stamp for moment in shown])
    sigmas = 1e3 * np.array([moment.sigma for moment in shown])
    sigmas[~np.isfinite(sigmas)] = np.nan
    slips = slips_of((moment.stamp, moment.slip) for moment in moments)
    begin = moments[0].stamp if moments else 0.0
    slips = [(first - begin, last - begin) for first, last in slips]
    return Curves(times, sigmas, _errors(shown, model, truths), [moment.state for moment in shown], slips)


def slips_of(slips: Iterable[tuple[float, Slip]]) -> list[tuple[float, float]]:
    """Returns from when to when the object slipped [s], by what was said at which stamps."""
    found: dict[float, float] = {}
    for stamp, slip in slips:
        if slip.slipping:
            found[slip.began] = stamp
    return list(found.items())


def _errors(moments: Sequence[Moment], model: ObjectModel, truths: Truths) -> Array | None:
    rows = [
        (k, moment.estimate.T_palm_object, true)
        for k, moment in enumerate(moments)
        if moment.estimate is not None and (true := truths.at(moment.stamp)) is not None
    ]
    if not rows:
        return None
    places, Ts, Ts_true = (np.array(column) for column in zip(*rows, strict=True))
    errors = np.full(len(moments), np.nan)
    # The middle's error in space is the same in every frame.
    errors[places] = 1e3 * pose_errors(model, Ts, Ts_true, np.broadcast_to(np.eye(4), Ts.shape)).middle
    return errors
