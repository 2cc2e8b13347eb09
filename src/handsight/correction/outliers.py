"""A contact that does not fit the others is found by solving without it, and named."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array, Mask
from handsight.correction import modes, starts
from handsight.correction.modes import DECISIVE
from handsight.correction.problem import Problem, Records, TwoPhase, poses_of
from handsight.correction.solve import largest_gain, solve

ESCALATED = 64
"""Starts drawn when none of the usual ones fits."""
WITHOUT_STARTS = 12
"""Starts for each contact left out in turn."""
ACCEPT_P = 0.05
"""Without the wrong one, contacts fit better than this part of those that are right."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Minima that use one and the same set of contacts, cheapest first."""

    minima: Records
    """(K,) DESCENT."""
    used: Mask
    """(1, n) bool."""

    @property
    def cost(self) -> float:
        """The least."""
        return float(self.minima["cost"][0])


def solve_robustly(problem: Problem, options: TwoPhase) -> Candidates:
    """The minima of a correction, after more starts and after leaving out wrong contacts where nothing fits."""
    n = len(problem.contacts)
    everyone = np.ones((1, n), dtype=bool)
    found = _candidates(*solve(problem, _starts(problem, options, everyone), everyone))
    if found.minima["converged"][0] and not _suspicious(problem, found):
        return found
    if problem.vision is not None and options.starts is None:
        more = starts.from_prior(problem.vision, ESCALATED)
        found = _cheaper(found, _candidates(*solve(problem, more, everyone)))
    suspicious = _suspicious(problem, found)
    while options.reject_outliers and suspicious:
        left = int(found.used.sum())
        if n - left >= most_outliers(n, blind=problem.blind):
            break
        without = _leave_one_out(problem, options, found.used)
        gain = found.cost - without.cost
        decisive = _fits(problem, without, ACCEPT_P) or gain > 0.5 * found.cost
        if gain < DECISIVE or not decisive:
            break
        # The pose without it may be the one that fits it too, and was only hard to reach.
        again = _candidates(*solve(problem, poses_of(without.minima), found.used))
        if _fits(problem, again, ACCEPT_P):
            return again
        # One wrong contact is rare, a second one rarer.
        found, suspicious = without, not _fits(problem, without, modes.ALARM)
    return found


def _suspicious(problem: Problem, found: Candidates) -> bool:
    # Blind, the others may not fix the pose, and what one gains says nothing.
    gain = 0.0 if problem.blind else largest_gain(problem, found.minima[:1], found.used)
    return not modes.unsuspicious(found.cost, problem.freedom(found.used), gain)


def most_outliers(n: int, *, blind: bool) -> int:
    """How many of n contacts may be called wrong: the rest must still outvote them."""
    return max((n - 2) // 2, 0) if blind else max((n - 1) // 2, 0)


def _starts(problem: Problem, options: TwoPhase, used: Mask) -> Array:
    if problem.vision is None:
        return starts.blind(problem, used)
    number = options.starts or starts.count(problem.model, problem.vision)
    return starts.from_prior(problem.vision, number)


def _candidates(minima: Records, used: Mask) -> Candidates:
    """The minima that use the same contacts as the cheapest."""
    return Candidates(minima[(used == used[0]).all(axis=1)], used[:1])


def _cheaper(a: Candidates, b: Candidates) -> Candidates:
    return b if b.cost < a.cost - 1e-9 * (1 + a.cost) else a


def _fits(problem: Problem, found: Candidates, alarm: float) -> bool:
    return modes.fits(found.cost, problem.freedom(found.used), alarm)


def _leave_one_out(problem: Problem, options: TwoPhase, used: Mask) -> Candidates:
    """The cheapest minima with one more contact left out, whichever it is."""
    contacts = np.flatnonzero(used[0]).tolist()
    if problem.vision is None:
        each = [_starts(problem, options, _less(used, i)) for i in contacts]
    else:
        number = max(WITHOUT_STARTS, starts.count(problem.model, problem.vision))
        each = [starts.from_prior(problem.vision, number)] * len(contacts)
    masks = [np.repeat(_less(used, i), len(T), axis=0) for i, T in zip(contacts, each, strict=True)]
    return _candidates(*solve(problem, np.concatenate(each), np.concatenate(masks)))


def _less(used: Mask, contact: int) -> Mask:
    fewer = used.copy()
    fewer[0, contact] = False
    return fewer
