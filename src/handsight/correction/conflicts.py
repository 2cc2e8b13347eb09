"""Which evidence contradicts the rest: each kind alone against all others, beside the χ² test of all together.

Forty contacts that fit each other hide a prior that they contradict by ten standard deviations in the sum of all
squares. So each kind of evidence A is tested by how much χ² falls when it is left out and the pose adapts to that. In
the linear case this is rᵀ (R + J P Jᵀ)⁻¹ r, with r the residuals of A at the pose that the rest gives, R their
covariance, J their derivative by that pose and P its covariance: χ² with as many degrees of freedom as A has rows.

The kernel computes the fall to first order in closed form. Where that is suspicious, the pose is solved again without
A, from the answer on, so that neither an edge nor a curved cost raises an alarm.
"""

from dataclasses import replace

import numpy as np

from handsight import se3
from handsight._kernels import records
from handsight._kernels.solve import batch
from handsight._kernels.solve.options import ACCEPTANCE
from handsight.checks import Array, Mask
from handsight.correction import modes
from handsight.correction.estimate import Conflict, PoseEstimate
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem

KINDS = ("vision", "weight", "depth", "skin", "outside")
POOL, KIND, EACH = ACCEPTANCE.pool, ACCEPTANCE.kind, ACCEPTANCE.each
"""Levels of the test of all evidence together, of that of one kind, and of those of single contacts together: their
sum over all tests is `ACCEPTANCE.alarm`, so by Bonferroni's inequality at most so many honest answers are called
inconsistent.
"""
TESTED = np.empty(0, records.ANSWER)[["chi2", "gain", "prior_gain", "outside_gain", "rows"]].dtype
"""The fields of an ANSWER by which it is tested, as a view of it; one by one they would take three times as long."""
MOST_CONFLICTS = 10
"""Most conflicts that are named beside what was left out."""
LEAST = modes.chi2_limit(1, EACH)
"""The smallest limit of a test of one kind or one contact."""


def judged(problem: Problem, answer: np.void, used: Mask) -> tuple[bool, tuple[Conflict, ...]]:
    """Returns whether the evidence in use fits together at a mode, and what contradicts the rest.

    `answer`: the mode's ANSWER; `used` (1, n): the contacts in use.
    """
    conflicts: tuple[Conflict, ...] = ()
    if answer["chi2"] > LEAST:
        conflicts = _found(problem, answer, used)
    return modes.fits(answer["chi2"], problem.freedom(used), POOL) and not conflicts, conflicts


def suspects(problem: Problem, answer: np.void, n: int) -> list[str]:
    """Returns the kinds of evidence, "contact" among them, that may contradict the rest, to first order where that is
    known; what is left out can lower χ² by no more than all of it. `n`: contacts in use."""
    chi2, gain, prior, outside, rows = answer.view(TESTED).item()
    every = problem.taxels > 0 or problem.depth is not None
    if chi2 <= LEAST or not (every or max(gain, prior, outside) > LEAST):
        return []
    first = (
        ("vision", prior, modes.chi2_limit(prior_freedom(problem, rows), KIND)),
        ("outside", outside, modes.chi2_limit(1, KIND)),
        ("contact", gain, modes.chi2_limit(3 if rows >= 3 * n else 1, EACH / n)),
    )
    doubtful = [(name, limit) for name, fall, limit in first if every or fall > limit]
    known = [name for name, limit in doubtful if chi2 > limit]
    return [*known, "weight", "depth", "skin"] if doubtful else []


def prior_freedom(problem: Problem, rows: int) -> int:
    """Returns the degrees of freedom of the prior against so many rows."""
    return max(min(6 - len(problem.model.symmetries.axes), rows), 1)


def excluded(problem: Problem, estimate: PoseEstimate, name: str, fall: float) -> Conflict:
    """Returns the conflict of evidence that was left out of an estimate, of "weight" or "contact 3", with the rest.

    `problem`: with that evidence; `fall`: by how much χ² fell without it.
    """
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    used[0, list(estimate.outliers)] = False
    if name != "weight":
        used[0, int(name.split()[1])] = True
    return _conflict(problem, used, name, fall, (estimate.answer, estimate.residual_rows), excluded=True)


def _found(problem: Problem, answer: np.void, used: Mask) -> tuple[Conflict, ...]:
    """Returns what contradicts the rest, the least probable one first, the next ones without those before."""
    found: list[Conflict] = []
    while len(found) < MOST_CONFLICTS:
        best, n = None, int(used.sum())
        for kind in suspects(problem, answer, n):
            name = _worst(problem, answer, used) if kind == "contact" else kind
            if not _freedom(problem, used, name):
                continue
            rest = _without(problem, used, name)
            if not rest[1].any():
                continue
            other, level = _solved(*rest, _mode(answer)), EACH / n if kind == "contact" else KIND
            # The log determinants of the contacts' covariances count where both answers have the same contacts.
            cost = "chi2" if name == "skin" or kind == "contact" else "posterior_cost"
            conflict = _conflict(problem, used, name, float(answer[cost] - other[0][cost]), other)
            if conflict.p_value < level and (best is None or conflict.p_value < best[0].p_value):
                best = conflict, rest, other[0]
        if best is None:
            break
        found.append(best[0])
        (problem, used), answer = best[1:]
    return tuple(found)


