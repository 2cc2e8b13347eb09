"""The search for wrong contacts: each suspect is left out in turn, and is wrong if the others then fit much better."""

from dataclasses import replace

import numpy as np

from handsight.checks import Indices
from handsight.correction import modes, starts
from handsight.correction.kernels.search_options import ACCEPTANCE
from handsight.correction.problem import Problem, Records, descents_at
from handsight.correction.solve import Candidates, solve

MORE_STARTS = 2  # factor on the number of starts when none of the usual ones fits
MIN_GAIN = 1.0  # least fall of the cost by these starts after which the search goes on
FEWER_STARTS = 14  # with a contact left out: how many starts fewer than usual are drawn
MAX_STARTS = 16  # with a contact left out: most starts that are drawn
BLIND_STARTS = 64  # with a contact left out, without vision: number of starts
KEPT_MINIMA = 4  # with a contact left out: minima of all contacts that are starts too
MAX_SUSPECTS = 10
"""Most contacts that are left out in turn, those of the largest gain, so that the work grows no faster than the
number of contacts.
"""
MAX_OUTLIERS = 10  # most contacts that may be called wrong
ACCEPT_P = 0.05
"""Level of the χ² test that the others must pass without the wrong contact."""


def solve_robustly(problem: Problem) -> Candidates:
    """Returns the minima of a correction; where none fits, after more starts and with wrong contacts left out."""
    everyone = problem.everyone
    number = starts.usual(problem)
    found = solve(problem, first_starts(problem, number)[None], everyone)
    suspicious = _suspicious(problem, found)
    if found.converged and not suspicious:
        return found
    may_draw = problem.vision is not None and problem.starts is None
    if problem.vision is not None and may_draw and len(problem.outside):
        past = replace(problem, starts=starts.past_outside(problem, problem.vision, number))
        found = found.with_more(solve(past, first_starts(past, number)[None], everyone))
        suspicious = _suspicious(problem, found)
        if found.converged and not suspicious:
            return found
    while True:
        without = None
        # First the worst one alone: often it has only led the descents astray, and fits at the pose without it.
        for left_out in _suspects(problem, found) if suspicious else ():
            other = _leave_one_out(problem, found, left_out)
            if without is None or other.cost < without.cost:
                without = other
                if _better(without, found):
                    again = solve(problem, without.minima[None], found.used)
                    if again.fits(ACCEPT_P):
                        return again
        if without is not None and _better(without, found):
            found = without
            suspicious = _suspicious(problem, without)
            if not suspicious:
                return found
        elif may_draw:
            cost = found.cost
            may_draw = False
            drawn = first_starts(problem, MORE_STARTS * number)[None, number:]
            found = found.with_more(solve(problem, drawn, found.used))
            suspicious = _suspicious(problem, found)
            if found.cost > cost - MIN_GAIN or not suspicious:
                return found
        else:
            return found


def _suspicious(problem: Problem, found: Candidates) -> bool:
    """Returns whether one of the contacts may be wrong."""
    # Without vision the other contacts may not fix the pose, and then any contact has a gain.
    gain = 0.0 if problem.blind else float(found.minima["gain"][0])
    return not found.fits(ACCEPTANCE.recheck_p) or not gain < ACCEPTANCE.decisive


def _better(without: Candidates, found: Candidates) -> bool:
    """Returns whether the cost falls so far without a contact that this is wrong."""
    gain = found.cost - without.cost
    return gain >= ACCEPTANCE.decisive and (without.fits(ACCEPT_P) or gain > 0.5 * found.cost)


def _suspects(problem: Problem, found: Candidates) -> list[Indices]:
    """Returns the contacts to leave out in turn: the one of the largest gain, to first order, and those after it; none
    where no more may be left out."""
    contacts = np.flatnonzero(found.used[0])
    n = found.used.size
    # Fewer than the rest may be called wrong.
    most = min((n - 2 if problem.blind else n - 1) // 2, MAX_OUTLIERS)
    if n - len(contacts) >= max(most, 0):
        return []
    order = contacts[np.argsort(-found.gains[contacts], kind="stable")[:MAX_SUSPECTS]]
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
            drawn["iterations"][1 :: starts.FINE_STEP] = 1  # as above
        return drawn
    everyone = problem.everyone[0]
    return starts.blind(problem, everyone, prune=True).best(everyone, number)


def _leave_one_out(problem: Problem, found: Candidates, contacts: Indices) -> Candidates:
    """Returns the minima with one more of some contacts left out, that without which the cheapest minimum is cheapest.

    The descents without each suspect start at the minima found so far and at a few draws from the prior, the same for
    all suspects; without vision, at the starts that the other contacts fit best, out of one set that is scored once.
    """
    masks = np.repeat(found.used, len(contacts), axis=0)
    masks[np.arange(len(contacts)), contacts] = False
    if problem.vision is None:
        scored = starts.blind(problem, found.used[0], prune=False)
        more = [scored.best(mask, BLIND_STARTS) for mask in masks]
    else:
        number = max(min(starts.usual(problem) - FEWER_STARTS, MAX_STARTS), 1)
        more = [starts.from_prior(problem.vision, number)] * len(masks)
    here = found.minima[:KEPT_MINIMA]
    begin = np.stack([np.append(here, each) for each in more])
    return solve(problem, begin, masks)
