"""How much friction holds, learnt from below: the highest ratio of sideways to normal load that loads have gone along.

The ratio vector of a contact, (f_t, τ / e) / f_n, is free within a ball of radius μ and kept on it while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So friction is the highest ratio at which ratio
vectors have turned again and again without getting longer. A load that rests, or grows along one line, says nothing;
fingers that slide as they close say it within half a second.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple


class FrictionOptions(NamedTuple):
    """`FrictionOptions` say how a friction coefficient is learnt from the turns of the ratio of tangential to normal
    force."""

    torsion: float = 0.005
    """Torque about the normal that a tip holds, in parts of the force that it holds sideways [m]."""
    min_turn: float = 0.05  # a ratio vector has turned where it has moved by this share of its length
    max_radial: float = 0.3  # and its length has changed by at most this share of that
    min_ratio: float = 0.05  # smallest ratio that is counted
    max_ratio: float = 10.0  # largest ratio that is counted
    bin_width: float = 0.01  # turns are counted by the logarithm of the ratio in bins this wide
    band: int = 5  # bins side by side that make a heap
    spread: int = 2  # bins to either side into which noise spreads one limit
    min_turns: int = 5  # turns in a heap at least
    min_share: float = 0.1  # and in parts of the largest heap's
    max_below: int = 20  # that is at most so many bins above it
    certain_turns: int = 20
    """Turns of a heap that counts alone, if the highest ratio is within `max_above` of it."""
    noise_margin: float = 0.98
    """Friction is at least this share of the highest ratio that two fingers have measured, noise and all."""
    near_heap: float = 1.1  # as far as that is above the heap by this factor at most
    max_above: float = 1.5  # the factor above a certain heap within which the highest ratio is


FRICTION = FrictionOptions()


Vector = tuple[float, float, float, float]


class Friction:
    """A `Friction` is what is known of it; the parts are bound anew, never changed in place."""

    def __init__(self) -> None:
        """Starts with nothing learnt at first."""
        self.coefficient: float | None = None
        """μ; None as long as too little was felt."""
        self._anchors: Mapping[str, Vector] = {}
        self._turns: Mapping[int, int] = {}
        """By bin."""
        self._heap: float | None = None
        self._certain = False
        self._highest: Mapping[str, float] = {}
        """By finger."""

    def update(self, vectors: Mapping[str, Vector]) -> None:
        """Takes note of the ratio vectors by finger; a finger that is not among them begins elsewhere next time."""
        load = {name: math.hypot(*vector) for name, vector in vectors.items()}
        if any(ratio > self._highest.get(name, 0.0) for name, ratio in load.items()):
            self._highest = {
                **self._highest,
                **{n: r for n, r in load.items() if r > self._highest.get(n, 0.0)},
            }
        before = self._anchors
        moved = {name: v for name, v in vectors.items() if name not in before or _has_moved(before[name], v)}
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
        """Counts a move that was a turn."""
        length, was = math.hypot(*now), math.hypot(*before)
        if min(length, was) < FRICTION.min_ratio or max(length, was) > FRICTION.max_ratio:
            return
        if abs(length - was) > FRICTION.max_radial * math.dist(now, before):
            return
        at = round(math.log(length * was) / 2 / FRICTION.bin_width)
        self._turns = {**self._turns, at: self._turns.get(at, 0) + 1}
        self._heap, turns = _highest_heap(self._turns)
        self._certain = turns >= FRICTION.certain_turns


def _has_moved(before: Vector, now: Vector) -> bool:
    return math.dist(now, before) > FRICTION.min_turn * math.hypot(*before)


def _highest_heap(turns: Mapping[int, int]) -> tuple[float | None, int]:
    """Returns the mean ratio of the highest heap and of what is just below it, and its turns; None where there is none.

    What is spread above it, as by a tip that touches at two places, is no limit.
    """
    counts = {at: sum(turns.get(at + k, 0) for k in range(FRICTION.band)) for at in turns}
    for at in sorted(counts, reverse=True):
        near = max(count for other, count in counts.items() if at - FRICTION.max_below <= other <= at)
        if counts[at] >= max(FRICTION.min_turns, FRICTION.min_share * near):
            heap = [(at + k, turns.get(at + k, 0)) for k in range(-FRICTION.spread, FRICTION.band)]
            total = sum(count for _, count in heap)
            return math.exp(FRICTION.bin_width * sum(k * count for k, count in heap) / total), total
    return None, 0
