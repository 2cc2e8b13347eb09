"""The coefficient of friction, learnt from below: the highest ratio of tangential to normal load while sliding.

The ratio vector of a contact, (f_t, τ / e) / f_n, lies within a ball of radius μ, and on its surface while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So μ is the highest ratio at which ratio vectors have
turned again and again without getting longer. A load that is constant, or grows along one line, does not show μ;
fingers that slide while they close show it within half a second.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple


class FrictionOptions(NamedTuple):
    """`FrictionOptions` say how a friction coefficient is learnt from turns of the ratio vectors."""

    torsion: float = 0.005
    """e, the largest torque about the normal that a tip can bear, relative to the largest tangential force [m]."""
    min_turn: float = 0.05  # a ratio vector has turned once it has moved by this share of its length
    max_radial: float = 0.3  # and its length has changed by at most this share of that motion
    min_ratio: float = 0.05  # smallest ratio that is counted
    max_ratio: float = 10.0  # largest ratio that is counted
    bin_width: float = 0.01  # width of the bins, in the logarithm of the ratio, in which turns are counted
    band: int = 5  # so many neighbouring bins make a heap
    spread: int = 2  # bins below a heap over which noise spreads the limit
    min_turns: int = 5  # fewest turns of a heap
    min_share: float = 0.1
    """The same as a share of the turns in the largest heap that is at most `max_below` bins below."""
    max_below: int = 20
    certain_turns: int = 20
    """A heap of so many turns is the limit, unless two fingers have ratios above it by more than `near_heap`."""
    noise_margin: float = 0.98
    """Otherwise μ is at least this share of the highest ratio that two fingers have measured, with its noise."""
    near_heap: float = 1.1  # a factor
    max_above: float = 1.5  # the largest factor by which μ is above the heap


FRICTION = FrictionOptions()


Vector = tuple[float, float, float, float]
"""A ratio vector: tangential force (3) and torque / e, both divided by the normal force."""


class Friction:
    """A `Friction` is an estimate of μ from all loads so far.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self) -> None:
        """Starts without any load."""
        self.coefficient: float | None = None
        """μ; None before there were enough turns."""
        self._anchors: Mapping[str, Vector] = {}
        """By finger, the ratio vector from which the next turn is measured."""
        self._turns: Mapping[int, int] = {}
        """By bin, the number of turns."""
        self._heap: float | None = None
        """Mean ratio of the highest heap; None before there was one."""
        self._certain = False
        """Whether that heap has enough turns to be the limit."""
        self._highest: Mapping[str, float] = {}
        """By finger, its highest ratio."""

    def update(self, vectors: Mapping[str, Vector]) -> None:
        """Learns from the current ratio vectors, by finger; a finger without one starts anew next time."""
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
    """Returns the mean ratio of the highest heap, with the bins just below it, and its turns; None without a heap.

    A few turns that are spread over higher ratios, as by a tip that touches at two places, are not the limit.
    """
    counts = {at: sum(turns.get(at + k, 0) for k in range(FRICTION.band)) for at in turns}
    for at in sorted(counts, reverse=True):
        near = max(count for other, count in counts.items() if at - FRICTION.max_below <= other <= at)
        if counts[at] >= max(FRICTION.min_turns, FRICTION.min_share * near):
            heap = [(at + k, turns.get(at + k, 0)) for k in range(-FRICTION.spread, FRICTION.band)]
            total = sum(count for _, count in heap)
            return math.exp(FRICTION.bin_width * sum(k * count for k, count in heap) / total), total
    return None, 0
