"""The coefficient of friction, declared or learnt: the highest ratio of tangential to normal load while sliding.

The ratio vector of a contact, (f_t, τ / e) / f_n, lies within a ball of radius μ, and on its surface while the contact
slips (Howe and Cutkosky 1996: the limit surface as an ellipsoid). So μ is the highest ratio at which ratio vectors have
turned again and again without getting longer. A load that is constant, or grows along one line, does not show μ by
itself, but does where other evidence, such as vision, tells that the contact slides. Fingers that slide while they
close show μ within half a second.

Fingers may have different coefficients: then their declared ratio to each other is kept, and one factor is learnt.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from handsight._kernels.touch.slip import highest_heap
from handsight._kernels.touch.slip_records import BINS, FIRST, FRICTION


class Friction:
    """A `Friction` is an estimate of μ from what was declared, and from all loads so far. `update` binds its attributes
    anew and changes none in place, so that a shallow copy evolves apart from it."""

    def __init__(self, declared: float | None = None, sigma: float | None = None) -> None:
        """Starts without any load; `declared` is μ with its standard deviation, None where it is unknown."""
        self.coefficient = declared  # μ; None before it was declared or there were enough turns
        self.sigma = sigma  # standard deviation of μ; None where μ is
        self._declared = None if declared is None or sigma is None else (declared, sigma)
        self._turns = np.zeros(BINS, dtype=np.int64)  # (BINS,) turns in each bin of the ratio's logarithm
        self._error = 0  # standard deviation of the ratios in bins
        self._heap: tuple[float, int] | None = None  # mean ratio of the highest heap, and its turns
        self._kept_up = 0.0  # the highest ratio that two fingers have kept up

    def update(self, turns: Sequence[tuple[float, int]], kept_up: float, error: float = 0.0) -> None:
        """Learns from ratios at which ratio vectors have turned, each counted so often.

        `kept_up`: the highest ratio that two fingers have kept up, or the only one that has touched. `error`: standard
        deviation of the ratios, as a share of them, by which a heap is wider.
        """
        before = self._error, self._kept_up
        self._error, self._kept_up = now = round(error / FRICTION.bin_width), kept_up
        if not turns and now == before:
            return
        if turns:
            self._turns = self._turns.copy()
            for ratio, count in turns:
                self._turns[round(math.log(ratio) / FRICTION.bin_width) - FIRST] += count
            shared = FRICTION.near_heap * kept_up
            shared_bin = math.log(shared) / FRICTION.bin_width - FIRST if shared > 0 else -math.inf
            mean, total = highest_heap(self._turns, shared_bin, self._error)
            self._heap = (math.exp(FRICTION.bin_width * mean), total) if total else None
        # What was declared and the heap are joined; the ratios that were kept up bound μ from below.
        kept = FRICTION.noise_margin * kept_up
        estimates = [] if self._declared is None else [self._declared]
        if self._heap is not None:
            heap, total = self._heap
            sigma = math.hypot(FRICTION.least_sigma, FRICTION.turn_sigma / math.sqrt(total))
            if total < FRICTION.certain_turns or kept > FRICTION.near_heap * heap:
                sigma = FRICTION.doubtful_sigma
                heap = min(max(heap, kept), FRICTION.max_above * heap)
            estimates.append((heap, sigma * heap))
        if estimates:
            mu, sigma = joined(estimates)
            self.coefficient = mu if self._declared is None else max(mu, kept)
            self.sigma = sigma * self.coefficient / mu


def joined(estimates: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Returns μ and its sigma from independent estimates with theirs, each a Gaussian of the logarithm of μ."""
    logs, weights = zip(*((math.log(mu), (mu / sigma) ** 2) for mu, sigma in estimates), strict=True)
    mu = math.exp(sum(m * w for m, w in zip(logs, weights, strict=True)) / sum(weights))
    return mu, mu / math.sqrt(sum(weights))
