"""The public door of correction: one function for every method, and one for many problems."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import outliers, paper, starts
from handsight.correction.depth import DepthPoints
from handsight.correction.estimate import PoseEstimate, PosePrior, Vision, checked_prior
from handsight.correction.mean import checked_answer, mean_by_sampling, with_means
from handsight.correction.outside import NO_OUTSIDE, NO_POINTS, Outside, outside_records
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import MOST_CONTACTS, Budget, Problem, TwoPhase, check_number, descents_at
from handsight.correction.skin import SkinEvidence
from handsight.correction.solve import solve_batch, solve_single_start, summarize, summarize_pose
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

USUAL = TwoPhase()
MOST_SAMPLES = 1_000_000
"""So many take ten seconds and a hundred megabytes."""
METHODS: dict[str, TwoPhase | PaperMethod] = {
    "handsight": USUAL,
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
    answer: str = "best",
    samples: int = 0,
    budget: float | None = None,
    weight: WeightEvidence | None = None,
    depth: DepthPoints | None = None,
    skin: SkinEvidence | None = None,
    method: str | TwoPhase | PaperMethod = "handsight",
) -> PoseEstimate:
    """Returns the object's pose in the palm that best explains the contacts and vision, with its uncertainty.

    contacts: fingertip contacts in the palm frame.
    vision: the object's pose in the palm with its covariance, as a `PosePrior`, a `PoseMeasurement` in the palm or a
    `GaussianPose`; None: without vision.
    outside: (m, 3) points [m] of the hand's surface in the palm frame, none of which can be inside the object; or an
    `Outside` of such points and of planes that the object cannot cross.
    answer: "best" is the mean of a mode that is not Gaussian, such as along a flat direction that contacts bound and do
    not fix, and else the maximum; or "maximum", or "mean".
    samples: above 0, the best mode's mean and covariance from that many posterior samples instead, up to
    `MOST_SAMPLES`: slow, and an independent check.
    budget: seconds after which no search for a better mode or a wrong contact goes on; `converged` is False where one
    was cut short.
    weight: where the object's centre of mass is; left out where all other evidence contradicts it, and then
    `weight_fits` is False.
    depth: points of a depth image that lie on the object, in place of the pose that the image gave.
    skin: the taxels of tactile arrays. The pressed ones follow the contacts in `residuals` and `outliers`.
    method: a name of `METHODS`, or its options as a value.

    Raises InvalidInput where an input is wrong; a solver that does not converge says so in `converged`.
    """
    options = _method(method)
    if not isinstance(model, ObjectModel) or not isinstance(contacts, Contacts):
        raise InvalidInput(
            "correct_pose: expected an ObjectModel and Contacts, "
            f"got {type(model).__name__} and {type(contacts).__name__}"
        )
    prior = checked_prior(vision)
    samples, answer = checks.integer(samples, "samples", MOST_SAMPLES), checked_answer(answer)
    limit = Budget.of(budget)
    problem, skin = _problem(model, contacts, prior, outside, weight, depth, skin)
    if isinstance(options, PaperMethod):
        return _by_paper(problem, options)
    solved = partial(_solved, options=options, limit=limit, answer=answer, samples=samples)
    if skin is not None and prior is not None:
        alone = replace(problem, outside=NO_OUTSIDE, weight=None)
        by_contacts = _solved(alone, options=options, limit=limit, answer="maximum", samples=0)
        problem = replace(problem, starts=starts.within_footprint(problem, by_contacts))
    estimate = solved(problem)
    estimate = estimate if problem.weight is None else _weighed(problem, estimate, solved)
    return estimate if skin is None else estimate.inflated(skin.sigmas**2)


KEYS = tuple(inspect.signature(correct_pose).parameters)[1:]
"""The arguments of `correct_pose` that a problem of `correct_poses` may have."""


def _problem(
    model: ObjectModel,
    contacts: Contacts,
    prior: PosePrior | None,
    outside: ArrayLike | Outside | None,
    weight: WeightEvidence | None,
    depth: DepthPoints | None,
    skin: SkinEvidence | None,
) -> tuple[Problem, SkinEvidence | None]:
    """Returns a correction with its inputs checked, a skin's taxels among its contacts and points, and the skin.

    Raises InvalidInput.
    """
    for name, value, kind in (
        ("weight", weight, WeightEvidence),
        ("depth", depth, DepthPoints),
        ("skin", skin, SkinEvidence),
    ):
        if value is not None and not isinstance(value, kind):
            raise InvalidInput(f"{name}: expected {kind.__name__} or None, got {type(value).__name__}")
    if skin is None and isinstance(outside, Outside) and outside.skin is not None:  # deprecated
        skin = SkinEvidence(None, NO_POINTS, np.asarray(outside.skin))
    if skin is not None and skin.contacts is not None:
        contacts = contacts.joined(skin.contacts)
    weight = None if weight is None else weight.of(model)
    rows = outside_records(model, contacts, outside, skin)
    return Problem(model, contacts, prior, rows, weight, depth), skin


def _solved(problem: Problem, *, options: TwoPhase, limit: Budget, answer: str, samples: int) -> PoseEstimate:
    """Returns the answer to a problem: from one start where that is enough, else from many."""
    if options is USUAL and not samples and problem.starts is None:
        estimate = solve_single_start(problem)
        if estimate is not None:
            return with_means(problem, estimate, answer)
    found = outliers.solve_robustly(problem, options, limit)
    estimate = summarize(problem, found)
    if limit.cut_short:
        estimate.answer["converged"] = False
    if samples:
        return mean_by_sampling(problem, estimate, found.used, samples)
    return with_means(problem, estimate, answer)


def refine_pose(
    model: ObjectModel,
    contacts: Contacts,
    vision: PosePrior,
    T_start: Array,
    *,
    outside: Outside | None = None,
    answer: str = "best",
    weight: WeightEvidence | None = None,
    depth: DepthPoints | None = None,
    skin: SkinEvidence | None = None,
) -> PoseEstimate | None:
    """Returns the answer of `correct_pose` where it descends from a pose that was right a moment ago, and from there
    alone.

    None where the evidence does not fit there: then search anew. `T_start` (4, 4): the maximum of a moment ago, not a
    mean, which may fit nowhere.
    """
    problem, skin = _problem(model, contacts, vision, outside, weight, depth, skin)
    estimate = solve_single_start(problem, T_start)
    if estimate is None or (problem.weight is not None and problem.weight.contradicts(estimate)):
        return None
    estimate = with_means(problem, estimate, checked_answer(answer))
    estimate = estimate if skin is None else estimate.inflated(skin.sigmas**2)
    return estimate if weight is None else replace(estimate, weight_fits=True)


def _weighed(
    problem: Problem, estimate: PoseEstimate, solved: Callable[[Problem], PoseEstimate]
) -> PoseEstimate:
    """Returns the estimate, or, where all other evidence contradicts the weight, the answer without it."""
    weight = problem.weight
    if weight is None or (estimate.consistent and not weight.contradicts(estimate)):
        return replace(estimate, weight_fits=True)
    without = solved(replace(problem, weight=None))
    if not estimate.consistent and not without.consistent and not weight.contradicts(estimate):
        return replace(estimate, weight_fits=True)  # it is not the weight that does not fit
    return replace(without, weight_fits=False)


def _method(method: str | TwoPhase | PaperMethod) -> TwoPhase | PaperMethod:
    if isinstance(method, TwoPhase | PaperMethod):
        return method
    if not isinstance(method, str) or method not in METHODS:
        raise InvalidInput(f"method: expected one of {', '.join(METHODS)}, got {checks.brief(method)!r}")
    return METHODS[method]


def _by_paper(problem: Problem, options: PaperMethod) -> PoseEstimate:
    """Returns the published method's pose, with the uncertainty that our evidence has there."""
    model, contacts = problem.model, problem.contacts
    for name, value in (("weight", problem.weight), ("depth", problem.depth)):
        if value is not None:
            came = f"got {type(value).__name__}"
            raise InvalidInput(f"{name}: expected None, for the paper's method knows of none, {came}")
    if problem.vision is None:
        raise InvalidInput("vision: the paper's method starts from a pose, got None")
    if options.normals and not contacts.has_normal.all():
        raise InvalidInput(
            "contacts: the paper's method with normals needs one for each, got contacts without "
            "(paper-lm-distance and paper-gd-distance need none)"
        )
    T = problem.vision.T_palm_object
    points_object, normals_object = model.sample(options.cloud_size)
    # The paper turns about the frame's origin; with that in the object's middle its step sizes do not depend on
    # where the palm's frame happens to be.
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
    """Returns the estimates of many problems of one object, in their order: `correct_pose` of each, on all cores.

    A problem is a mapping of `correct_pose`'s arguments by name (`contacts`, `vision`, `outside`, `answer`, `samples`,
    `budget`, `weight`, `depth`, `skin`, `method`), a pair `(contacts, vision)`, or contacts alone, without vision.
    Raises InvalidInput naming the problem, `problems[3].vision: ...`, before any is solved.
    """
    if not isinstance(model, ObjectModel):
        raise InvalidInput(f"model: expected an ObjectModel, got {type(model).__name__}")
    if isinstance(problems, Contacts | Mapping) or not isinstance(problems, Iterable):
        raise InvalidInput(f"problems: expected a sequence of problems, got {type(problems).__name__}")
    each = [_arguments(problem, f"problems[{i}]") for i, problem in enumerate(problems)]
    found: list[PoseEstimate | None] = [None] * len(each)
    usual = [i for i, problem in enumerate(each) if set(problem) == {"contacts", "vision"}]
    at_once = 4096  # problems in one call of the kernels
    for begin in range(0, len(usual), at_once):
        rows = usual[begin : begin + at_once]
        pairs = [(each[i]["contacts"], each[i]["vision"]) for i in rows]
        for i, pair, estimate in zip(rows, pairs, solve_batch(model, pairs), strict=True):
            if estimate is not None:
                found[i] = with_means(Problem(model, *pair, NO_OUTSIDE), estimate, "best")
    answers = []
    for i, (problem, estimate) in enumerate(zip(each, found, strict=True)):
        try:
            answers.append(correct_pose(model, **problem) if estimate is None else estimate)
        except InvalidInput as error:
            raise InvalidInput(f"problems[{i}]: {error}") from None
    return answers


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
