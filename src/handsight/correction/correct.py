"""The functions that correct a pose: `correct_pose`, `correct_poses` for many problems, and `refine_pose` for tracking.

They check their arguments, choose how a problem is solved, and take the weight and the skin into account. The search
itself is in `solve.py` (from one start or many) and `outliers.py` (wrong contacts).
"""

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
from handsight.correction import conflicts, outliers, paper, solve
from handsight.correction.depth import DepthPoints
from handsight.correction.estimate import PoseEstimate, PosePrior, Vision, checked_prior
from handsight.correction.mean import (
    KINDS,
    after_draws,
    checked_answer,
    kind_of,
    known_information,
    mean_by_sampling,
    with_means,
)
from handsight.correction.open_draws import DRAWS, draw
from handsight.correction.outside import NO_OUTSIDE, Outside, outside_records
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import (
    MOST_CONTACTS,
    Budget,
    Problem,
    Steps,
    TwoPhase,
    check_number,
    descents_at,
    finished,
)
from handsight.correction.registration import is_registered, register
from handsight.correction.skin import SkinEvidence
from handsight.correction.solve import solve_batch, solve_single_start, solve_usual, summarize, summarize_pose
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

USUAL = TwoPhase()
MOST_SAMPLES = 1_000_000
"""Posterior samples of one correction: so many take ten seconds and a hundred megabytes."""
MOST_WIDENED = 3
"""How often the prior of a correction is widened at most where the rest contradicts it."""
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

    answer: "best" (default) is the maximum of the posterior density, or the mean of a mode that is not Gaussian, such
    as a slide that ends at edges but is not fixed between them. "maximum" and "mean" always give the one or the other.

    samples: 0 (default): a mean is integrated numerically. A number above 0, up to 1 000 000: pose and covariance are
    the mean and the covariance of so many Monte Carlo samples of the best mode (at least 64), whatever `answer` is. Use
    it as an independent check: 1 000 000 take ten seconds.

    budget: time after which the search for better modes and for wrong contacts stops; `converged` is False where it
    was cut short. Use it where an answer must come in time. Default None: no limit.

    weight: the centre of mass in the object, and in the palm as measured by the loads on the fingertips, as
    `WeightEvidence`. Use it while the hand alone carries the object. If all other evidence contradicts it, it is left
    out and `weight_fits` is False. Default None.

    depth: points of a depth image on the object's surface, as `DepthPoints`. Use them in place of the pose that was
    estimated from the same image: `vision` must not be that pose too. Default None.

    skin: pressed and untouched taxels of tactile arrays, as `SkinEvidence`. Pressed taxels are contacts, and follow
    `contacts` in `residuals` and `outliers`. The array's common error is added to the covariance. Default None.

    method: "handsight" (default), or a `TwoPhase` with its options. For comparison, the methods of the IROS 2013 paper:
    "paper-lm", "paper-gd", "paper-lm-distance" and "paper-gd-distance" (the latter two without normals), or a
    `PaperMethod`. They start from `vision`, which they need, take neither `weight` nor `depth`, and do not use
    `answer`, `samples` and `budget`.
    """
    # Calls that can be spared are: after other work each is read from memory again, which takes as long as the kernel.
    options = USUAL if type(method) is str and method == "handsight" else _method(method)
    if not isinstance(model, ObjectModel) or not isinstance(contacts, Contacts):
        raise InvalidInput(
            "correct_pose: expected an ObjectModel and Contacts, "
            f"got {type(model).__name__} and {type(contacts).__name__}"
        )
    prior = vision if type(vision) is PosePrior else checked_prior(vision)
    if type(answer) is not str or answer not in KINDS:
        checked_answer(answer)
    if type(samples) is not int or samples:
        samples = checks.integer(samples, "samples", MOST_SAMPLES)
    alone = weight is None and depth is None and skin is None and budget is None
    alone = alone and (outside is None or getattr(outside, "skin", None) is None)
    if prior is not None and alone and options is USUAL and not samples and not is_registered(contacts):
        rows = NO_OUTSIDE if outside is None else outside_records(model, contacts, outside)
        estimate, enough = solve_usual(model, contacts, prior.record, rows, KINDS[answer])
        if estimate is not None and enough:
            return estimate
        problem = Problem(model, contacts, prior, rows)
        final = estimate is None or kind_of(problem, answer) == KINDS[answer]
        if estimate is not None and final and solve.fits(problem, estimate):
            return estimate
        return finished(corrected(replace(problem, doubted=final), None, answer))
    limit = Budget.of(budget)
    problem, skin = problem_of(model, contacts, prior, outside, weight, depth, skin)
    if isinstance(options, PaperMethod):
        estimate = _by_paper(problem, options)
        return estimate if skin is None else estimate.inflated(skin.sigmas**2)
    return finished(corrected(problem, skin, answer, samples, options, limit))


def corrected(
    problem: Problem,
    skin: SkinEvidence | None,
    answer: str = "best",
    samples: int = 0,
    options: TwoPhase = USUAL,
    limit: Budget | None = None,
) -> Steps[PoseEstimate]:
    """Returns `correct_pose` of a problem and its skin, by handsight's own method, in steps."""
    limit = limit or Budget()
    solved = partial(_solved, options=options, limit=limit, answer=answer, samples=samples)
    estimate = yield from solved(problem)
    if problem.weight is not None:
        estimate = yield from _weighed(problem, problem.weight, estimate, solved)
    return estimate if skin is None else estimate.inflated(skin.sigmas**2)


