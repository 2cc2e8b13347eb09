"""The coefficient of friction, declared or learnt: the highest ratio of tangential to normal load while sliding.

The ratio vector of a contact, (f_t, τ / e) / f_n, lies within a ball of radius μ, and on its surface while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So μ is the highest ratio at which ratio vectors have
turned again and again without getting longer. A load that is constant, or grows along one line, does not show μ by
itself, but does where other evidence, such as vision, tells that the contact slides. Fingers that slide while they
close show μ within half a second.

Fingers may have different coefficients: then their declared ratio to each other is kept, and one factor is learnt.
"""

import math
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
    max_below: int = 30
    max_below_alone: int = 50
    """The same of a heap above the ratios that two fingers keep up: one tip alone may touch two bodies at once."""
    certain_turns: int = 20
    """A heap of so many turns is the limit, unless two fingers have ratios above it by more than `near_heap`."""
    noise_margin: float = 0.98
    """μ is at least this share of the ratio that two fingers have kept up, with its noise."""
    keep_up: float = 0.1
    """Time constant with which a kept-up ratio rises [s]: a tip that is hit, or touches at two places for a moment, has
    higher ratios than μ, but not for long."""
    near_heap: float = 1.1  # a factor
    max_above: float = 1.5  # the largest factor by which μ is above the heap
    sliding_turns: int = 5
    """As many turns as this count for a contact of which other evidence tells that it slides."""
    least_sigma: float = 0.02  # of the logarithm of μ: the limit surface is not quite an ellipsoid
    turn_sigma: float = 0.2  # the same of one turn; it falls with the root of their number
    doubtful_sigma: float = 0.3
    """The same while turns are fewer than `certain_turns`, or kept-up ratios are above them."""


FRICTION = FrictionOptions()
FIRST = round(math.log(FRICTION.min_ratio) / FRICTION.bin_width)
BINS = round(math.log(FRICTION.max_ratio) / FRICTION.bin_width) - FIRST + 1
"""Number of the first bin, and how many there are."""

Vector = tuple[float, float, float, float]
"""A ratio vector: tangential force (3) and torque / e, both divided by the normal force."""


