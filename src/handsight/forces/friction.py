"""The coefficient of friction: what is declared is its prior, and the ratio of tangential to normal load teaches it.

The ratio vector of a contact, (f_t, τ / e) / f_n, lies within a ball of radius μ, and on its surface while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So μ is the highest ratio at which ratio vectors have
turned again and again without getting longer. A load that is constant, or grows along one line, does not show μ by
itself. Where μ is declared, a force that changes at a constant ratio counts as well, as in a straight slide: a contact
that sticks there will exceed that ratio sooner or later, and each turn weighs little beside what is declared.

Fingers may have different coefficients: then their declared ratio to each other is kept, and one factor is learnt.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from handsight.forces.kernels.slip import highest_heap
from handsight.forces.kernels.slip_records import BINS, FIRST, FRICTION


class Friction:
    """An estimate of μ from what was declared, and from all loads so far.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, declared: float | None = None, sigma: float | None = None) -> None:
        """Starts without any load; `declared` is μ with its standard deviation, None where it is unknown."""
        self.coefficient = declared  # μ; None before it was declared or there were enough turns
        self.sigma = sigma  # standard deviation of μ; None where μ is
        self._declared = None if declared is None or sigma is None else (declared, sigma)
        self._turns = np.zeros(BINS, dtype=np.int64)  # (BINS,) turns in each bin of the ratio's logarithm
        self._error = 0  # standard deviation of the ratios in bins
        self._heap: tuple[float, int] | None = None  # mean ratio of the highest heap, and its turns
        self._kept_up = 0.0  # the highest ratio that two fingers have kept up

    @property
    def declared(self) -> bool:
        """Whether a coefficient was declared."""
        return self._declared is not None

    @property
    def certain(self) -> bool:
        """Whether the coefficient is known well enough, from what was declared and the loads together."""
        return self.sigma is not None and self.sigma <= FRICTION.max_sigma * (self.coefficient or 0.0)

    def update(self, turns: Sequence[float], kept_up: float, error: float = 0.0) -> None:
        """Learns from ratios at which ratio vectors have turned.

        `kept_up`: the highest ratio that two fingers have kept up, or the only one that has touched. `error`: standard
        deviation of the ratios, as a share of them, by which a heap is wider.
        """
        before = self._error, self._kept_up
        self._error, self._kept_up = now = round(error / FRICTION.bin_width), kept_up
        if not turns and now == before:
            return
        if turns:
            self._turns = self._turns.copy()
            for ratio in turns:
                self._turns[round(math.log(ratio) / FRICTION.bin_width) - FIRST] += 1
            mean, total = highest_heap(self._turns, self._error)
            self._heap = (math.exp(FRICTION.bin_width * mean), total) if total else None
        estimates = [] if self._declared is None else [self._declared]
        learnt = math.inf
        if self._heap is None and not estimates:
            return
        heap, total = self._heap or (0.0, 0)
        # Turns below what was kept up, by more than the noise of both ratios, were those of contacts that stick.
        if heap > (1 - 2 * FRICTION.noise_of_slides) * kept_up:
            learnt = math.hypot(FRICTION.least_sigma, FRICTION.turn_sigma / math.sqrt(total))
            estimates.append((heap, learnt * heap))
        if not estimates:
            at_least = (1 - FRICTION.noise) * kept_up
            self.coefficient = at_least
            self.sigma = at_least  # how much more it is, is not known
            return
        mu, sigma = joined(estimates)
        # What was kept up bounds μ from below; but the noise of a long slide is kept up too.
        noise = FRICTION.noise if learnt > FRICTION.max_sigma else FRICTION.noise_of_slides
        self.coefficient = max(mu, (1 - noise) * kept_up)
        self.sigma = sigma * self.coefficient / mu


def joined(estimates: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Returns μ and its sigma from independent estimates with theirs, each a Gaussian of the logarithm of μ."""
    logs, weights = zip(*((math.log(mu), (mu / sigma) ** 2) for mu, sigma in estimates), strict=True)
    mu = math.exp(sum(m * w for m, w in zip(logs, weights, strict=True)) / sum(weights))
    return mu, mu / math.sqrt(sum(weights))
