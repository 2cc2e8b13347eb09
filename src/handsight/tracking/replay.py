"""A tracker's answers to a stream of observations, and a summary of them."""

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.tracking.tracker import State, Tracker


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
    """(4, 4) as vision measured it at this instant; None where it did not."""
    T_world_palm: Array | None
    """(4, 4)."""
    fingers: tuple[str, ...]
    """Those that touch."""
    sigma: float
    """Standard deviation of the position, its largest [m]."""


@dataclass(slots=True)
class Tally:
    """What a replay came to."""

    observations: int = 0
    answered: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """Observations that were wrong in themselves, by what was said of them."""
    states: dict[str, float] = field(default_factory=dict)
    """Seconds in each state."""
    recorded: float = 0.0
    """Seconds between the first observation and the last."""
    wall: float = 0.0
    """Seconds this took."""


def replay(observations: Iterable[Observation], tracker: Tracker, tally: Tally) -> Iterator[Step]:
    """The tracker's answers, one for each observation it can answer; `tally` is filled as they come.

    An observation that is wrong in itself is counted with what is wrong, and the next is taken.
    """
    began = time.perf_counter()
    first: float | None = None
    for observation in observations:
        tally.observations += 1
        first = observation.stamp if first is None else first
        before, tally.recorded = tally.recorded, max(tally.recorded, observation.stamp - first)
        try:
            estimate = tracker.update(observation)
        except InvalidInput as error:
            tally.refused[str(error)] += 1
            continue
        if tally.observations > 1:
            passed = tally.recorded - before
            tally.states[tracker.state] = tally.states.get(tracker.state, 0.0) + passed
        tally.wall = time.perf_counter() - began
        if estimate is None:
            continue
        tally.answered += 1
        yield Step(
            stamp=observation.stamp,
            estimate=estimate,
            state=tracker.state,
            reason=tracker.reason,
            T_palm_object_vision=tracker.vision.in_palm(observation, tracker.T_world_palm),
            T_world_palm=tracker.T_world_palm,
            fingers=tracker.fingertips.fingers,
            sigma=tracker.sigma,
        )