class Friction:
    """A `Friction` is an estimate of μ from what was declared, and from all loads so far. `update` binds its attributes
    anew and changes none in place, so that a shallow copy evolves apart from it."""

    def __init__(self, declared: float | None = None, sigma: float | None = None) -> None:
        """Starts without any load; `declared` is μ with its standard deviation, None where it is unknown."""
        self.coefficient = declared  # μ; None before it was declared or there were enough turns
        self.sigma = sigma  # standard deviation of μ; None where μ is
        self._declared = None if declared is None or sigma is None else (declared, sigma)
        self._anchors: Mapping[str, Vector] = {}
        """By finger, the ratio vector from which the next turn is measured."""
        self._turns = np.zeros(BINS, dtype=np.int64)
        """(BINS,) number of turns in each bin of the logarithm of the ratio."""
        self._error = 0  # standard deviation of the ratios in bins
        self._heap: tuple[float, int] | None = None
        """Mean ratio of the highest heap, and its turns; None before there was one."""
        self._kept_up: Mapping[str, float] = {}  # by finger, the highest ratio that it has kept up

    def update(
        self, vectors: Mapping[str, Vector], since: float, sliding: Collection[str] = (), error: float = 0.0
    ) -> None:
        """Learns from the current ratio vectors, by finger; a finger without one starts anew next time.

        `since` is the time since the last update [s]. `sliding` are fingers of which other evidence tells that they
        slide along the object. `error`: standard deviation of the ratios, as a share of them, by which a heap is wider.
        """
        self._error = round(error / FRICTION.bin_width)
        load = {name: math.hypot(*vector) for name, vector in vectors.items()}
        rise = 1 - math.exp(-min(since, FRICTION.keep_up) / FRICTION.keep_up)
        kept = {name: self._kept_up.get(name, 0.0) for name in load}
        risen = {name: was + rise * (load[name] - was) for name, was in kept.items() if load[name] > was}
        if risen:
            self._kept_up = {**self._kept_up, **risen}
        before, moved = self._anchors, dict[str, Vector]()
        for name, now in vectors.items():
            anchor = before.get(name)
            if anchor is None or math.dist(now, anchor) > FRICTION.min_turn * math.hypot(*anchor):
                moved[name] = now
        if moved or len(before) > len(vectors):
            self._anchors = {name: moved.get(name) or before[name] for name in vectors}
        counted = list[tuple[float, int]]()
        for name, now in moved.items():
            anchor = before.get(name, now)
            least, most = sorted([math.hypot(*anchor), load[name]])
            inside = least >= FRICTION.min_ratio and most <= FRICTION.max_ratio
            # A motion that hardly changed the length was a turn.
            if name in before and inside and most - least <= FRICTION.max_radial * math.dist(now, anchor):
                counted.append((math.sqrt(least * most), 1))
        for name in sliding:
            if FRICTION.min_ratio < load.get(name, 0.0) < FRICTION.max_ratio:
                counted.append((load[name], FRICTION.sliding_turns))
        if counted:
            self._count(counted)
        if risen or moved or sliding:
            self._estimate()

    @property
    def _kept_by_two(self) -> float:
        """The highest ratio that two fingers have kept up, or the only finger that holds the object; else 0."""
        return sorted(self._kept_up.values())[-2:][0] if self._kept_up else 0.0

    def _estimate(self) -> None:
        """Joins what was declared, the heap, and the ratios that were kept up, which bound μ from below."""
        kept = FRICTION.noise_margin * self._kept_by_two
        estimates = [] if self._declared is None else [self._declared]
        if self._heap is not None:
            heap, turns = self._heap
            sigma = math.hypot(FRICTION.least_sigma, FRICTION.turn_sigma / math.sqrt(turns))
            if turns < FRICTION.certain_turns or kept > FRICTION.near_heap * heap:
                sigma = FRICTION.doubtful_sigma
                heap = min(max(heap, kept), FRICTION.max_above * heap)
            estimates.append((heap, sigma * heap))
        if estimates:
            mu, sigma = joined(estimates)
            self.coefficient = mu if self._declared is None else max(mu, kept)
            self.sigma = sigma * self.coefficient / mu

    def _count(self, counted: Iterable[tuple[float, int]]) -> None:
        """Counts turns, each at its ratio."""
        self._turns = self._turns.copy()
        for ratio, turns in counted:
            self._turns[round(math.log(ratio) / FRICTION.bin_width) - FIRST] += turns
        self._heap = _highest_heap(self._turns, FRICTION.near_heap * self._kept_by_two, self._error)


def joined(estimates: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Returns μ and its sigma from independent estimates with theirs, each a Gaussian of the logarithm of μ."""
    logs, weights = zip(*((math.log(mu), (mu / sigma) ** 2) for mu, sigma in estimates), strict=True)
    mu = math.exp(sum(m * w for m, w in zip(logs, weights, strict=True)) / sum(weights))
    return mu, mu / math.sqrt(sum(weights))


def _highest_heap(turns: NDArray[np.int64], shared: float, error: int) -> tuple[float, int] | None:
    """Returns the mean ratio of the highest heap, with the bins just below it, and its turns; None without a heap.

    `turns` (BINS,); `shared` is the ratio up to which two fingers have kept one up, `error` the standard deviation of
    ratios in bins. A few turns that are spread over higher ratios, as by a tip that touches at two places, are not the
    limit.
    """
    band, spread = FRICTION.band + 2 * error, FRICTION.spread + error
    shared_bin = math.log(shared) / FRICTION.bin_width - FIRST if shared > 0 else -math.inf
    through = np.concatenate([[0], np.cumsum(turns)])
    occupied = np.flatnonzero(turns)
    heaps = np.zeros(BINS, dtype=np.int64)
    heaps[occupied] = through[np.minimum(occupied + band, BINS)] - through[occupied]
    for at in occupied[::-1].tolist():
        below = FRICTION.max_below if at <= shared_bin else FRICTION.max_below_alone
        near = heaps[max(at - below, 0) : at + 1].max()
        if heaps[at] >= max(FRICTION.min_turns, FRICTION.min_share * near):
            first = max(at - spread, 0)
            heap = turns[first : at + band]
            total = int(heap.sum())
            mean = FIRST + first + float(np.arange(len(heap)) @ heap) / total
            return math.exp(FRICTION.bin_width * mean), total
    return None
