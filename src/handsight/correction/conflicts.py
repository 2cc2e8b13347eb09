"""Which evidence contradicts the rest: each kind alone against all others, beside the χ² test of all together.

Forty contacts that fit each other hide a prior that they contradict by ten standard deviations in the sum of all
squares. So each kind of evidence A is tested by how much χ² falls when it is left out and the pose adapts to that. In
the linear case this is rᵀ (R + J P Jᵀ)⁻¹ r, with r the residuals of A at the pose that the rest gives, R their
covariance, J their derivative by that pose and P its covariance: χ² with as many degrees of freedom as A has rows.

The kernel computes the fall to first order in closed form. Where that is suspicious, the pose is solved again without
A, from the answer on, so that neither an edge nor a curved cost raises an alarm.
"""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from handsight import se3
from handsight._compiled import records
from handsight.checks import Array, Mask
from handsight.correction import modes
from handsight.correction.estimate import Conflict, PoseEstimate, PosePrior
from handsight.correction.kernels import batch
from handsight.correction.kernels.search_options import ACCEPTANCE
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, poses_of
from handsight.correction.registration import Registration, registered
from handsight.correction.solve import residuals
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel

Kind = Literal["vision", "weight", "skin", "outside"]
Evidence = Kind | int
"""Evidence that may contradict the rest: a kind of it, or a contact by its index."""
KINDS: tuple[Kind, ...] = ("vision", "weight", "skin", "outside")
NOWHERE = np.empty(0)
"""The offset of evidence that has none."""
POOL, KIND, EACH = ACCEPTANCE.pool, ACCEPTANCE.kind, ACCEPTANCE.each
"""Levels of the test of all evidence together, of that of one kind, and of those of single contacts together: their
sum over all tests is `ACCEPTANCE.alarm`, so by Bonferroni's inequality at most so many honest answers are called
inconsistent.
"""
BY_GAIN: dict[str, Kind] = {"prior_gain": "vision", "outside_gain": "outside"}
"""Kinds whose gain, to first order, is in an ANSWER."""
MOST_CONFLICTS = 10
"""Most conflicts that are named of evidence in use; of many contacts that were left out, as many, the worst."""
LEAST = modes.chi2_limit(1, EACH)
"""The smallest limit of a test of one kind or one contact."""


def judged(problem: Problem, answer: np.void, used: Mask) -> tuple[bool, tuple[Conflict, ...]]:
    """Returns whether the evidence in use fits together at a mode, and what contradicts the rest.

    `answer`: the mode's ANSWER; `used` (1, n): the contacts in use.
    """
    conflicts = _found(problem, answer, used)
    freedom = problem.freedom(used, int(answer["walls"]))
    return modes.fits(answer["chi2"], freedom, POOL) and not conflicts, conflicts


def of_registered(problem: Problem, best: Registration) -> tuple[bool, tuple[Conflict, ...]]:
    """Returns whether the evidence of a registration fits together, and what contradicts the rest: first what is in
    use, then the groups and the worst of the single contacts that were left out."""
    in_use = _found(problem, best.row, problem.everyone)
    groups = [_left_out(f"group {g}", float(best.groups[g]["square"]), 6) for g in best.wrong_groups]
    squares = np.where(best.wrong_alone(problem.contacts), best.squares[:, 0], -1.0)
    worst = np.argsort(-squares, kind="stable")[:MOST_CONFLICTS]
    rows = residuals(problem, best.row["T_palm_object"])
    contacts = [
        _left_out(f"contact {i}", float(squares[i]), int(problem.rows_each[i]), rows[i])
        for i in worst
        if squares[i] >= 0
    ]
    return best.fits(problem) and not in_use, (*in_use, *groups, *contacts)


def _left_out(evidence: str, chi2: float, freedom: int, offset: Array = NOWHERE) -> Conflict:
    """Returns the conflict of contacts that a registration has left out."""
    p_value = modes.chi2_survival(chi2, freedom)
    return Conflict(evidence, "other contacts", chi2, freedom, p_value, offset, excluded=True)


def weight_left_out(problem: Problem, without: PoseEstimate, fall: float) -> Conflict:
    """Returns the conflict of the weight, which was left out of an estimate, with the rest.

    `problem`: with the weight; `fall`: by how much χ² is smaller without it.
    """
    used = _in_use(problem, without)
    conflict = _conflict(problem, used, "weight", fall, without.answer, without.residual_rows)
    return replace(conflict, excluded=True)


