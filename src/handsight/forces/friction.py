"""The coefficient of friction, learnt from below: the highest ratio of sideways to normal load along which loads move.

The ratio vector of a contact, (f_t, τ / e) / f_n, is free within a ball of radius μ and stays on it while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So μ is the highest ratio at which ratio vectors have
turned again and again without getting longer. A load that rests, or grows along one line, says nothing; fingers that
slide as they close say it within half a second.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple


class FrictionOptions(NamedTuple):
    """`FrictionOptions` say how a friction coefficient is learnt from the turns of the ratio of tangential to normal
    force."""

    torsion: float = 0.005
    """e, the largest torque about the normal that a tip holds, as a part of the largest tangential force [m]."""
    min_turn: float = 0.05  # a ratio vector has turned where it has moved by this share of its length
    max_radial: float = 0.3  # and its length has changed by at most this share of that motion
    min_ratio: float = 0.05  # smallest ratio that is counted
    max_ratio: float = 10.0  # largest ratio that is counted
    bin_width: float = 0.01  # turns are counted by the logarithm of the ratio in bins this wide
    band: int = 5  # neighbouring bins that make a heap
    spread: int = 2  # bins below a heap into which noise spreads its limit
    min_turns: int = 5  # turns in a heap at least
    min_share: float = (
        0.1  # the same, as a part of the turns in the largest heap up to `max_below` bins below
    )
    max_below: int = 20
    certain_turns: int = 20
    """A heap of so many turns is the limit, if no ratio of two fingers is above it by more than `near_heap`."""
    noise_margin: float = 0.98
    """Else μ is at least this share of the highest ratio that two fingers have measured, noise and all."""
    near_heap: float = 1.1  # a factor
    max_above: float = 1.5  # the largest factor by which μ is above the heap


FRICTION = FrictionOptions()


Vector = tuple[float, float, float, float]


class Friction:
    """A `Friction` is an estimate of μ from all loads so far; `update` binds its attributes anew."""

    def __init__(self) -> None:
        """Starts without any load."""
        self.coefficient: float | None = None
        """μ; None before there were enough turns."""
        self._anchors: Mapping[str, Vector] = {}
        """By finger, the ratio vector from which the next turn is measured."""
        self._turns: Mapping[int, int] = {}
        """By bin."""
        self._heap: float | None = None
        """The ratio at which vectors have turned."""
        self._certain = False
        self._highest: Mapping[str, float] = {}
        """By finger, its highest ratio."""

    def update(self, vectors: Mapping[str, Vector]) -> None:
        """Learns from the current ratio vectors, by finger; a finger that is not among them starts anew next time."""
        load = {name: math.hypot(*vector) for name, vector in vectors.items()}
        higher = {name: ratio for name, ratio in load.items() if ratio > self._highest.get(name, 0.0)}
        if higher:
            self._highest = {**self._highest, **higher}
        before = self._anchors
        moved = {
            name: vector
            for name, vector in vectors.items()
            if name not in before
            or math.dist(vector, before[name]) > FRICTION.min_turn * math.hypot(*before[name])
        }
        if moved or len(before) > len(vectors):
            self._anchors = {name: moved.get(name) or before[name] for name in vectors}
        for name, vector in moved.items():
            if name in before:
                self._turned(before[name], vector)
        if self._heap is not None:
            load_of_two = FRICTION.noise_margin * sorted((0.0, 0.0, *self._highest.values()))[-2] / self._heap
            agree = self._certain and load_of_two < FRICTION.near_heap
            self.coefficient = self._heap * (1.0 if agree else min(max(load_of_two, 1.0), FRICTION.max_above))

    def _turned(self, before: Vector, now: Vector) -> None:
        """Counts a motion of a ratio vector if it was a turn."""
        length, was = math.hypot(*now), math.hypot(*before)
        if min(length, was) < FRICTION.min_ratio or max(length, was) > FRICTION.max_ratio:
            return
        if abs(length - was) > FRICTION.max_radial * math.dist(now, before):
            return
        at = round(math.log(length * was) / 2 / FRICTION.bin_width)
        self._turns = {**self._turns, at: self._turns.get(at, 0) + 1}
        self._heap, turns = _highest_heap(self._turns)
        self._certain = turns >= FRICTION.certain_turns


def _highest_heap(turns: Mapping[int, int]) -> tuple[float | None, int]:
    """Returns the mean ratio of the highest heap with the bins just below it, and its turns; None where there is none.

    Turns that are spread above a heap, as by a tip that touches at two places, are at no limit.
    """
    counts = {at: sum(turns.get(at + k, 0) for k in range(FRICTION.band)) for at in turns}
    for at in sorted(counts, reverse=True):
        near = max(count for other, count in counts.items() if at - FRICTION.max_below <= other <= at)
        if counts[at] >= max(FRICTION.min_turns, FRICTION.min_share * near):
            heap = [(at + k, turns.get(at + k, 0)) for k in range(-FRICTION.spread, FRICTION.band)]
            total = sum(count for _, count in heap)
            return math.exp(FRICTION.bin_width * sum(k * count for k, count in heap) / total), total
    return None, 0
