"""The search for wrong contacts: each suspect is left out in turn, and is wrong if the others then fit much better."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handsight._kernels.records import DESCENT
from handsight._kernels.solve.options import ACCEPTANCE
from handsight.checks import Indices
from handsight.correction import modes, starts
from handsight.correction.problem import Budget, Problem, Records, Steps, TwoPhase, descents_at, plain
from handsight.correction.solve import Candidates, solve


class OutlierOptions(NamedTuple):
    """`OutlierOptions` are the limits of the search for wrong contacts."""

    more_starts: int = 2  # factor on the number of starts when none of the usual ones fits
    min_gain: float = 1.0  # least fall of the cost by these starts after which the search goes on
    fewer_starts: int = 14  # with a contact left out: how many starts fewer than usual are drawn
    max_starts: int = 16  # with a contact left out: most starts that are drawn
    blind_starts: int = 64  # with a contact left out, without vision: number of starts
    kept_minima: int = 4  # with a contact left out: minima of all contacts that are starts too
    max_suspects: int = 10
    """Most contacts that are left out in turn, those of the largest gain, so that the work grows no faster than the
    number of contacts.
    """
    max_outliers: int = 10  # most contacts that may be called wrong
    accept_p: float = 0.05
    """Level of the χ² test that the others must pass without the wrong contact."""


OUTLIERS = OutlierOptions()


def solve_robustly(problem: Problem, options: TwoPhase, budget: Budget) -> Steps[Candidates]:
    """Returns the minima of a correction; where none fits, after more starts and with wrong contacts left out.

    When the budget is spent, those found until then are returned.
    """
    everyone = np.ones((1, len(problem.contacts)), dtype=bool)
    number = starts.usual(problem) if problem.blind or options.starts is None else options.starts
    found = solve(problem, first_starts(problem, number)[None], everyone, budget)
    yield
    suspicious = _suspicious(problem, found)
    if found.converged and not suspicious:
        return found
    vision = problem.vision
    may_draw = vision is not None and options.starts is None and problem.starts is None
    if vision is not None and may_draw and len(problem.outside) and not budget.spent():
        past = replace(problem, starts=starts.past_outside(problem, vision, number, budget))
        found = found.with_more(solve(past, first_starts(past, number)[None], everyone, budget))
        yield
        suspicious = _suspicious(problem, found)
        if found.converged and not suspicious:
            return found
    while not budget.spent():
        without = None
        # First the worst one alone: often it has only led the descents astray, and fits at the pose without it.
        for left_out in _suspects(problem, found) if options.reject_outliers and suspicious else ():
            other = _leave_one_out(problem, found, left_out, budget)
            yield
            if without is None or other.cost < without.cost:
                without = other
                if _better(without, found):
                    again = solve(problem, without.minima[None], found.used, budget)
                    yield
                    if again.fits(OUTLIERS.accept_p):
                        return again
        if without is not None and _better(without, found):
            # A second wrong contact is rare: it is searched for only where the contacts left do not fit.
            falls = np.where(without.used[0], found.falls, found.cost - without.cost)
            found, suspicious = replace(without, falls=falls), not without.fits()
            if not suspicious:
                return found
        elif may_draw:
            cost, may_draw = found.cost, False
            drawn = first_starts(problem, OUTLIERS.more_starts * number)[None, number:]
            found = found.with_more(solve(problem, drawn, found.used, budget))
            yield
            suspicious = _suspicious(problem, found)
            if found.cost > cost - OUTLIERS.min_gain or not suspicious:
                return found
        else:
            return found
    return found


def _suspicious(problem: Problem, found: Candidates) -> bool:
    """Returns whether one of the contacts may be wrong."""
    # Without vision the other contacts may not fix the pose, and then any contact has a gain.
    gain = 0.0 if problem.blind else float(found.minima["gain"][0])
    return not found.fits(ACCEPTANCE.recheck_p) or not gain < ACCEPTANCE.decisive


def _better(without: Candidates, found: Candidates) -> bool:
    """Returns whether the cost falls so far without a contact that this is wrong."""
    gain = found.cost - without.cost
    return gain >= ACCEPTANCE.decisive and (without.fits(OUTLIERS.accept_p) or gain > 0.5 * found.cost)


def _suspects(problem: Problem, found: Candidates) -> list[Indices]:
    """Returns the contacts to leave out in turn: the one of the largest gain, to first order, and those after it; none
    where no more may be left out."""
    contacts, n = np.flatnonzero(found.used[0]), found.used.size
    if n - len(contacts) >= most_outliers(n, blind=problem.blind):
        return []
    order = contacts[np.argsort(-found.gains[contacts], kind="stable")[: OUTLIERS.max_suspects]]
    return [order[:1], order[1:]]


def first_starts(problem: Problem, number: int) -> Records:
    """Returns (number,) DESCENT at starts for all contacts, or (K,) at the starts that the problem has itself."""
    if problem.starts is not None:
        near = descents_at(problem.starts)
        near["iterations"] = 1  # a descent with steps behind it skips phase 1
        return near
    if problem.vision is not None:
        drawn = starts.from_prior(problem.vision, number)
        if modes.several_minima(problem.model, problem.rows, len(problem.contacts)):
            drawn["iterations"][1 :: starts.STARTS.fine_step] = 1  # as above
        return drawn
    everyone = np.ones(len(problem.contacts), dtype=bool)
    return starts.blind(problem, everyone, prune=True).best(everyone, number)


def most_outliers(n: int, *, blind: bool) -> int:
    """Returns how many of n contacts may be called wrong: fewer than the rest."""
    return min(max((n - 2) // 2 if blind else (n - 1) // 2, 0), OUTLIERS.max_outliers)


def _leave_one_out(problem: Problem, found: Candidates, contacts: Indices, budget: Budget) -> Candidates:
    """Returns the minima with one more of some contacts left out, that without which the cheapest minimum is cheapest.

    The descents without each suspect start at the minima found so far and at a few draws from the prior, the same for
    all suspects; without vision, at the starts that the other contacts fit best, out of one set that is scored once.
    """
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