def contact_left_out(problem: Problem, estimate: PoseEstimate, contact: int) -> Conflict:
    """Returns the conflict of a contact that was left out with the rest: by how much χ² rises from the answer's when it
    alone is put back."""
    used = _in_use(problem, estimate)
    used[0, contact] = True
    with_it, _ = descended(problem, used, estimate.answer["pose"])
    fall = float(with_it["chi2"] - estimate.answer["chi2"])
    conflict = _conflict(problem, used, contact, fall, estimate.answer, estimate.residual_rows)
    return replace(conflict, excluded=True)


def _in_use(problem: Problem, estimate: PoseEstimate) -> Mask:
    """Returns (1, n) which contacts an estimate uses."""
    used = problem.everyone
    used[0, list(estimate.outliers)] = False
    return used


def _suspects(problem: Problem, answer: np.void, used: Mask) -> list[Evidence]:
    """Returns the evidence that may contradict the rest, to first order where that is known; what is left out can lower
    χ² by no more than all of it. Single contacts of a registration have been judged already."""
    chi2 = answer["chi2"]
    if chi2 <= LEAST:
        return []
    n = int(used.sum())
    rows = int(answer["rows"])
    limits = {"outside_gain": modes.chi2_limit(1, KIND)}
    if not problem.blind:
        limits["prior_gain"] = modes.chi2_limit(prior_freedom(problem, rows), KIND)
    if not problem.registered:
        limits["gain"] = modes.chi2_limit(3 if rows >= 3 * n else 1, EACH / n)
    doubtful = [gain for gain, limit in limits.items() if problem.taxels or answer[gain] > limit]
    if not doubtful:
        return []
    found: list[Evidence] = []
    for gain in doubtful:
        # Vision in its tail costs less than its squared residuals.
        if chi2 > limits[gain] or gain == "prior_gain":
            found.append(_worst(problem, answer, used) if gain == "gain" else BY_GAIN[gain])
    return [*found, "weight", "skin"]


def prior_freedom(problem: Problem, rows: int) -> int:
    """Returns the degrees of freedom of the prior against so many rows."""
    return max(min(6 - len(problem.model.symmetries.axes), rows), 1)


def _found(problem: Problem, answer: np.void, used: Mask) -> tuple[Conflict, ...]:
    """Returns what contradicts the rest, the least probable one first, the next ones without those before."""
    found: list[Conflict] = []
    while len(found) < MOST_CONFLICTS:
        best: Without | None = None
        for evidence in _suspects(problem, answer, used):
            without = _against(problem, used, evidence, answer)
            if without is None:
                continue
            p_value = without.conflict.p_value
            level = EACH / int(used.sum()) if isinstance(evidence, int) else KIND
            if p_value < level and (best is None or p_value < best.conflict.p_value):
                best = without
        if best is None:
            break
        conflict, problem, used, answer = best
        found.append(conflict)
    return tuple(found)


class Without(NamedTuple):
    """What remains without some evidence, and its conflict with that."""

    conflict: Conflict
    problem: Problem
    used: Mask
    answer: np.void


def _against(problem: Problem, used: Mask, evidence: Evidence, answer: np.void) -> Without | None:
    """Returns the conflict of some evidence with the rest, from the ANSWER with it; None where there is none of it, or
    no contact beside it."""
    others, kept = _without(problem, used, evidence)
    if not _freedom(problem, used, evidence, answer) or not kept.any():
        return None
    other, offsets = descended(others, kept, answer["pose"])
    if evidence == "vision" and problem.vision is not None:
        fall = _innovation(problem.model, problem.vision, other)
    else:
        fall = _fall(problem, evidence, answer, other)
    conflict = _conflict(problem, used, evidence, fall, answer, offsets, rest=other)
    return Without(conflict, others, kept, other)


def _innovation(model: ObjectModel, vision: PosePrior, rest: np.void) -> float:
    """Returns rᵀ (R + P)⁻¹ r of vision's pose and that of the rest, the ANSWER without it.

    With R⁻¹ = L and P⁻¹ = H that is rᵀ (L - L (L + H)⁻¹ L) r, as the rest may leave directions open. The residuals r
    are the shift of the object's middle and the turn. No sigma counts as less than 1e-5 of the object's radius, as in
    the solver.
    """
    middle = model.center_object
    T = poses_of(rest)
    T_vision = model.nearest(vision.T_palm_object[None], T)[0]
    seen = GaussianPose(T_vision, vision.covariance).at_point(middle)
    arm = T[:3, :3] @ middle
    r = se3.difference(seen.T_a_b, se3.compose(T[:3, :3], T[:3, 3] + arm))
    to_origin = se3.point_jacobian(-arm)
    least = 1e-5 * np.repeat([model.radius, 1.0], 3)
    L = np.linalg.inv(seen.covariance + np.diag(least**2))
    H = to_origin.T @ rest["information"] @ to_origin
    Lr = L @ r
    return float(r @ Lr - Lr @ np.linalg.solve(L + H, Lr))


