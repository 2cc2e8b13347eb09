"""A tracker's answers to a stream of observations, with a summary of them, and the best weighing among them."""

import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.forces import ObjectWeight, Slip
from handsight.observation import Observation
from handsight.tracking.clock import MAX_JUMP
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.tracking.tracker import State, Tracker

MAX_MESSAGES = 100


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A `Step` is the answer to one observation."""

    stamp: float
    """[s]"""
    estimate: PoseEstimate
    state: State
    reason: str
    """Why the state is no better; empty while tracking."""
    T_palm_object_vision: Array | None
    """(4, 4) as vision measured it at this instant; None where it did not."""
    T_world_palm: Array | None
    """(4, 4)."""
    fingertips: FingertipContacts
    """What the fingertips measure."""
    sigma: float
    """Standard deviation of the position, its largest [m]."""
    slip: Slip = field(default_factory=Slip)
    """Whether the object slips, and how near to that it is."""
    skin: SkinContacts = NOTHING
    """What the tactile arrays measure."""

    @property
    def fingers(self) -> tuple[str, ...]:
        """The fingers that touch."""
        return self.fingertips.fingers

    @property
    def rejected(self) -> tuple[str, ...]:
        """Those of them whose contacts the answer takes for wrong."""
        return self.fingertips.rejected_by(self.estimate)


@dataclass(slots=True)
class Tally:
    """A `Tally` is the summary of a replay."""

    observations: int = 0
    answered: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """Observations that were wrong in themselves, by the message; at most `MAX_MESSAGES` different ones are counted."""
    states: dict[str, float] = field(default_factory=dict)
    """Seconds in each state."""
    recorded: float = 0.0
    """Seconds between the first observation and the last, in each track if the clock was set back."""
    wall: float = 0.0
    """Seconds that the replay took."""
    touched: set[str] = field(default_factory=set)
    """Fingers that have touched something."""
    without: dict[str, Counter[str]] = field(default_factory=dict)
    """By finger: observations before its first contact, if it has one, by the reason for having none."""


class Taken(NamedTuple):
    """A `Taken` is an observation that the tracker has taken."""

    stamp: float
    passed: float
    """Since the one before [s]."""
    state: State
    fingertips: FingertipContacts
    step: Step | None


def replay(observations: Iterable[Observation], tracker: Tracker, tally: Tally) -> Iterator[Step]:
    """Yields the tracker's answers, one for each observation it can answer; `tally` is filled as they come.

    An observation that is wrong in itself is counted by its message, and the next is taken. One that comes late has no
    answer, nor has one that jumps ahead and is taken back: after a jump an answer waits for the next observation.
    """
    began, counted_to, waiting = time.perf_counter(), math.nan, list[Taken]()
    for observation in observations:
        tally.observations += 1
        late, undone = tracker.late, tracker.undone
        try:
            estimate = tracker.update(observation)
        except InvalidInput as error:
            message = str(error)
            known = message in tally.refused or len(tally.refused) < MAX_MESSAGES
            tally.refused[message if known else "others"] += 1
            if not waiting:
                counted_to = _passed_over(observation, counted_to, tally)
            continue
        finally:
            tally.wall = time.perf_counter() - began
        del waiting[len(waiting) - (tracker.undone - undone) :]
        if tracker.late == late:
            passed = max(0.0, tracker.stamp - (waiting[-1].stamp if waiting else counted_to))
            step = None if estimate is None else _step(tracker, estimate)
            waiting.append(Taken(tracker.stamp, passed, tracker.state, tracker.fingertips, step))
        while len(waiting) > tracker.unconfirmed:
            counted_to = waiting[0].stamp
            yield from _counted(waiting.pop(0), tally)
    for taken in waiting:
        yield from _counted(taken, tally)


def _passed_over(observation: Observation, last: float, tally: Tally) -> float:
    """Returns the stamp up to which time is counted after a refused observation: its own, if it is plausible."""
    stamp = getattr(observation, "stamp", None)
    if not isinstance(stamp, float) or not math.isfinite(stamp) or stamp <= last or stamp - last > MAX_JUMP:
        return last
    tally.recorded += 0.0 if math.isnan(last) else stamp - last
    return stamp


def _step(tracker: Tracker, estimate: PoseEstimate) -> Step:
    return Step(
        stamp=tracker.stamp,
        estimate=estimate,
        state=tracker.state,
        reason=tracker.reason,
        T_palm_object_vision=tracker.vision.in_palm(tracker.processed, tracker.T_world_palm),
        T_world_palm=tracker.T_world_palm,
        fingertips=tracker.fingertips,
        sigma=tracker.sigma,
        slip=tracker.slip,
        skin=tracker.skin,
    )


def _counted(taken: Taken, tally: Tally) -> Iterator[Step]:
    """Yields the answer, if there is one, now that nothing can take it back, and counts the observation."""
    tally.recorded += taken.passed
    if taken.passed:
        tally.states[taken.state] = tally.states.get(taken.state, 0.0) + taken.passed
    tally.touched.update(taken.fingertips.fingers)
    for finger, why in taken.fingertips.reasons.items():
        if finger not in tally.touched:
            tally.without.setdefault(finger, Counter())[why] += 1
    if taken.step is not None:
        tally.answered += 1
        yield taken.step


def best_weight(observations: Iterable[Observation], tracker: Tracker) -> tuple[ObjectWeight | None, str]:
    """Returns the weighing whose centre of mass in the object is known best, or None and why no weighing is believed.

    The tracker's model must have no centre of mass: a known one would come out again as if it had been measured.
    """
    best: ObjectWeight | None = None
    reason = "the object was never in the air"
    for _ in replay(observations, tracker, Tally()):
        found = tracker.weight
        if found is None:
            continue
        if found.reason:
            reason = found.reason
        elif found.directions < 2:  # the centre's height along a single direction of gravity is open
            reason = "gravity had one direction in the palm all the time: tilt the hand by 20° about two axes"
        elif best is None or np.trace(found.covariance) < np.trace(best.covariance):
            best = found
    return best, "" if best is not None else reason
