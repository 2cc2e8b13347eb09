"""The public door of correction: one function for every method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import outliers, paper
from handsight.correction.budget import Budget
from handsight.correction.estimate import PoseEstimate, PosePrior, Vision, checked_prior
from handsight.correction.footprint import less_certain, likely_starts
from handsight.correction.mean import checked_answer, with_means
from handsight.correction.outside import NO_OUTSIDE, Outside, outside_records
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import Problem, TwoPhase, descents_at
from handsight.correction.sampling import mean_by_sampling
from handsight.correction.solve import solve_single_start, summarize, summarize_pose
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

USUAL = TwoPhase()
MOST_SAMPLES = 1_000_000
"""They take ten seconds and a hundred megabytes."""
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
    method: str | TwoPhase | PaperMethod = "handsight",
) -> PoseEstimate:
    """Returns the object's pose in the palm that best explains the contacts and vision, with its uncertainty.

    contacts: fingertip contacts in the palm frame. vision: the object's pose in the palm with its covariance, as a
    `PosePrior`, a `PoseMeasurement` in the palm or a `GaussianPose`; None: without vision.
    outside: (m, 3) points [m] of the hand's surface in the palm frame, none of which can be inside the object; or an
    `Outside` of such points and of planes that the object cannot cross.
    answer: "best" is the mean of a mode that is no Gaussian, such as a slide that contacts bound and do not fix, and
    else the maximum; or "maximum", or "mean". samples: above 0, the best mode's mean and covariance from that many
    posterior samples instead, up to `MOST_SAMPLES`: slow, and an independent check. budget: seconds after which no
    search for a better mode or a wrong contact goes on; `converged` is False where one was cut short. weight: where
    the object's centre of mass is; left out where all else contradicts it, and then `weight_fits` is False. method: a
    name of `METHODS`, or its options as a value. Raises InvalidInput where an input is wrong; a solver that does not
    converge says so in `converged`.
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
    problem = Problem(
        model, contacts, prior, outside_records(model, contacts, outside), _weight(weight, model)
    )
    if isinstance(options, PaperMethod):
        return _by_paper(problem, options)
    solved = partial(_solved, options=options, limit=limit, answer=answer, samples=samples)
    if prior is not None and isinstance(outside, Outside) and outside.skin is not None:
        problem = replace(problem, starts=_array_starts(problem, options, limit))
    estimate = solved(problem)
    estimate = estimate if problem.weight is None else _weighed(problem, estimate, solved)
    return less_certain(estimate, outside)


def _solved(problem: Problem, *, options: TwoPhase, limit: Budget, answer: str, samples: int) -> PoseEstimate:
    """Returns the answer to a problem: from one start where that does, else from many."""
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
) -> PoseEstimate | None:
    """Returns what `correct_pose` answers where it descends from a pose that was right a moment ago, and from there
    alone.

    None where the evidence does not fit there: then search anew. `T_start` (4, 4): the maximum of a moment ago, not a
    mean, which may fit nowhere.
    """
    problem = Problem(
        model, contacts, vision, outside_records(model, contacts, outside), _weight(weight, model)
    )
    estimate = solve_single_start(problem, T_start)
    if estimate is None or (problem.weight is not None and problem.weight.contradicts(estimate)):
        return None
    estimate = less_certain(with_means(problem, estimate, checked_answer(answer)), outside)
    return estimate if weight is None else replace(estimate, weight_fits=True)


def _array_starts(problem: Problem, options: TwoPhase, limit: Budget) -> Array:
    """Returns (K, 4, 4) poses to begin from where an array of taxels says how far faces reach."""
    alone = replace(problem, outside=NO_OUTSIDE, weight=None)
    by_contacts = _solved(alone, options=options, limit=limit, answer="maximum", samples=0)
    return likely_starts(problem, by_contacts)


def _weight(weight: WeightEvidence | None, model: ObjectModel) -> WeightEvidence | None:
    if not isinstance(weight, WeightEvidence | None):
        raise InvalidInput(f"weight: expected WeightEvidence or None, got {type(weight).__name__}")
    return None if weight is None else weight.of(model)


def _weighed(
    problem: Problem, estimate: PoseEstimate, solved: Callable[[Problem], PoseEstimate]
) -> PoseEstimate:
    """Returns the estimate with its weight, or, where all else contradicts that, without."""
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
    """Returns the published method's pose; the uncertainty beside it is ours, taken at that pose."""
    model, contacts = problem.model, problem.contacts
    if problem.weight is not None:
        raise InvalidInput("weight: expected None, for the paper's method knows of none, got WeightEvidence")
    if problem.vision is None:
        raise InvalidInput("vision: the paper's method starts from a pose, got None")
    if options.normals and not contacts.has_normal.all():
        raise InvalidInput(
            "contacts: the paper's method with normals needs one for each, got contacts without "
            "(paper-lm-distance and paper-gd-distance need none)"
        )
    T = problem.vision.T_palm_object
    points_object, normals_object = model.sample(options.cloud_size)
    # The paper turns about the frame's origin; laid in the object's middle, its step sizes do not depend on
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
