"""The functions that correct a pose: `correct_pose`, `correct_poses` for many problems, and `refine_pose` for tracking.

They check their arguments, choose how a problem is solved, and take the weight and the skin into account. The search
itself is in `solve.py` (from one start or many) and `outliers.py` (wrong contacts).
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import conflicts, modes, outliers, paper, solve
from handsight.correction.estimate import NORMALS, Conflict, PoseEstimate, PosePrior, Vision, checked_prior
from handsight.correction.few_contacts import may_draw
from handsight.correction.mean import after_draws, known_information, merged, with_means, with_weights
from handsight.correction.open_draws import FIRST_DRAWS, MORE_DRAWS, draw
from handsight.correction.outside import NO_OUTSIDE, Outside, outside_records
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import (
    MOST_CONTACTS,
    Problem,
    check_number,
    descents_at,
    is_registered,
)
from handsight.correction.registration import register
from handsight.correction.skin import SkinEvidence
from handsight.correction.solve import solve_usual, summarize, summarize_pose
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

LEAST_SIGNS = 3
"""Normals that are too few to say that all are negated."""
METHODS: dict[str, PaperMethod | None] = {
    "handsight": None,
    "paper-lm": PaperMethod(optimizer="lm"),
    "paper-gd": PaperMethod(optimizer="gd"),
    "paper-lm-distance": PaperMethod(optimizer="lm", normals=False),
    "paper-gd-distance": PaperMethod(optimizer="gd", normals=False),
}


def correct_pose(
    model: ObjectModel,
    contacts: Contacts,
    *,
    vision: Vision | None = None,
    outside: ArrayLike | Outside | None = None,
    weight: WeightEvidence | None = None,
    skin: SkinEvidence | None = None,
    method: str | PaperMethod = "handsight",
) -> PoseEstimate:
    """Returns the object's pose in the palm that best explains the contacts and vision, with its uncertainty.

    Its `T_palm_object` is the maximum of the posterior density, or the mean of a mode that is not Gaussian, such as a
    slide that ends at edges but is not fixed between them; its `T_palm_object_maximum` is the maximum in any case.
    All lengths are in metres and all times in seconds. A wrong argument raises InvalidInput, which names it. A solver
    that does not converge returns an estimate whose `converged` is False.

    model: the object's surface and its symmetries, an `ObjectModel`.

    contacts: from 1 to 20 000 `Contacts` in the palm frame: points, the object's outward normals where they are known,
    their covariances, and the errors that groups of them share. More than 64, or any that share errors, are registered:
    a few of them lead the search, then all count, however many are wrong up to a third; the answer is the maximum, and
    `consistent` allows variances that are twice the declared ones, by which the covariance is then larger too.

    vision: the object's pose in the palm with its covariance, as a `PosePrior`, a `PoseMeasurement` in the palm frame
    or a `GaussianPose`. Along directions that the contacts leave open the answer is this pose's. Default None: there is
    no such pose, and the whole surface is tried at the contacts, which takes longer; several `hypotheses` may remain.

    outside: what cannot be inside the object: points (m, 3) of the hand's surface in the palm frame, or an `Outside`,
    which also takes planes, such as the table, and each point's standard deviation (else 1.5 times that of the median
    contact). Use it where poses that fit the contacts would cut through the hand or the table. Points have no effect on
    a model without an inside. Default None.

    weight: the centre of mass in the object, and in the palm as measured by the loads on the fingertips, as
    `WeightEvidence`. Use it while the hand alone carries the object. If all other evidence contradicts it, it is left
    out and `weight_fits` is False. Default None.

    skin: pressed and untouched taxels of tactile arrays, as `SkinEvidence`. Pressed taxels are contacts, and follow
    `contacts` in `residuals` and `outliers`. The array's common error is added to the covariance. Default None.

    method: "handsight" (default). For comparison, the methods of the IROS 2013 paper: "paper-lm", "paper-gd",
    "paper-lm-distance" and "paper-gd-distance" (the latter two without normals), or a `PaperMethod`. They start from
    `vision`, which they need, and take no `weight`.
    """
    papers = _method(method)
    if not isinstance(model, ObjectModel) or not isinstance(contacts, Contacts):
        raise InvalidInput(
            "correct_pose: expected an ObjectModel and Contacts, "
            f"got {type(model).__name__} and {type(contacts).__name__}"
        )
    prior = checked_prior(vision)
    usual = papers is None and weight is None and skin is None
    if prior is not None and usual and not is_registered(contacts):
        rows = outside_records(model, contacts, outside)
        estimate, enough = solve_usual(model, contacts, prior.record, rows, mean=True)
        if estimate is not None and enough:
            return estimate
        problem = Problem(model, contacts, prior, rows)
        final = estimate is None or not may_draw(problem)
        if estimate is not None and final and _fits(problem, estimate):
            return estimate
        estimate = corrected(replace(problem, doubted=final), None)
        return _with_signs(problem, estimate)
    problem, skin = problem_of(model, contacts, prior, outside, weight, skin)
    if papers is None:
        return _with_signs(problem, corrected(problem, skin))
    estimate = _by_paper(problem, papers)
    return estimate if skin is None else estimate.inflated(skin.sigmas**2)


def _with_signs(problem: Problem, estimate: PoseEstimate) -> PoseEstimate:
    """Returns the estimate, with a conflict where the evidence fits with all normals of contacts negated, as where a
    sensor reports the direction of its own force, and does not as given."""
    contacts = problem.contacts
    if estimate.consistent or problem.on_skin or contacts.has_normal.sum() < LEAST_SIGNS:
        return estimate
    other = corrected(replace(problem, contacts=contacts.negated()), None)
    if not other.consistent:
        return estimate
    fall = max(float(estimate.answer["chi2"] - other.answer["chi2"]), 0.0)
    freedom = 2 * int(contacts.has_normal.sum())
    against = "their points and the rest"
    wrong = Conflict(NORMALS, against, fall, freedom, modes.chi2_survival(fall, freedom), np.empty(0))
    return replace(estimate, conflicts=(*estimate.conflicts, wrong))


def corrected(problem: Problem, skin: SkinEvidence | None) -> PoseEstimate:
    """Returns `correct_pose` of a problem and its skin, by handsight's own method."""
    estimate = _searched(problem)
    if problem.weight is not None:
        estimate = _weighed(problem, problem.weight, estimate)
    return estimate if skin is None else estimate.inflated(skin.sigmas**2)


