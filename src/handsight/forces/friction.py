"""How much friction holds, learnt from below: the highest ratio of sideways to normal load that loads have gone along.

The ratio vector of a contact, (f_t, τ / e) / f_n, is free within a ball of radius μ and kept on it while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So friction is the highest ratio at which ratio
vectors have turned again and again without getting longer. A load that rests, or grows along one line, says nothing;
fingers that slide as they close say it within half a second.
"""

import math
from collections.abc import Mapping

PATCH = 0.005
"""Torque about the normal that a tip holds, in parts of the force that it holds sideways [m]."""
STEP, ALONG = 0.05, 0.3
"""A ratio vector has turned where it has moved by this share of its length, and its length by this share of that at
most."""
LEAST, MOST = 0.05, 10.0
"""Ratios that are counted."""
BIN, BAND, BELOW = 0.01, 5, 2
"""Turns are counted by the logarithm of the ratio in bins so wide. So many side by side make a heap; noise spreads one
limit by so many to either side."""
ENOUGH, SHARE, NEAR = 5, 0.1, 20
"""Turns in a heap at least, and in parts of the largest heap's that is at most so many bins below it."""
CERTAIN, NOISE, NEAR_HEAP, ABOVE = 20, 0.98, 1.1, 1.5
"""Friction is at least so much of the highest ratio that two fingers have felt, noise and all, as far as that is above
the heap by the last factor at most. A heap of so many turns, with that within the third factor of it, counts alone."""

Vector = tuple[float, float, float, float]


class Friction:
    """What is known of it; the parts are bound anew, never changed in place."""

    def __init__(self) -> None:
        """Nothing at first."""
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
            load_of_two = NOISE * sorted((0.0, 0.0, *self._highest.values()))[-2] / self._heap
            agree = self._certain and load_of_two < NEAR_HEAP
            self.coefficient = self._heap * (1.0 if agree else min(max(load_of_two, 1.0), ABOVE))

    def _turned(self, before: Vector, now: Vector) -> None:
        """Counts a move that was a turn."""
        length, was = math.hypot(*now), math.hypot(*before)
        if min(length, was) < LEAST or max(length, was) > MOST:
            return
        if abs(length - was) > ALONG * math.dist(now, before):
            return
        at = round(math.log(length * was) / 2 / BIN)
        self._turns = {**self._turns, at: self._turns.get(at, 0) + 1}
        self._heap, turns = _highest_heap(self._turns)
        self._certain = turns >= CERTAIN


def _has_moved(before: Vector, now: Vector) -> bool:
    return math.dist(now, before) > STEP * math.hypot(*before)


def _highest_heap(turns: Mapping[int, int]) -> tuple[float | None, int]:
    """The mean ratio of the highest heap and of what is just below it, and its turns; None where there is none.

    What is spread above it, as by a tip that touches at two places, is no limit.
    """
    counts = {at: sum(turns.get(at + k, 0) for k in range(BAND)) for at in turns}
    for at in sorted(counts, reverse=True):
        near = max(count for other, count in counts.items() if at - NEAR <= other <= at)
        if counts[at] >= max(ENOUGH, SHARE * near):
            heap = [(at + k, turns.get(at + k, 0)) for k in range(-BELOW, BAND)]
            total = sum(count for _, count in heap)
            return math.exp(BIN * sum(k * count for k, count in heap) / total), total
    return None, 0