KEYS = tuple(inspect.signature(correct_pose).parameters)[1:]
"""The arguments that a problem of `correct_poses` may have: all of `correct_pose` but the model."""


def problem_of(
    model: ObjectModel,
    contacts: Contacts,
    prior: PosePrior | None,
    outside: ArrayLike | Outside | None = None,
    weight: WeightEvidence | None = None,
    depth: DepthPoints | None = None,
    skin: SkinEvidence | None = None,
) -> tuple[Problem, SkinEvidence | None]:
    """Returns the problem of checked inputs, and its skin; raises InvalidInput.

    The skin's pressed taxels are among the problem's contacts, its untouched ones among the points outside.
    """
    for name, value, kind in (
        ("weight", weight, WeightEvidence),
        ("depth", depth, DepthPoints),
        ("skin", skin, SkinEvidence),
    ):
        if value is not None and not isinstance(value, kind):
            raise InvalidInput(f"{name}: expected {kind.__name__} or None, got {type(value).__name__}")
    if skin is None and isinstance(outside, Outside) and outside.skin is not None:  # deprecated
        skin = SkinEvidence(None, np.empty((0, 3)), np.asarray(outside.skin))
    if skin is not None and skin.contacts is not None:
        contacts = contacts.joined(skin.contacts)
    taxels = 0 if skin is None or skin.contacts is None else len(skin.contacts)
    weight = None if weight is None else weight.of(model)
    rows = outside_records(model, contacts, outside, skin)
    return Problem(model, contacts, prior, rows, weight, depth, taxels, skin is not None), skin


def _solved(
    problem: Problem, *, options: TwoPhase, limit: Budget, answer: str, samples: int
) -> Steps[PoseEstimate]:
    """Returns the answer to a problem; where the rest contradicts vision, with a wider prior.

    Vision's errors have heavier tails than a Gaussian, and a prior that is far off drags a pose along all directions in
    which contacts yield. A conflict of χ² with k degrees of freedom is likeliest where the covariance is χ² / k times
    as large. The answer says that the evidence is inconsistent all the same.
    """
    first = estimate = yield from _searched(problem, options, limit, answer, samples)
    if not first.conflicts:
        return first
    for _ in range(MOST_WIDENED):
        wrong = estimate.conflicts[0] if estimate.conflicts else None  # the least probable one
        if wrong is None or wrong.evidence != "vision" or problem.vision is None or limit.cut_short:
            break
        # A prior that is 10 m or 10 rad wide says nothing already.
        widest = 100.0 / max(float(problem.vision.covariance.diagonal().max()), 1e-18)
        factor = max(min(wrong.chi2 / wrong.freedom, widest), 1.0)
        covariance = factor * problem.vision.covariance
        wider = PosePrior.trusted(problem.vision.T_palm_object, covariance)
        problem = replace(problem, vision=wider, doubted=False)
        estimate = yield from _searched(problem, options, limit, answer, samples)
    if estimate is first:
        return first
    excluded = tuple(c for c in estimate.conflicts if c.excluded)
    in_use = tuple(c for c in first.conflicts if not c.excluded)
    return replace(estimate, consistent=False, conflicts=in_use + excluded)