KEYS = tuple(inspect.signature(correct_pose).parameters)[1:]
"""The arguments that a problem of `correct_poses` may have: all of `correct_pose` but the model."""


def problem_of(
    model: ObjectModel,
    contacts: Contacts,
    prior: PosePrior | None,
    outside: ArrayLike | Outside | None = None,
    weight: WeightEvidence | None = None,
    skin: SkinEvidence | None = None,
) -> tuple[Problem, SkinEvidence | None]:
    """Returns the problem of checked inputs, and its skin; raises InvalidInput.

    The skin's pressed taxels are among the problem's contacts, its untouched ones among the points outside.
    """
    for name, value, kind in (("weight", weight, WeightEvidence), ("skin", skin, SkinEvidence)):
        if value is not None and not isinstance(value, kind):
            raise InvalidInput(f"{name}: expected {kind.__name__} or None, got {type(value).__name__}")
    taxels = 0
    if skin is not None and skin.contacts is not None:
        taxels = len(skin.contacts)
        contacts = contacts.joined(skin.contacts)
    weight = None if weight is None else weight.of(model)
    rows = outside_records(model, contacts, outside, skin)
    return Problem(model, contacts, prior, rows, weight, taxels, skin is not None), skin


def _searched(problem: Problem, *, means: bool = True, first: int = FIRST_DRAWS) -> PoseEstimate:
    """Returns the answer to a problem, from one start where that is enough, else from many; on a tactile array the mean
    of draws, of which `first` are from what the contacts leave open. Without `means`: the maximum in any case."""
    drawn = None
    if problem.on_skin and len(problem.outside) and not problem.blind:
        by_contacts = replace(problem, outside=NO_OUTSIDE, weight=None, on_skin=False)
        alone = _searched(by_contacts, means=False)
        drawn = draw(problem, alone.T_palm_object_maximum, alone.information, first)
        problem = replace(problem, starts=drawn[0])
    if problem.registered:
        return _registered(problem)
    integrated = means and not may_draw(problem)
    if problem.starts is None and not problem.doubted:
        estimate = solve_single_start(problem, mean=integrated)
        if estimate is not None:
            return after_draws(problem, estimate) if means else estimate
    found = outliers.solve_robustly(problem)
    averaged = drawn if means and found.used.all() else None
    rows = summarize(problem, found, mean=integrated and averaged is None)
    if averaged is None:
        estimate = with_means(problem, rows, found.used, means=means)
    else:
        _, T, C = averaged
        estimate = with_means(problem, rows[:1], found.used, means=False)
        known = known_information(problem.model, T, C)
        complete = C if estimate.answer["complete"] else None
        estimate = estimate.with_gaussian(T, complete, known, solve.residuals(problem, T))
        if not estimate.consistent and first < MORE_DRAWS:
            other = _searched(problem, means=means, first=MORE_DRAWS)
            return other if other.answer["chi2"] < estimate.answer["chi2"] else estimate
    left_out = tuple(conflicts.contact_left_out(problem, estimate, i) for i in estimate.outliers)
    return replace(estimate, conflicts=(*estimate.conflicts, *left_out))


