"""The moments of a recording in order of stamp, computed by a tracker, and their curves over time."""

import bisect
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array, Mask
from handsight.evaluation import Truths, pose_errors
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.tracking import Tracker
from handsight.tracking.replay import Tally, replay
from handsight.viewer.moment import Moment
from handsight.viewer.picture import Picture, Shot, picture

TIMELINE_FRAME = 1 / 30  # between two moments [s]
IMAGE_PERIOD = 0.1  # between two images [s]: each takes 40 kB
TIME_TOLERANCE = TIMELINE_FRAME / 32  # difference below which two stamps are the same [s]
MAX_PLOTTED = 300  # moments in a plot


class Timeline:
    """Moments in order of stamp; another thread may read while one appends."""

    def __init__(self) -> None:
        self.moments = list[Moment]()

    def append(self, moment: Moment) -> bool:
        """Returns whether a moment is kept: not if it is earlier than the last one, or less than a frame later."""
        if self.moments and moment.stamp - self.moments[-1].stamp < TIMELINE_FRAME - TIME_TOLERANCE:
            return False
        self.moments.append(moment)
        return True

    @property
    def begin(self) -> float:
        """Stamp of the first moment [s]."""
        return self.moments[0].stamp

    @property
    def length(self) -> float:
        """Time from the first to the last moment [s]; 0 where there is none."""
        return self.moments[-1].stamp - self.begin if self.moments else 0.0

    def at(self, time: float) -> Moment:
        """Returns the last moment that is not later than a time since the first [s], or the first one."""
        # begin + (stamp - begin) may round to less than the stamp: seconds since 1970 have a resolution of 0.25 µs.
        stamp = self.begin + time + TIME_TOLERANCE
        later = bisect.bisect_right(self.moments, stamp, key=lambda moment: moment.stamp)
        return self.moments[max(0, later - 1)]


def follow(
    observations: Iterable[Observation], tracker: Tracker, tally: Tally, timeline: Timeline
) -> Iterator[Moment]:
    """Fills a timeline with the estimates that `handsight track` gives, and yields the moments that are kept."""
    last: Moment | None = None
    pending: Picture | None = None
    last_image = -math.inf
    for step in replay(observations, tracker, tally):
        shot = Shot.now(tracker) if step.stamp - last_image >= IMAGE_PERIOD else None
        if shot is not None:
            pending = picture(tracker.rig, shot)
            last_image = step.stamp
        moment = Moment.now(tracker).after(last, pending)
        if timeline.append(moment):
            last = moment
            pending = None
            yield moment


class Curves(NamedTuple):
    """Uncertainty, error and state over time."""

    times: Array  # (n,) ascending, since the page's origin [s]
    sigmas: Array  # (n,) of the position [mm], NaN where nothing is known
    errors: Array  # (n,) of the object's middle [mm], NaN where the truth is not known
    states: NDArray[np.str_]  # (n,) of the track
    slipping: Mask  # (n,) whether the object slips


def curves(
    moments: Sequence[Moment], origin: float, model: ObjectModel | None = None, truths: Truths | None = None
) -> Curves:
    """Returns the curves of at most `MAX_PLOTTED` moments, evenly chosen, the first and the last among them.

    origin: stamp from which time is counted [s]; model, truths: of a recording that has the object's true poses.
    """
    places = np.linspace(0, len(moments) - 1, min(len(moments), MAX_PLOTTED)).astype(int)
    shown = [moments[k] for k in places]
    stamps = np.array([moment.stamp for moment in shown])
    sigmas = np.array([moment.sigma for moment in shown])
    slipping = np.zeros(len(shown), dtype=bool)
    for ends in slips_of((moment.stamp, moment.slip) for moment in moments):
        first, last = np.searchsorted(stamps, ends, side="right")
        slipping[max(first - 1, 0) : last] = True
    errors = np.full(len(shown), np.nan)
    if model is not None and truths is not None:
        errors = middle_errors(shown, model, truths)
    return Curves(
        times=stamps - origin,
        sigmas=np.where(np.isfinite(sigmas), 1000 * sigmas, np.nan),
        errors=errors,
        states=np.array([moment.state for moment in shown]),
        slipping=slipping,
    )


def middle_errors(moments: Sequence[Moment], model: ObjectModel, truths: Truths) -> Array:
    """Returns the errors (n,) of the object's middle [mm], NaN where the truth is not known."""
    errors = np.full(len(moments), np.nan)
    known = []
    for k, moment in enumerate(moments):
        true = truths.at(moment.stamp)
        if moment.estimate is not None and true is not None:
            known.append((k, moment.estimate.T_palm_object, true))
    if known:
        rows, Ts, Ts_true = (np.array(column) for column in zip(*known, strict=True))
        # The error of the middle in space is the same in every frame.
        world = np.broadcast_to(np.eye(4), Ts.shape)
        errors[rows] = 1000 * pose_errors(model, Ts, Ts_true, world).middle
    return errors


def slips_of(slips: Iterable[tuple[float, Slip]]) -> list[tuple[float, float]]:
    """Returns the first and the last stamp of each time that the object slipped [s], from slips in order of stamp."""
    found: dict[float, float] = {}
    for stamp, slip in slips:
        if slip.slipping:
            found[slip.began] = stamp
    return list(found.items())
