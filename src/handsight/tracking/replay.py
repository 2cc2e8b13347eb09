"""A stream of observations through a tracker, with what a person wants to know of it afterwards."""

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.observation import Observation
from handsight.tracking import State, Tracker

TRUTH_APART = 0.05
"""A truth farther from an observation than this is not its truth [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The answer to one observation."""

    stamp: float
    """[s]"""
    estimate: PoseEstimate
    state: State
    reason: str
    """Why the state is no better; empty while tracking."""
    T_palm_seen: Array | None
    """(4, 4) where vision saw the object at this instant; None where it saw nothing."""
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
    first: float | None = None
    last: float | None = None
    """Stamps [s]."""
    wall: float = 0.0
    """Seconds this took."""

    @property
    def recorded(self) -> float:
        """Seconds between the first observation and the last."""
        return 0.0 if self.first is None or self.last is None else self.last - self.first


def replay(observations: Iterable[Observation], tracker: Tracker, tally: Tally) -> Iterator[Step]:
    """The tracker's answers, one for each observation it can answer; `tally` is filled as they come.

    An observation that is wrong in itself is counted with what is wrong, and the next is taken.
    """
    began = time.perf_counter()
    for seen in observations:
        before = tally.last
        tally.observations += 1
        tally.first = seen.stamp if tally.first is None else tally.first
        tally.last = seen.stamp if before is None else max(before, seen.stamp)
        try:
            estimate = tracker.update(seen)
        except InvalidInput as error:
            tally.refused[str(error)] += 1
            continue
        if before is not None:
            tally.states[tracker.state] = tally.states.get(tracker.state, 0.0) + tally.last - before
        tally.wall = time.perf_counter() - began
        if estimate is None:
            continue
        tally.answered += 1
        yield Step(
            stamp=seen.stamp,
            estimate=estimate,
            state=tracker.state,
            reason=tracker.reason,
            T_palm_seen=tracker.sight.in_palm(seen, tracker.T_world_palm),
            T_world_palm=tracker.T_world_palm,
            fingers=tracker.touch.fingers,
            sigma=tracker.sigma,
        )


@dataclass(frozen=True, slots=True)
class Errors:
    """How far poses were from the truth, modulo the object's symmetries."""

    base: Array
    """(n,) of the centre of the base, in the table's plane, as the paper measures it [m]; in the palm's x and y where
    the palm's pose in the world is not known."""
    middle: Array
    """(n,) of the object's middle, in space [m]."""
    rotation: Array
    """(n,) [rad]"""

    def __len__(self) -> int:
        return len(self.base)


def errors_of(model: ObjectModel, Ts: Array, Ts_true: Array, Ts_world_palm: Array) -> Array:
    """(n, 3) errors of poses in the palm (n, 4, 4): of the base's centre in the table's plane [m], of the middle [m],
    of the rotation [rad]."""
    true = nearest(model.symmetries, Ts_true, Ts, model.radius)
    bases = base_center(model, Ts_world_palm @ Ts_true)[:, None]
    base = (se3.apply(Ts_world_palm @ Ts, bases) - se3.apply(Ts_world_palm @ true, bases))[:, 0, :2]
    middle = se3.apply(Ts, model.center_object[None]) - se3.apply(true, model.center_object[None])
    turn = se3.rotation_log(Ts[:, :3, :3] @ true[:, :3, :3].swapaxes(1, 2))
    return np.stack([np.linalg.norm(part, axis=1) for part in (base, middle[:, 0], turn)], axis=1)


def base_center(model: ObjectModel, T_world_object: Array) -> Array:
    """(..., 3) in the object's frame [m]: the middle of the side of its bounding box that faces down in the world."""
    low, high = model.bounds_object
    down = -T_world_object[..., 2, :3]
    axis = np.argmax(np.abs(down), axis=-1)[..., None]
    lowest = np.where(down > 0, high, low)
    center = np.broadcast_to((low + high) / 2, down.shape).copy()
    np.put_along_axis(center, axis, np.take_along_axis(lowest, axis, axis=-1), axis=-1)
    return center


class Truths:
    """True poses in the palm by stamp, as they come."""

    def __init__(self, stamped: Iterable[tuple[float, Array]]) -> None:
        """`stamped`: (stamp [s], T_palm_object (4, 4)), in any order."""
        rows = sorted(stamped, key=lambda row: row[0])
        self._stamps = np.array([stamp for stamp, _ in rows])
        self._poses = [T for _, T in rows]

    def __len__(self) -> int:
        return len(self._poses)

    def at(self, stamp: float) -> Array | None:
        """The truth nearest in time; None where there is none near enough."""
        if not self._poses:
            return None
        i = int(np.searchsorted(self._stamps, stamp))
        near = min(
            (k for k in (i - 1, i) if 0 <= k < len(self._poses)), key=lambda k: abs(self._stamps[k] - stamp)
        )
        return self._poses[near] if abs(self._stamps[near] - stamp) <= TRUTH_APART else None


def errors(model: ObjectModel, steps: Iterable[Step], truths: Truths, *, vision: bool) -> Errors:
    """Errors of the estimates, or of what vision saw, at the steps whose truth is known."""
    rows = []
    for step in steps:
        T, true = step.T_palm_seen if vision else step.estimate.T_palm_object, truths.at(step.stamp)
        if T is not None and true is not None:
            rows.append((T, true, np.eye(4) if step.T_world_palm is None else step.T_world_palm))
    if not rows:
        return Errors(np.empty(0), np.empty(0), np.empty(0))
    table = errors_of(model, *(np.array(column) for column in zip(*rows, strict=True)))
    return Errors(table[:, 0], table[:, 1], table[:, 2])