def solve_single_start(
    problem: Problem, T_start: Array | None = None, *, mean: bool = False
) -> PoseEstimate | None:
    """Returns the answer of one descent from vision's own pose; None where one start may not be enough, or where the
    evidence does not fit at its end.

    `T_start` (4, 4): a pose that was right a moment ago, at which the descent starts instead, however wide the prior.
    `mean`: whether a mode that is not Gaussian becomes its mean.
    """
    if problem.vision is None:
        return None
    estimate, enough = solve_usual(
        problem.model, problem.contacts, problem.constraints, problem.outside, mean, T_start
    )
    enough = enough and not problem.taxels
    return estimate if estimate is None or enough or _fits(problem, estimate) else None


def _fits(problem: Problem, estimate: PoseEstimate) -> bool:
    """Returns whether no evidence contradicts the rest at an estimate with all contacts in use."""
    return conflicts.judged(problem, estimate.answer, problem.everyone)[0]


def _registered(problem: Problem) -> PoseEstimate:
    """Returns the answer to a problem of many contacts, or of contacts that share errors."""
    found = register(problem)
    best = found[0]
    rows = with_weights(merged(problem, np.array([each.row for each in found])))
    consistent, contradictions = conflicts.of_registered(problem, best)
    wrong = tuple(np.flatnonzero(best.wrong(problem.contacts)).tolist())
    residuals = solve.residuals(problem, rows["T_palm_object"][0])
    return PoseEstimate(rows, residuals, consistent, wrong, conflicts=contradictions)


def refine_pose(
    model: ObjectModel,
    contacts: Contacts,
    vision: PosePrior,
    T_start: Array,
    *,
    outside: Outside | None = None,
    weight: WeightEvidence | None = None,
    skin: SkinEvidence | None = None,
) -> PoseEstimate | None:
    """Returns the answer of a descent from one pose that was right a moment ago; None where the evidence does not fit
    there, and `correct_pose` has to search.

    `T_start` (4, 4): the last estimate's `T_palm_object_maximum`, not its mean, at which the evidence may not fit. The
    other arguments are those of `correct_pose`. Raises InvalidInput.
    """
    problem, skin = problem_of(model, contacts, vision, outside, weight, skin)
    return refined(problem, skin, np.asarray(T_start))


def refined(problem: Problem, skin: SkinEvidence | None, T_start: Array) -> PoseEstimate | None:
    """Returns `refine_pose` of a problem and its skin."""
    estimate: PoseEstimate | None
    if problem.registered:
        estimate = _registered(replace(problem, starts=T_start[None]))
        fits = estimate.consistent
    else:
        estimate = solve_single_start(problem, T_start, mean=True)
        fits = estimate is not None
    if estimate is None or not fits:
        return None
    if problem.weight is not None:
        if problem.weight.contradicts(estimate):
            return None
        estimate = replace(estimate, weight_fits=True)
    return estimate if skin is None else estimate.inflated(skin.sigmas**2)


def _weighed(problem: Problem, weight: WeightEvidence, estimate: PoseEstimate) -> PoseEstimate:
    """Returns the estimate, or, where all other evidence contradicts the weight, the answer without it."""
    contradicted = weight.contradicts(estimate)
    with_weight = replace(estimate, weight_fits=True)
    if estimate.consistent and not contradicted:
        return with_weight
    without = _searched(replace(problem, weight=None))
    named, others = ({c.evidence for c in e.conflicts if not c.excluded} for e in (estimate, without))
    elsewhere = not estimate.consistent and not without.consistent
    # Something else is inconsistent, with the weight and without; it may also pull the pose away from the weight.
    if elsewhere and (not contradicted or (named == others and named and "weight" not in named)):
        return with_weight
    fall = float(estimate.answer["chi2"] - without.answer["chi2"])
    wrong = conflicts.weight_left_out(problem, without, fall)
    return replace(without, weight_fits=False, conflicts=(*without.conflicts, wrong))