def _searched(
    problem: Problem, options: TwoPhase, limit: Budget, answer: str, samples: int, first: int = DRAWS.first
) -> Steps[PoseEstimate]:
    """Returns the answer to a problem, from one start where that is enough, else from many; on a tactile array the mean
    of draws, of which `first` are from what the contacts leave open."""
    drawn = None
    if problem.on_skin and len(problem.outside) and not problem.blind:
        by_contacts = replace(problem, outside=NO_OUTSIDE, weight=None, on_skin=False)
        alone = yield from _searched(by_contacts, options, limit, "maximum", 0)
        drawn = yield from draw(problem, alone.T_palm_object_maximum, alone.information, limit, first)
        problem = replace(problem, starts=drawn[0])
    if is_registered(problem.contacts):
        if options is USUAL and not samples:
            return register(problem, limit)
        if len(problem.contacts.shared_covariance):
            raise InvalidInput("samples, method: expected neither with contacts that share errors, got some")
    answer = "maximum" if samples else answer
    kind = kind_of(problem, answer)
    if options is USUAL and not samples and problem.starts is None and not problem.doubted:
        estimate = solve_single_start(problem, mean=kind)
        if estimate is not None:
            yield
            return after_draws(problem, estimate, answer)
    found = yield from outliers.solve_robustly(problem, options, limit)
    averaged = drawn if answer != "maximum" and found.used.all() else None
    rows = summarize(problem, found, mean=kind if averaged is None else 0)
    yield
    if limit.cut_short:
        rows["converged"] = False
    if averaged is None:
        estimate = with_means(problem, rows, found.used, answer)
    else:
        _, T, C = averaged
        estimate = with_means(problem, rows[:1], found.used, "maximum")
        known = known_information(problem.model, T, C)
        complete = C if estimate.answer["complete"] else None
        estimate = estimate.with_gaussian(T, complete, known, solve.residuals(problem, T))
        if not estimate.consistent and first < DRAWS.again and not limit.spent():
            other = yield from _searched(problem, options, limit, answer, samples, DRAWS.again)
            return other if other.answer["chi2"] < estimate.answer["chi2"] else estimate
    for i in estimate.outliers:
        wrong = conflicts.excluded(problem, estimate, f"contact {i}", float(found.falls[i]))
        estimate = replace(estimate, conflicts=(*estimate.conflicts, wrong))
    return mean_by_sampling(problem, estimate, found.used, samples) if samples else estimate


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
    """Returns the answer of a descent from one pose that was right a moment ago; None where the evidence does not fit
    there, and `correct_pose` has to search.

    `T_start` (4, 4): the last estimate's `T_palm_object_maximum`, not its mean, at which the evidence may not fit. The
    other arguments are those of `correct_pose`. Raises InvalidInput.
    """
    problem, skin = problem_of(model, contacts, vision, outside, weight, depth, skin)
    return finished(refined(problem, skin, np.asarray(T_start), checked_answer(answer)))


