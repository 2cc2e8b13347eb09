"""A tracker's answers to a stream of observations, their summary, and the best weighing among them."""

import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.forces import ObjectWeight, Slip
from handsight.observation import MAX_JUMP, Observation
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.skin import SkinContacts
from handsight.tracking.tracker import State, Tracker

MAX_MESSAGES = 100


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The answer to one observation."""

    stamp: float
    """[s]"""
    estimate: PoseEstimate
    state: State
    reason: str
    """Why the state is no better; empty while tracking."""
    T_palm_object_vision: Array | None
    """(4, 4) the object's pose as vision measured it at this instant; None where it did not."""
    T_world_palm: Array | None
    """(4, 4) the palm's pose; None where it is unknown."""
    fingers: tuple[str, ...]
    """The fingers that touch."""
    rejected: tuple[str, ...]
    """Those of them whose contacts are outliers of the estimate."""
    sigma: float
    """Largest standard deviation of the position of the object's middle [m]."""
    slip: Slip = field(default_factory=Slip)
    """Whether the object slips, and how near each finger is to slipping."""
    pressed: bool = False
    """Whether a tactile array is pressed."""
    fingertips: FingertipContacts | None = None
    """What the fingertips measure; None in a `summary`."""
    skin: SkinContacts | None = None
    """What tactile arrays measure; None in a `summary`."""

    def summary(self) -> "Step":
        """Returns the step without its contacts, which are nine tenths of its memory."""
        return replace(self, fingertips=None, skin=None)


@dataclass(slots=True)
class Tally:
    """The summary of a replay."""

    observations: int = 0
    answered: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """By error message, the number of invalid observations; messages beyond `MAX_MESSAGES` are counted as others."""
    states: dict[str, float] = field(default_factory=dict)
    """Seconds in each state; `search`: before there is a pose."""
    recorded: float = 0.0
    """Seconds between the first observation and the last; summed over tracks if the clock was set back."""
    wall: float = 0.0
    """Seconds that the replay took."""
    touched: set[str] = field(default_factory=set)
    """Fingers that have touched something."""
    without: dict[str, Counter[str]] = field(default_factory=dict)
    """By finger, then by reason: observations without a contact of that finger, up to its first contact."""
    grasps: int = 0
    """How often the object was grasped."""
    grasped_at: float = -math.inf
    """When it was grasped last [s]."""
    counted_to: float = math.nan
    """The stamp up to which time is counted [s]."""


def replay(observations: Iterable[Observation], tracker: Tracker, tally: Tally) -> Iterator[Step]:
    """Yields the tracker's answers, one for each observation that has one; `tally` is filled as they come.

    With the tally and the tracker of an earlier replay, it goes on with the observations that follow.

    An invalid observation is counted by its error message, and the replay goes on with the next one. An observation
    that is late, or held back because its stamp jumped, has no answer.
    """
    began = time.perf_counter() - tally.wall
    for observation in observations:
        tally.observations += 1
        try:
            estimate = tracker.update(observation)
        except InvalidInput as error:
            message = str(error)
            known = message in tally.refused or len(tally.refused) < MAX_MESSAGES
            tally.refused[message if known else "others"] += 1
            stamp = getattr(observation, "stamp", None)
            last = tally.counted_to
            if isinstance(stamp, float) and (0 < stamp - last <= MAX_JUMP or math.isnan(last)):
                _count(tally, stamp)
            continue
        finally:
            tally.wall = time.perf_counter() - began
        if tracker.stamp != observation.stamp:
            continue
        passed = _count(tally, tracker.stamp)
        if passed:
            state = "search" if estimate is None and not tally.answered else tracker.state
            tally.states[state] = tally.states.get(state, 0.0) + passed
        tally.touched.update(tracker.fingertips.fingers)
        grasp = tracker.track_state.belief.grasp
        if grasp.grasped and grasp.since != tally.grasped_at:
            tally.grasps += 1
            tally.grasped_at = grasp.since
        for finger, reason in tracker.fingertips.reasons.items():
            if finger not in tally.touched:
                tally.without.setdefault(finger, Counter())[reason] += 1
        if estimate is not None:
            tally.answered += 1
            yield _step(tracker, estimate)


def _count(tally: Tally, stamp: float) -> float:
    """Adds the time up to a stamp [s] to a tally, and returns it [s]; 0 for the first one, or if a clock went back."""
    passed = 0.0 if math.isnan(tally.counted_to) else max(0.0, stamp - tally.counted_to)
    tally.recorded += passed
    tally.counted_to = stamp
    return passed


def _step(tracker: Tracker, estimate: PoseEstimate) -> Step:
    return Step(
        stamp=tracker.stamp,
        estimate=estimate,
        state=tracker.state,
        reason=tracker.reason,
        T_palm_object_vision=tracker.vision.in_palm(tracker.processed, tracker.T_world_palm),
        T_world_palm=tracker.T_world_palm,
        fingers=tracker.fingertips.fingers,
        rejected=tracker.fingertips.rejected_by(estimate),
        sigma=tracker.sigma,
        slip=tracker.slip,
        pressed=tracker.skin.pressed,
        fingertips=tracker.fingertips,
        skin=tracker.skin,
    )


def best_weight(observations: Iterable[Observation], tracker: Tracker) -> tuple[ObjectWeight | None, str]:
    """Returns the weighing that measures the centre of mass in the object best, and an empty reason.

    Where gravity had one direction only, returns the weighing that measures the mass best, and why its centre of mass
    is not measured; where no weighing can be trusted, None and the reason. The tracker's model must have no centre of
    mass: a known one corrects the pose, and would come out again as if it had been measured.
    """
    best: ObjectWeight | None = None
    surest: ObjectWeight | None = None
    reason = "the object was never in the air"
    for _ in replay(observations, tracker, Tally()):
        found = tracker.weight
        if found is None:
            continue
        if found.reason:
            reason = found.reason
            continue
        if surest is None or found.sigma_mass < surest.sigma_mass:
            surest = found
        measures_center = (
            found.directions >= 2
        )  # along a single one, loads do not measure the centre's height
        if measures_center and (best is None or np.trace(found.covariance) < np.trace(best.covariance)):
            best = found
    if best is not None:
        return best, ""
    if surest is not None:
        reason = "gravity had one direction in the palm all the time: tilt the hand by 20° about two axes"
    return surest, reason