def _method(method: str | PaperMethod) -> PaperMethod | None:
    """Returns the paper's method by its name, None for handsight's own; raises InvalidInput."""
    if isinstance(method, PaperMethod):
        return method
    if not isinstance(method, str) or method not in METHODS:
        raise InvalidInput(f"method: expected one of {', '.join(METHODS)}, got {checks.brief(method)!r}")
    return METHODS[method]


def _by_paper(problem: Problem, options: PaperMethod) -> PoseEstimate:
    """Returns the pose by the paper's method, with the uncertainty of handsight's own evidence at it."""
    model, contacts = problem.model, problem.contacts
    if problem.weight is not None:
        raise InvalidInput("weight: expected None, as the paper's method does not use it, got WeightEvidence")
    if problem.vision is None:
        raise InvalidInput("vision: the paper's method starts from a pose, got None")
    if options.normals and not contacts.has_normal.all():
        raise InvalidInput(
            "contacts: the paper's method with normals needs one for each contact, got contacts without "
            "(paper-lm-distance and paper-gd-distance need no normals)"
        )
    T = problem.vision.T_palm_object
    points_object, normals_object = model.sample(options.cloud_size)
    # The paper turns about the frame's origin. With the origin in the middle of the object, its step sizes do not
    # depend on where the palm's frame is.
    T_palm_middle = se3.compose(np.eye(3), se3.apply(T, model.center_object[None])[0])
    middle = T_palm_middle[:3, 3]
    answer = paper.correct(
        contacts.points_palm - middle,
        contacts.normals_palm if options.normals else None,
        se3.apply(T, points_object) - middle,
        normals_object @ T[:3, :3].T,
        options,
    )
    T = T_palm_middle @ answer.T_new_old @ se3.inverse(T_palm_middle) @ T
    minimum = descents_at(T[None])
    minimum["converged"], minimum["iterations"] = answer.converged, answer.iterations
    return summarize_pose(problem, minimum)


def correct_poses(model: ObjectModel, problems: Iterable[object]) -> list[PoseEstimate]:
    """Returns the estimates of `correct_pose` for many problems of one object, in their order, computed on all cores.

    A problem is a mapping of `correct_pose`'s arguments by name (`contacts`, `vision`, `outside`, `weight`, `skin`,
    `method`), a pair `(contacts, vision)`, or contacts alone, without vision. Raises InvalidInput that names the
    problem, such as `problems[3].vision: ...`; wrong contacts and vision are found before any problem is solved.
    """
    if not isinstance(model, ObjectModel):
        raise InvalidInput(f"model: expected an ObjectModel, got {type(model).__name__}")
    if isinstance(problems, Contacts | Mapping) or not isinstance(problems, Iterable):
        raise InvalidInput(f"problems: expected a sequence of problems, got {type(problems).__name__}")
    each = [_arguments(problem, f"problems[{i}]") for i, problem in enumerate(problems)]

    def answered(i: int) -> PoseEstimate:
        try:
            return correct_pose(model, **each[i])
        except InvalidInput as error:
            raise InvalidInput(f"problems[{i}]: {error}") from None

    # A thread takes many problems at a time, as handing over one takes longer than solving it.
    threads = os.cpu_count() or 1
    shares = [range(first, min(first + 64, len(each))) for first in range(0, len(each), 64)]
    with ThreadPoolExecutor(threads) as pool:
        found = pool.map(lambda share: [answered(i) for i in share], shares)
        return [estimate for share in found for estimate in share]


def _arguments(problem: object, name: str) -> dict[str, Any]:
    """Returns the arguments of `correct_pose` by name, without those that are None; raises InvalidInput."""
    if isinstance(problem, Contacts):
        given: dict[str, Any] = {"contacts": problem}
    elif isinstance(problem, Mapping):
        given = dict(problem)
    elif isinstance(problem, tuple | list) and len(problem) == 2:
        given = {"contacts": problem[0], "vision": problem[1]}
    else:
        expected = "expected a mapping, (contacts, vision) or Contacts"
        raise InvalidInput(f"{name}: {expected}, got {type(problem).__name__}")
    for key in given:
        if key not in KEYS:
            raise InvalidInput(f"{name}: expected {', '.join(KEYS)}, got {key!r}")
    contacts = given.get("contacts")
    if not isinstance(contacts, Contacts):
        raise InvalidInput(f"{name}.contacts: expected Contacts, got {type(contacts).__name__}")
    check_number(len(contacts), MOST_CONTACTS, f"{name}.contacts", "contacts")
    given["vision"] = checked_prior(given.get("vision"), f"{name}.vision")
    return {key: value for key, value in given.items() if value is not None}
