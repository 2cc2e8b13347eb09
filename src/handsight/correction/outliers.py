"""A contact that does not fit the others is found by solving without it, and named."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handsight.checks import Array, Mask
from handsight.correction import modes, starts, two_phase
from handsight.correction.estimate import PoseEstimate
from handsight.correction.solve import Descent
from handsight.correction.two_phase import Problem, TwoPhase

ESCALATED = 64
"""Starts drawn when none of the usual ones fits."""
WITHOUT_STARTS = 12
"""Starts for each contact left out in turn."""
SUSPICION = 0.003
"""Probability that contacts which fit are searched for a wrong one all the same: time lost, nothing else."""
CLEAN = 0.05
"""Without the wrong one, contacts fit better than this part of those that are right."""
DECISIVE = 16.27
"""A contact is wrong when the cost falls by more than this without it: a right one's does once in 1000."""


class Solver(Protocol):
    """The two phases and the posterior at their minima: `plain`, or `compiled`."""

    def solve(self, problem: Problem, Ts_start: Array, used: Mask) -> tuple[Descent, Mask]:
        """Candidates, cheapest first, and which contacts (K, n) count for each."""
        ...

    def largest_gain(self, problem: Problem, T_palm_object: Array, used: Mask) -> float:
        """The most that χ² falls, to first order, when one contact is left out."""
        ...

    def explained(self, problem: Problem, descent: Descent, used: Mask) -> PoseEstimate:
        """The answer to a problem from its minima."""
        ...

    def cost(self, problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
        """Minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant."""
        ...


@dataclass(frozen=True, slots=True)
class Candidates:
    """Minima that use one and the same set of contacts, cheapest first."""

    descent: Descent
    used: Mask
    """(1, n) bool."""

    @property
    def cost(self) -> float:
        """The least."""
        return float(self.descent.cost[0])


def solve_robustly(problem: Problem, options: TwoPhase, solver: Solver) -> Candidates:
    """The minima of a correction, after more starts and after leaving out wrong contacts where nothing fits."""
    n = len(problem.contacts)
    everyone = np.ones((1, n), dtype=bool)
    found = _candidates(*solver.solve(problem, _starts(problem, options, everyone), everyone))
    if found.descent.converged[0] and not _suspicious(problem, found, solver):
        return found
    if problem.vision is not None and options.starts is None:
        more = starts.from_prior(problem.vision, ESCALATED)
        found = _cheaper(found, _candidates(*solver.solve(problem, more, everyone)))
    suspicious = _suspicious(problem, found, solver)
    while options.reject_outliers and suspicious:
        left = int(found.used.sum())
        if n - left >= most_outliers(n, blind=problem.vision is None):
            break
        without = _leave_one_out(problem, options, found.used, solver)
        gain = found.cost - without.cost
        decisive = _fits(problem, without, CLEAN) or gain > 0.5 * found.cost
        if gain < DECISIVE or not decisive:
            break
        # The pose without it may be the one that fits it too, and was only hard to reach.
        again = _candidates(*solver.solve(problem, without.descent.Ts_palm_object, found.used))
        if _fits(problem, again, CLEAN):
            return again
        # One wrong contact is rare, a second one rarer.
        found, suspicious = without, not _fits(problem, without, modes.ALARM)
    return found


def fits(cost: float, freedom: int, gain: float) -> bool:
    """Whether contacts raise no suspicion: not all together, nor one of them against the others."""
    return modes.fits(cost, freedom, SUSPICION) and gain < DECISIVE


def _suspicious(problem: Problem, found: Candidates, solver: Solver) -> bool:
    # Blind, the others may not fix the pose, and what one gains says nothing.
    gain = 0.0
    if problem.vision is not None:
        gain = solver.largest_gain(problem, found.descent.Ts_palm_object[0], found.used)
    return not fits(found.cost, two_phase.freedom(problem, found.used), gain)


def most_outliers(n: int, *, blind: bool) -> int:
    """How many of n contacts may be called wrong: the rest must still outvote them."""
    return max((n - 2) // 2, 0) if blind else max((n - 1) // 2, 0)


def _starts(problem: Problem, options: TwoPhase, used: Mask) -> Array:
    if problem.vision is None:
        return starts.blind(problem.model, problem.touch(problem.model.coarse, used))
    number = options.starts or starts.count(problem.model, problem.vision)
    return starts.from_prior(problem.vision, number)


def _candidates(descent: Descent, used: Mask) -> Candidates:
    """The descents that use the same contacts as the cheapest."""
    same = np.flatnonzero((used == used[0]).all(axis=1))
    return Candidates(descent.taking(same), used[:1])


def _cheaper(a: Candidates, b: Candidates) -> Candidates:
    return b if b.cost < a.cost - 1e-9 * (1 + a.cost) else a


def _fits(problem: Problem, found: Candidates, alarm: float) -> bool:
    return modes.fits(found.cost, two_phase.freedom(problem, found.used), alarm)


def _leave_one_out(problem: Problem, options: TwoPhase, used: Mask, solver: Solver) -> Candidates:
    """The cheapest minima with one more contact left out, whichever it is."""
    contacts = np.flatnonzero(used[0]).tolist()
    if problem.vision is None:
        each = [_starts(problem, options, _less(used, i)) for i in contacts]
    else:
        number = max(WITHOUT_STARTS, starts.count(problem.model, problem.vision))
        each = [starts.from_prior(problem.vision, number)] * len(contacts)
    masks = [np.repeat(_less(used, i), len(T), axis=0) for i, T in zip(contacts, each, strict=True)]
    return _candidates(*solver.solve(problem, np.concatenate(each), np.concatenate(masks)))


def _less(used: Mask, contact: int) -> Mask:
    fewer = used.copy()
    fewer[0, contact] = False
    return fewer