def refined(
    problem: Problem, skin: SkinEvidence | None, T_start: Array, answer: str
) -> Steps[PoseEstimate | None]:
    """Returns `refine_pose` of a problem and its skin, in steps."""
    registered, estimate = is_registered(problem.contacts), None
    if registered:
        found = register(replace(problem, starts=T_start[None]), Budget())
        estimate = found if found.consistent else None
    else:
        estimate = solve_single_start(problem, T_start, mean=KINDS[answer])
    if estimate is None or (problem.weight is not None and problem.weight.contradicts(estimate)):
        return None
    yield
    estimate = estimate if skin is None else estimate.inflated(skin.sigmas**2)
    return estimate if problem.weight is None else replace(estimate, weight_fits=True)


def _weighed(
    problem: Problem,
    weight: WeightEvidence,
    estimate: PoseEstimate,
    solved: Callable[[Problem], Steps[PoseEstimate]],
) -> Steps[PoseEstimate]:
    """Returns the estimate, or, where all other evidence contradicts the weight, the answer without it."""
    contradicted = weight.contradicts(estimate)
    if estimate.consistent and not contradicted:
        return replace(estimate, weight_fits=True)
    without = yield from solved(replace(problem, weight=None))
    named, others = ({c.evidence for c in e.conflicts if not c.excluded} for e in (estimate, without))
    elsewhere = not estimate.consistent and not without.consistent
    # Something else is inconsistent, with the weight and without; it may also pull the pose away from the weight.
    if elsewhere and (not contradicted or (named == others and named and "weight" not in named)):
        return replace(estimate, weight_fits=True)
    fall = float(estimate.answer["chi2"] - without.answer["chi2"])
    wrong = conflicts.excluded(problem, without, "weight", fall)
    return replace(without, weight_fits=False, conflicts=(*without.conflicts, wrong))


def _method(method: str | TwoPhase | PaperMethod) -> TwoPhase | PaperMethod:
    """Returns a method's options by its name; raises InvalidInput."""
    if isinstance(method, TwoPhase | PaperMethod):
        return method
    if not isinstance(method, str) or method not in METHODS:
        raise InvalidInput(f"method: expected one of {', '.join(METHODS)}, got {checks.brief(method)!r}")
    return METHODS[method]


def _by_paper(problem: Problem, options: PaperMethod) -> PoseEstimate:
    """Returns the pose by the paper's method, with the uncertainty of handsight's own evidence at it."""
    model, contacts = problem.model, problem.contacts
    for name, value in (("weight", problem.weight), ("depth", problem.depth)):
        if value is not None:
            came = f"got {type(value).__name__}"
            raise InvalidInput(f"{name}: expected None, as the paper's method does not use it, {came}")
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

    A problem is a mapping of `correct_pose`'s arguments by name (`contacts`, `vision`, `outside`, `answer`, `samples`,
    `budget`, `weight`, `depth`, `skin`, `method`), a pair `(contacts, vision)`, or contacts alone, without vision.
    Problems of nothing but contacts and vision are the fastest. Raises InvalidInput that names the problem, such as
    `problems[3].vision: ...`; wrong contacts and vision are found before any problem is solved.
    """
    if not isinstance(model, ObjectModel):
        raise InvalidInput(f"model: expected an ObjectModel, got {type(model).__name__}")
    if isinstance(problems, Contacts | Mapping) or not isinstance(problems, Iterable):
        raise InvalidInput(f"problems: expected a sequence of problems, got {type(problems).__name__}")
    each = [_arguments(problem, f"problems[{i}]") for i, problem in enumerate(problems)]
    found: list[PoseEstimate | None] = [None] * len(each)
    usual = [
        i
        for i, problem in enumerate(each)
        if set(problem) == {"contacts", "vision"} and not is_registered(problem["contacts"])
    ]
    at_once = 4096  # problems in one call of the kernels
    for begin in range(0, len(usual), at_once):
        rows = usual[begin : begin + at_once]
        alone = [Problem(model, each[i]["contacts"], each[i]["vision"], NO_OUTSIDE) for i in rows]
        kinds = [kind_of(problem, "best") for problem in alone]
        for i, one, estimate in zip(rows, alone, solve_batch(model, alone, kinds), strict=True):
            found[i] = None if estimate is None else after_draws(one, estimate, "best")
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
