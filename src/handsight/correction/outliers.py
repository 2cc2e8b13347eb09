"""A contact that does not fit the others is found by solving without it, and named."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import FINEST, Array, Mask
from handsight.correction import modes, starts
from handsight.correction.modes import DECISIVE
from handsight.correction.problem import Problem, Records, TwoPhase, poses_of
from handsight.correction.solve import largest_gain, residuals, solve

ESCALATED = 64
"""Starts drawn when none of the usual ones fits."""
WITHOUT_STARTS = 12
"""Starts for each contact left out in turn."""
MOST_SUSPECTS, MOST_OUTLIERS = 20, 10
"""Contacts that are left out in turn, those that fit worst, and contacts that may be called wrong: of so many, that the
work grows no faster than the number of contacts."""
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
        more = starts.from_prior(problem.vision, ESCALATED)[starts.count(problem.model, problem.vision) :]
        found = _both(found, _candidates(*solve(problem, more, everyone)))
    suspicious = _suspicious(problem, found)
    while options.reject_outliers and suspicious:
        left = int(found.used.sum())
        if n - left >= most_outliers(n, blind=problem.blind):
            break
        without = _leave_one_out(problem, options, found)
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
    return min(max((n - 2) // 2 if blind else (n - 1) // 2, 0), MOST_OUTLIERS)


def _starts(problem: Problem, options: TwoPhase, used: Mask) -> Array:
    if problem.vision is None:
        return starts.blind(problem, used)
    number = options.starts or starts.count(problem.model, problem.vision)
    return starts.from_prior(problem.vision, number)


def _candidates(minima: Records, used: Mask) -> Candidates:
    """The minima that use the same contacts as the cheapest."""
    return Candidates(minima[(used == used[0]).all(axis=1)], used[:1])


def _both(a: Candidates, b: Candidates) -> Candidates:
    """The minima of both, which use the same contacts."""
    minima = np.concatenate([a.minima, b.minima])
    return Candidates(minima[np.argsort(minima["cost"], kind="stable")], a.used)


def _fits(problem: Problem, found: Candidates, alarm: float) -> bool:
    return modes.fits(found.cost, problem.freedom(found.used), alarm)


def _leave_one_out(problem: Problem, options: TwoPhase, found: Candidates) -> Candidates:
    """The cheapest minima with one more contact left out, whichever it is."""
    used, contacts = found.used, _suspects(problem, found)
    if problem.vision is None and used.sum() > MOST_SUSPECTS:
        each = [_starts(problem, options, used)] * len(contacts)  # of so many, one less changes hardly any
    elif problem.vision is None:
        each = [_starts(problem, options, _less(used, i)) for i in contacts]
    else:
        number = max(WITHOUT_STARTS, starts.count(problem.model, problem.vision) // 2)
        each = [starts.from_prior(problem.vision, number)] * len(contacts)
    masks = [np.repeat(_less(used, i), len(T), axis=0) for i, T in zip(contacts, each, strict=True)]
    return _candidates(*solve(problem, np.concatenate(each), np.concatenate(masks)))


def _suspects(problem: Problem, found: Candidates) -> list[int]:
    """The contacts in use that fit worst where they were cheapest, in their order."""
    contacts = np.flatnonzero(found.used[0])
    if len(contacts) > MOST_SUSPECTS:
        distance, angle = residuals(problem, found.minima[:1]).T
        variance = np.einsum("nii->ni", problem.contacts.covariance)
        square = distance**2 / (variance[:, :3].mean(axis=1) + FINEST**2)
        square += np.nan_to_num(angle) ** 2 / (variance[:, 3:].sum(axis=1) / 2 + FINEST**2)
        contacts = np.sort(contacts[np.argsort(-square[contacts], kind="stable")[:MOST_SUSPECTS]])
    return [int(i) for i in contacts]


def _less(used: Mask, contact: int) -> Mask:
    fewer = used.copy()
    fewer[0, contact] = False
    return fewer