def _fall(problem: Problem, evidence: Evidence, answer: np.void, other: np.void) -> float:
    """Returns by how much χ² falls from one ANSWER to that without some evidence."""
    if problem.registered:
        cost = "cost"
    elif isinstance(evidence, int) or evidence == "skin":
        cost = "chi2"
    else:  # the same contacts, so that the log determinants of their covariances can be compared
        cost = "posterior_cost"
    return float(answer[cost] - other[cost])


def _worst(problem: Problem, answer: np.void, used: Mask) -> int:
    """Returns the contact without which χ² falls most, to first order."""
    arguments = problem.arguments(used)
    there = np.zeros(1, dtype=records.ANSWER)
    there["pose"] = answer["pose"]
    there["first_order"] = True
    batch.summarize_all(*arguments, there)
    contacts = arguments[2][0]
    return int(np.where(used[0], contacts["gain"], 0.0).argmax())


def _freedom(problem: Problem, used: Mask, evidence: Evidence, answer: np.void) -> int:
    """Returns the degrees of freedom of evidence against the rest, at the ANSWER with it; 0 where there is none of it,
    or no rest."""
    if isinstance(evidence, int):
        return int(problem.rows_each[evidence])
    if evidence == "vision":
        return 0 if problem.blind else prior_freedom(problem, problem.freedom(used))
    if evidence == "weight":
        return 0 if problem.weight is None else 3
    if evidence == "skin":
        first = used.size - problem.taxels
        return int(used[0, first:] @ problem.rows_each[first:])
    # Evidence of one side has as many as it has rows that are active.
    return int(answer["walls"])


def _without(problem: Problem, used: Mask, evidence: Evidence) -> tuple[Problem, Mask]:
    """Returns the problem and its contacts in use (1, n) without some evidence."""
    if evidence == "vision":
        return replace(problem, vision=None), used
    if evidence == "weight":
        return replace(problem, weight=None), used
    if evidence == "outside":
        return replace(problem, outside=NO_OUTSIDE), used
    used = used.copy()
    if isinstance(evidence, int):
        used[0, evidence] = False
    else:
        used[0, used.size - problem.taxels :] = False
    return problem, used


def descended(problem: Problem, used: Mask, start: np.void) -> tuple[np.void, Array]:
    """Returns the ANSWER of a descent from a POSE on the fine field, and the residuals (n, 2) there."""
    if problem.registered:
        contacts = problem.contacts.select(np.flatnonzero(used[0]))
        T = se3.compose(start["rotation"], start["position"])
        row = registered(replace(problem, contacts=contacts), T).row
        return row, residuals(problem, row["T_palm_object"])
    rows = np.zeros(1, dtype=records.PROBLEM)
    found = np.empty((used.size, 2))
    row = rows[0]
    contacts = problem.sets(used)[0]
    constraints = problem.constraints.copy()
    row["follows"] = True
    row["start"] = start
    if problem.blind:  # of equivalent poses the one nearest to the start is the answer
        constraints["prior"]["pose"] = row["start"]
    batch.correct(*problem.model.record[:2], contacts, constraints, problem.outside, rows, found)
    return row["answer"], found


def _conflict(
    problem: Problem,
    used: Mask,
    evidence: Evidence,
    fall: float,
    answer: np.void,
    offsets: Array,
    rest: np.void | None = None,
) -> Conflict:
    """Returns the conflict of some evidence with the rest, without which χ² is smaller by `fall`.

    `rest`: the ANSWER without it, None: `answer` itself; `offsets` (n, 2): the contacts' residuals there. `problem`,
    `used` (1, n) and `answer` are with the evidence.
    """
    name = str(evidence)
    offset = NOWHERE
    others = "contacts"
    T = poses_of(answer if rest is None else rest)
    if isinstance(evidence, int):
        name = f"contact {evidence}"
        offset = offsets[evidence]
        others = "other contacts"
    elif evidence == "vision" and problem.vision is not None:
        offset = se3.difference(T, problem.vision.T_palm_object)
    elif evidence == "weight" and problem.weight is not None:
        center = se3.apply(T, problem.weight.center_object[None])[0]
        offset = center - problem.weight.center_palm
    kinds = [kind for kind in KINDS if kind != evidence and _freedom(problem, used, kind, answer)]
    against = ", ".join([others, *kinds])
    fall = max(fall, 0.0)
    freedom = _freedom(problem, used, evidence, answer)
    return Conflict(name, against, fall, freedom, modes.chi2_survival(fall, freedom), offset)
