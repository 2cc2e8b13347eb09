"""The best answer: the mean of a mode that is no Gaussian, else its maximum.

Two fingers and a thumb on opposite faces leave a slide that edges bound and do not fix: the maximum of the density is
at the interval's end, its mean in the middle. How it is integrated: `_kernels/posterior/mean.py`.
"""

import numpy as np

from handsight import checks
from handsight._kernels.posterior import mean
from handsight._kernels.posterior.options import INTEGRATION
from handsight.correction import modes, solve
from handsight.correction.estimate import PoseEstimate
from handsight.correction.problem import Problem, descents_at
from handsight.errors import InvalidInput

ANSWERS = ("best", "maximum", "mean")
"""The mean where a mode is no Gaussian, else the maximum; or always one of them."""


def checked_answer(answer: object, name: str = "answer") -> str:
    """Returns one of `ANSWERS`; raises InvalidInput."""
    if not isinstance(answer, str) or answer not in ANSWERS:
        raise InvalidInput(f"{name}: expected one of {', '.join(ANSWERS)}, got {checks.brief(answer)!r}")
    return answer


def _is_gaussian(problem: Problem, row: np.void) -> bool:
    """Returns whether a mode is answered by its mean."""
    return bool(row["departure"] > INTEGRATION.max_gaussian_rise and (row["complete"] or not problem.blind))


def with_means(problem: Problem, estimate: PoseEstimate, answer: str) -> PoseEstimate:
    """Returns the estimate whose likeliest modes are means, each where it is no Gaussian, or its first one all the
    same.

    A mode that the same slide leads to is part of its mean, and no hypothesis any more, nor is one of two means that
    are not apart. Blind, a mode with a direction that is not known stays its maximum: such a slide ends nowhere, and
    several maxima along it say more than one mean.
    """
    integrated = [_is_gaussian(problem, row) for row in estimate.modes[: INTEGRATION.max_modes]]
    if answer == "maximum" or not (answer == "mean" or any(integrated)):
        return estimate
    rows = np.array(estimate.modes)
    rows["departure"][: len(integrated)][~np.array(integrated)] = 0.0
    if answer == "mean":
        rows["departure"][0] = np.inf
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    used[0, list(estimate.outliers)] = False
    mean.integrate(*problem.model.record[:2], problem.sets(used), problem.constraints, problem.outside, rows)
    if len(rows) > 1:
        rows = rows[rows["weight"] >= 0]
        order = np.argsort(-rows["log_weight"], kind="stable")
        means = descents_at(rows["T_palm_object"])
        rows = rows[solve.distinct(problem.model, means, order, modes.MODES.max_modes, modes.SAME_MODE)]
    share = np.exp(rows["log_weight"] - rows["log_weight"][0])
    rows["weight"] = share / share.sum()
    residuals = solve.residuals(problem, descents_at(rows["T_palm_object"][:1]))
    consistent = modes.fits(rows[0]["chi2"], problem.freedom(used))
    return PoseEstimate(rows[0], tuple(rows), residuals, consistent, estimate.outliers)
