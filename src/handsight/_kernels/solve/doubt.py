"""Whether the minimum that one start led to is enough, or a search among many might find a better one."""

import math
from typing import Any

import numpy as np

from handsight._kernels.evidence.terms import Evidence
from handsight._kernels.records import DOUBTED, ENOUGH, GRID, SHEET, UNDECIDED
from handsight._kernels.runtime.compilation import inner
from handsight._kernels.solve.options import ACCEPTANCE, SEARCH


@inner
def chi2_survival(chi2: float, freedom: int) -> float:
    """Returns the probability that χ² with so many degrees of freedom is larger, 0 for NaN.

    For whole degrees of freedom it is a finite sum (Abramowitz and Stegun, 26.4.4 and 26.4.5).
    """
    if not chi2 > 0.0:
        return 0.0 if chi2 != chi2 else 1.0
    half, odd = 0.5 * chi2, freedom % 2
    term = np.exp(-half) * (2 * np.sqrt(half / np.pi) if odd else 1.0)
    total = math.erfc(np.sqrt(half)) if odd else 0.0
    for m in range(freedom // 2):
        total += term
        term *= half / (m + 1.0 + 0.5 * odd)
    return total


@inner
def verdict(evidence: Evidence, follows: bool, answer: Any) -> int:
    """Returns whether an ANSWER of one descent is ENOUGH, DOUBTED, or UNDECIDED: then it is enough if no evidence
    contradicts the rest and few contacts leave one minimum only.

    The probability of a missed mode grows with the square of the prior's width. A descent that `follows` started at a
    mode that a search has led to; then it is enough that the evidence fits.
    """
    cost, rows = answer.cost, max(answer.rows, 1)
    if not answer.converged:
        return DOUBTED
    fine, count = evidence.model.fine.kind, len(evidence.terms)
    # Three contacts, or four of which some have no normal, on a surface that is bent in more than one way.
    few = rows <= ACCEPTANCE.few_rows or (
        count <= ACCEPTANCE.few_contacts and rows <= 3 * ACCEPTANCE.few_contacts
    )
    few = few and fine in (GRID, SHEET)
    if follows:
        fits = chi2_survival(cost, rows) >= ACCEPTANCE.alarm
    else:
        wide = (answer.width / SEARCH.single_start_width) ** 2
        least = max(ACCEPTANCE.doubt_p * wide, ACCEPTANCE.recheck_p)
        coarse = chi2_survival(answer.coarse_cost * wide / ACCEPTANCE.coarse_factor, rows)
        fits = coarse >= ACCEPTANCE.coarse_p and chi2_survival(cost, rows) >= least
        fits = fits and answer.gain < ACCEPTANCE.decisive
        fits = fits and not (few and answer.width > ACCEPTANCE.weak_width)
    if not fits:
        return DOUBTED
    gain = max(answer.gain, max(answer.prior_gain, answer.outside_gain))
    contradicts = chi2_survival(min(answer.chi2, gain), 1) < ACCEPTANCE.each
    if few or contradicts or chi2_survival(answer.chi2, rows) < ACCEPTANCE.pool:
        return UNDECIDED
    return ENOUGH
