"""Wrong contacts: each suspect is left out in turn, and is wrong where the others then fit much better."""

from typing import NamedTuple

import numpy as np

from handsight._kernels.records import DESCENT
from handsight.correction import modes, starts
from handsight.correction.modes import MODES
from handsight.correction.problem import Budget, Problem, Records, TwoPhase, descents_at, plain
from handsight.correction.solve import Candidates, gains, solve


class OutlierOptions(NamedTuple):
    """`OutlierOptions` say how wrong contacts are searched for."""

    more_starts: int = 2  # times as many starts are drawn when none of the usual ones fits
    min_gain: float = 1.0  # by how much these must lower the cost for the search to go on
    fewer_starts: int = 14  # starts for each contact left out in turn: so many fewer than the usual ones
    max_starts: int = 16  # and at most so many
    blind_starts: int = 64  # the same without vision
    kept_minima: int = 4  # minima of all contacts that are starts for each contact left out as well
    max_suspects: int = 10
    """Contacts that are left out in turn, the most promising ones, so that the work grows no faster than the number of
    contacts.
    """
    max_outliers: int = 10  # contacts that may be called wrong
    accept_p: float = 0.05
    """Without the wrong one the others must fit better than this part of right contacts do."""


OUTLIERS = OutlierOptions()


def solve_robustly(problem: Problem, options: TwoPhase, budget: Budget) -> Candidates:
    """Returns the minima of a correction; where nothing fits, after more starts and after leaving out wrong contacts.

    When the budget is spent, those found until then.
    """
    everyone = np.ones((1, len(problem.contacts)), dtype=bool)
    number = starts.usual(problem) if problem.blind or options.starts is None else options.starts
    found = solve(problem, _starts(problem, number)[None], everyone, budget)
    suspicious = _suspicious(problem, found)
    if found.converged and not suspicious:
        return found
    may_draw = not problem.blind and options.starts is None and problem.starts is None
    while not budget.spent():
        without = _leave_one_out(problem, found, budget) if options.reject_outliers and suspicious else None
        gain = 0.0 if without is None else found.cost - without.cost
        if (
            without is not None
            and gain >= MODES.decisive
            and (without.fits(OUTLIERS.accept_p) or gain > 0.5 * found.cost)
        ):
            # The pose without it may be the one that fits it too, and was only hard to reach.
            again = solve(problem, without.minima[None], found.used, budget)
            if again.fits(OUTLIERS.accept_p):
                return again
            # A wrong contact is rare, a second one rarer: the search goes on only where these do not fit.
            found, suspicious = without, not without.fits()
            if not suspicious:
                return found
        elif may_draw:
            cost, may_draw = found.cost, False
            drawn = _starts(problem, OUTLIERS.more_starts * number)[None, number:]
            found = found.with_more(solve(problem, drawn, found.used, budget))
            suspicious = _suspicious(problem, found)
            if found.cost > cost - OUTLIERS.min_gain or not suspicious:
                return found
        else:
            return found
    return found


def _suspicious(problem: Problem, found: Candidates) -> bool:
    """Returns whether the contacts may not fit together."""
    # Without vision the others may not fix the pose, and the gain of one says nothing.
    gain = 0.0 if problem.blind else float(found.minima["gain"][0])
    return not modes.unsuspicious(found.cost, found.freedom, gain)


def _starts(problem: Problem, number: int) -> Records:
    """Returns (number,) DESCENT at starts for all contacts; or at those that the problem has."""
    if problem.starts is not None:
        near = descents_at(problem.starts)
        near["iterations"] = 1  # so they skip phase 1, as minima of other evidence do
        return near
    if problem.vision is not None:
        return starts.from_prior(problem.vision, number)
    everyone = np.ones(len(problem.contacts), dtype=bool)
    return starts.blind(problem, everyone, prune=True).best(everyone, number)


def most_outliers(n: int, *, blind: bool) -> int:
    """Returns how many of n contacts may be called wrong: the rest must still outvote them."""
    return min(max((n - 2) // 2 if blind else (n - 1) // 2, 0), OUTLIERS.max_outliers)


def _leave_one_out(problem: Problem, found: Candidates, budget: Budget) -> Candidates | None:
    """Returns the cheapest minima with one more contact left out, of the suspects; None where no more may be.

    The search without it goes on from the minima found so far, and from a few starts that all share, or, without
    vision, from those that the others fit best: all are scored once.
    """
    contacts, n = np.flatnonzero(found.used[0]), found.used.size
    if n - len(contacts) >= most_outliers(n, blind=problem.blind):
        return None
    if len(contacts) > OUTLIERS.max_suspects:  # those that promise most, to first order, at the best minimum
        gain = gains(problem, found.minima[:1], found.used)
        contacts = np.sort(contacts[np.argsort(-gain[contacts], kind="stable")[: OUTLIERS.max_suspects]])
    masks = np.repeat(found.used, len(contacts), axis=0)
    masks[np.arange(len(contacts)), contacts] = False
    here, number = found.minima[: OUTLIERS.kept_minima], OUTLIERS.blind_starts
    if problem.vision is not None:
        number = max(min(starts.usual(problem) - OUTLIERS.fewer_starts, OUTLIERS.max_starts), 1)
    begin = np.empty((len(masks), len(here) + number), dtype=DESCENT)
    plain(begin)[:, : len(here)] = plain(here)
    if problem.vision is not None:
        plain(begin)[:, len(here) :] = plain(starts.from_prior(problem.vision, number))
    else:
        scored = starts.blind(problem, found.used[0], prune=False)
        for row, mask in zip(begin, masks, strict=True):
            plain(row)[len(here) :] = plain(scored.best(mask, number))
    return solve(problem, begin, masks, budget)