def _worst(problem: Problem, answer: np.void, used: Mask) -> str:
    """Returns the name of the contact without which χ² falls most, to first order."""
    arguments, there = problem.arguments(used), np.zeros(1, dtype=records.ANSWER)
    there["pose"], there["first_order"] = answer["pose"], True
    batch.summarize_all(*arguments, there)
    return f"contact {np.where(used[0], arguments[2][0]['gain'], 0.0).argmax()}"


def _freedom(problem: Problem, used: Mask, name: str) -> int:
    """Returns the degrees of freedom of evidence against the rest; 0 where there is none of it, or no rest."""
    if name == "vision":
        return 0 if problem.blind else prior_freedom(problem, problem.freedom(used))
    if name == "weight":
        return 0 if problem.weight is None else 3
    if name == "depth":
        return 0 if problem.depth is None else min(len(problem.depth), 6)
    if name == "skin":
        return int(used[0, -problem.taxels :] @ problem.rows_each[-problem.taxels :]) if problem.taxels else 0
    if name == "outside":  # each link or plane is one row, and they move the pose in at most six directions
        return min(len(np.unique(rows)), 6) if len(rows := problem.outside[["is_plane", "link"]]) else 0
    return int(problem.rows_each[int(name.split()[1])])


def _without(problem: Problem, used: Mask, name: str) -> tuple[Problem, Mask]:
    """Returns the problem and its contacts in use (1, n) without some evidence."""
    if name == "vision":
        return replace(problem, vision=None), used
    if name == "weight":
        return replace(problem, weight=None), used
    if name == "depth":
        return replace(problem, depth=None), used
    if name == "outside":
        return replace(problem, outside=NO_OUTSIDE), used
    used = used.copy()
    if name == "skin":
        used[0, -problem.taxels :] = False
    else:
        used[0, int(name.split()[1])] = False
    return problem, used


def _mode(answer: np.void) -> Array:
    """Returns the pose (4, 4) of the mode of an ANSWER, which may be a mean."""
    return se3.compose(answer["pose"]["rotation"], answer["pose"]["position"])


def _solved(problem: Problem, used: Mask, T_start: Array) -> tuple[np.void, Array]:
    """Returns the ANSWER of a descent from a pose (4, 4) on the fine field, and the residuals (n, 2) there."""
    rows, residuals = np.zeros(1, dtype=records.PROBLEM), np.empty((used.size, 2))
    row, contacts, constraints = rows[0], problem.sets(used)[0], problem.constraints.copy()
    row["follows"] = True
    row["start"]["rotation"], row["start"]["position"] = T_start[:3, :3], T_start[:3, 3]
    if problem.blind:  # of equivalent poses the one nearest to the start is the answer
        constraints["prior"]["pose"] = row["start"]
    batch.correct_all(*problem.model.record[:2], contacts, constraints, problem.outside, rows, residuals)
    return row["answer"], residuals


def _conflict(
    problem: Problem,
    used: Mask,
    name: str,
    fall: float,
    without: tuple[np.void, Array],
    *,
    excluded: bool = False,
) -> Conflict:
    """Returns the conflict of some evidence, `without` which χ² is smaller by `fall`, at the answer without it, which
    comes with its residuals.

    `problem` and `used` (1, n) are with it.
    """
    rest, residuals = without
    fall, freedom = max(fall, 0.0), _freedom(problem, used, name)
    T, offset = _mode(rest), np.empty(0)
    if name == "vision" and problem.vision is not None:
        offset = se3.difference(T, problem.vision.T_palm_object)
    elif name == "weight" and problem.weight is not None:
        center = se3.apply(T, problem.weight.center_object[None])[0]
        offset = center - problem.weight.center_palm
    elif name.startswith("contact"):
        offset = residuals[int(name.split()[1])]
    kinds = [kind for kind in KINDS if kind != name and _freedom(problem, used, kind)]
    taxels = problem.taxels if name == "skin" else 0
    others = used[0, : used.size - taxels].sum() - name.startswith("contact")
    against = (["other contacts" if name.startswith("contact") else "contacts"] if others else []) + kinds
    p_value = modes.chi2_survival(fall, freedom)
    return Conflict(name, ", ".join(against), fall, freedom, p_value, offset, excluded)
