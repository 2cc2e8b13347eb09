"""The moments of a recording in order of stamp, computed by a tracker, and their curves over time."""

import bisect
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.evaluation import Truths, pose_errors
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.tracking import State, Tracker
from handsight.tracking.clock import MAX_UNCONFIRMED
from handsight.tracking.replay import Tally, replay
from handsight.viewer.moment import Moment
from handsight.viewer.picture import Picture, picture


class TimelineOptions(NamedTuple):
    """`TimelineOptions` say how much of a recording is kept to be shown."""

    frame: float = 1 / 30  # between two moments [s]
    image_period: float = 0.1  # between two images [s]: each takes 40 kB
    time_tolerance: float = 1e-3  # difference below which two stamps are the same [s]
    max_plotted: int = 300  # moments in a plot


TIMELINE = TimelineOptions()


class Timeline:
    """A `Timeline` is moments in order of stamp; another thread may read while one appends."""

    def __init__(self) -> None:
        self.moments = list[Moment]()

    def append(self, moment: Moment) -> bool:
        """Returns whether a moment is kept: not if it is earlier than the last one, or less than a frame later."""
        last = self.moments[-1].stamp if self.moments else -math.inf
        if moment.stamp - last < TIMELINE.frame - TIMELINE.time_tolerance:
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
        stamp = self.begin + time + TIMELINE.time_tolerance
        later = bisect.bisect_right(self.moments, stamp, key=lambda moment: moment.stamp)
        return self.moments[max(0, later - 1)]


def follow(
    observations: Iterable[Observation], tracker: Tracker, tally: Tally, timeline: Timeline
) -> Iterator[Moment]:
    """Fills a timeline with the estimates that `handsight track` gives, and yields the moments that are kept."""
    taken = deque[Observation](maxlen=MAX_UNCONFIRMED + 2)  # an estimate may wait for that many observations

    def remembered() -> Iterator[Observation]:
        for observation in observations:
            taken.append(observation)
            yield observation

    last: Moment | None = None
    pending: Picture | None = None
    last_image = -math.inf
    for step in replay(remembered(), tracker, tally):
        observation = next(o for o in reversed(taken) if o.stamp == step.stamp)
        if step.stamp - last_image >= TIMELINE.image_period:
            image = picture(tracker.rig, observation, tracker.vision.camera_from_palm, step.T_world_palm)
            if image is not None:
                last_image, pending = step.stamp, image.packed()
        moment = Moment.of(step, observation, step.T_palm_object_vision).after(last, pending)
        if timeline.append(moment):
            last, pending = moment, None
            yield moment


class Curves(NamedTuple):
    """`Curves` are uncertainty, error and state over time."""

    times: Array  # (n,) ascending, since the page's origin [s]
    sigmas: Array  # (n,) of the position [mm], NaN where nothing is known
    errors: Array | None
    """(n,) of the object's middle [mm], NaN where the truth is not known; None where it never is."""
    states: Sequence[State]  # n states of the track
    slips: Sequence[tuple[float, float]] = ()  # begin and end of each time that the object slipped [s]


def curves(moments: Sequence[Moment], model: ObjectModel, truths: Truths) -> Curves:
    """Returns the curves of at most `max_plotted` of the moments, evenly chosen, the first and the last among them."""
    places = np.linspace(0, len(moments) - 1, min(len(moments), TIMELINE.max_plotted)).astype(int)
    shown = [moments[k] for k in places]
    begin = moments[0].stamp if moments else 0.0
    rows = [
        (k, moment.estimate.T_palm_object, true)
        for k, moment in enumerate(shown)
        if moment.estimate is not None and (true := truths.at(moment.stamp)) is not None
    ]
    errors = None
    if rows:
        known, Ts, Ts_true = (np.array(column) for column in zip(*rows, strict=True))
        errors = np.full(len(shown), np.nan)
        # The error of the middle in space is the same in every frame.
        errors[known] = 1e3 * pose_errors(model, Ts, Ts_true, np.broadcast_to(np.eye(4), Ts.shape)).middle
    slips = slips_of((moment.stamp, moment.slip) for moment in moments)
    return Curves(
        times=np.array([moment.stamp - begin for moment in shown]),
        sigmas=in_mm([moment.sigma for moment in shown]),
        errors=errors,
        states=[moment.state for moment in shown],
        slips=[(first - begin, last - begin) for first, last in slips],
    )


def in_mm(sigmas: Sequence[float]) -> Array:
    """Returns standard deviations (n,) in millimetres of those in metres; NaN for infinite ones."""
    return np.where(np.isfinite(sigmas), 1e3 * np.array(sigmas), np.nan)


def slips_of(slips: Iterable[tuple[float, Slip]]) -> list[tuple[float, float]]:
    """Returns the first and the last stamp of each time that the object slipped [s], from slips in order of stamp."""
    found: dict[float, float] = {}
    for stamp, slip in slips:
        if slip.slipping:
            found[slip.began] = stamp
    return list(found.items())
