"""Whether the minimum that one start led to is enough, or a search among many might find a better one."""

import math
from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.records import DOUBTED, ENOUGH, GRID, POSE, SHEET, UNCERTAINTY, UNDECIDED
from handsight._compiled.stack import local
from handsight._compiled.symmetry import are_distinct, pose_of, store_pose
from handsight.correction.kernels.levenberg import descend
from handsight.correction.kernels.match import are_near, match
from handsight.correction.kernels.prior_term import drawn, spread
from handsight.correction.kernels.search_options import ACCEPTANCE, DESCENT, MATCH, SEARCH
from handsight.correction.kernels.terms import Evidence

DRAWS = np.random.default_rng(0).normal(size=(1 + ACCEPTANCE.confirming, 6))[1:]
"""Standard normal draws, those that a search begins with after the prior's own pose."""


@inner
def chi2_survival(chi2: float, freedom: int) -> float:
    """Returns the probability that χ² with so many degrees of freedom is larger, 0 for NaN.

    For whole degrees of freedom it is a finite sum (Abramowitz and Stegun, 26.4.4 and 26.4.5).
    """
    if not chi2 > 0.0:
        return 0.0 if chi2 != chi2 else 1.0
    half = 0.5 * chi2
    odd = freedom % 2
    log_term = -half + (np.log(2 * np.sqrt(half / np.pi)) if odd else 0.0)
    total = math.erfc(np.sqrt(half)) if odd else 0.0
    for m in range(freedom // 2):
        total += np.exp(log_term)
        log_term += np.log(half / (m + 1.0 + 0.5 * odd))
    return total


@inner
def _confirmed(evidence: Evidence, answer: Any) -> bool:
    """Returns whether draws from the prior lead to no likely minimum but that of an ANSWER, and to no lower cost.

    Those that phase 1 leads to where it led an earlier one go no further, and none does once one has led elsewhere.
    """
    model = evidence.model
    given = evidence.constraints
    found = pose_of(answer.pose)
    u = local(UNCERTAINTY)
    terms = evidence.terms.copy()
    ends = np.empty(len(DRAWS), POSE)
    count = 0
    nodes, hand, measured = evidence.nodes, evidence.outside, evidence.measured
    evidence = Evidence(model, nodes, terms, hand, measured, given, evidence.prior, evidence.center)
    spread(given.prior, u)
    for k in range(len(DRAWS)):
        pose = drawn(given.prior, DRAWS[k], u)
        new = True
        done = False
        for part in range(2):
            if new and not done:
                pose, _, done = match(evidence, pose, MATCH.max_steps if part else SEARCH.first_steps)
                for j in range(count):
                    new = new and not are_near(model, pose, pose_of(ends[j]))
        if new:
            store_pose(pose, ends[count])
            count += 1
            pose, _, _, _ = descend(evidence, model.coarse, pose, DESCENT.coarse, True)
            pose, cost, _, _ = descend(evidence, model.fine, pose, DESCENT.fine, True)
            likely = cost < answer.cost + 2 * SEARCH.unlikely
            if cost < answer.cost - 1 or (likely and are_distinct(model, pose, found, SEARCH.same_minimum)):
                return False
    return True


@inner
def freedom(answer: Any) -> int:
    """Returns the degrees of freedom of the cost of an ANSWER: its rows of evidence, and the walls that it meets."""
    return max(answer.rows + answer.walls, 1)


@inner
def is_suspicious(answer: Any) -> bool:
    """Returns whether a contact may be wrong at an ANSWER: by its cost, or by the gain of leaving one out."""
    unlikely = chi2_survival(answer.cost, freedom(answer)) < ACCEPTANCE.recheck_p
    return unlikely or not answer.gain < ACCEPTANCE.decisive


@inner
def worst_contact(terms: Any) -> int:
    """Returns the number of the contact whose gain is the largest."""
    worst = 0
    for i in range(1, len(terms)):
        if terms[i].contact.gain > terms[worst].contact.gain:
            worst = i
    return worst


@inner
def verdict(evidence: Evidence, follows: bool, led_astray: bool, answer: Any) -> int:
    """Returns whether an ANSWER of one descent is ENOUGH, DOUBTED, or UNDECIDED: then it is enough if no evidence
    contradicts the rest and few contacts leave one minimum only.

    The probability of a missed mode grows with the square of the prior's width; where it is too large, though no
    contact is suspicious, a few draws from the prior decide, as where the descent was at first `led_astray`. A descent
    that `follows` started at a mode that a search has led to; then it is enough that the evidence fits.
    """
    cost = answer.cost
    rows = max(answer.rows, 1)
    if not answer.converged:
        return DOUBTED
    fine = evidence.model.fine.kind
    count = len(evidence.terms)
    # Three contacts, or four of which some have no normal, on a surface that is bent in more than one way.
    few = rows <= ACCEPTANCE.few_rows or (
        count <= ACCEPTANCE.few_contacts and rows <= 3 * ACCEPTANCE.few_contacts
    )
    few = few and fine in (GRID, SHEET)
    if follows:
        fits = chi2_survival(cost, freedom(answer)) >= ACCEPTANCE.alarm
    else:
        wide = (answer.width / SEARCH.single_start_width) ** 2
        level = ACCEPTANCE.doubt_p if fine in (GRID, SHEET) else ACCEPTANCE.doubt_plain_p
        coarse = chi2_survival(answer.coarse_cost * wide / ACCEPTANCE.coarse_factor, rows)
        p_value = chi2_survival(cost, freedom(answer))
        fits = not is_suspicious(answer) and not (few and answer.width > ACCEPTANCE.weak_width)
        if led_astray or coarse < ACCEPTANCE.coarse_p or p_value < level * wide:
            fits = fits and _confirmed(evidence, answer)
    if not fits:
        return DOUBTED
    # What is left out lowers χ² by no more than all of it.
    gain = min(max(answer.gain, max(answer.prior_gain, answer.outside_gain)), answer.chi2)
    least = 3 if rows >= 3 * count and answer.outside_gain == 0.0 else 1
    contradicts = chi2_survival(gain, least) < max(ACCEPTANCE.each / count, ACCEPTANCE.kind)
    if few or contradicts or chi2_survival(answer.chi2, freedom(answer)) < ACCEPTANCE.pool:
        return UNDECIDED
    return ENOUGH
