"""The public door of correction: one function for every method."""

from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import modes, outliers, paper, plain, two_phase
from handsight.correction.estimate import Hypothesis, PoseEstimate, PosePrior
from handsight.correction.outliers import Solver
from handsight.correction.paper import PaperMethod
from handsight.correction.posterior import mean_by_sampling
from handsight.correction.two_phase import Problem, TwoPhase
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

USUAL = TwoPhase()
NO_POINTS = np.empty((0, 3))
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
    vision: PosePrior | None = None,
    outside: ArrayLike | None = None,
    samples: int = 0,
    method: str | TwoPhase | PaperMethod = "handsight",
) -> PoseEstimate:
    """The object's pose in the palm that best explains the contacts and vision, with its uncertainty.

    contacts: fingertip contacts in the palm frame. vision: where the object is thought to be; None: blind.
    outside: (m, 3) points [m] of the hand's surface in the palm frame, none of which can be inside the object.
    samples: above 0, the answer is the best mode's mean and covariance from that many posterior samples, which
    is the better answer where contacts bound a slide but do not fix it. method: a name of `METHODS`, or its
    options as a value. Raises InvalidInput where an input is wrong; a solver that does not converge says so in
    `converged`.
    """
    options = _method(method)
    if not isinstance(model, ObjectModel) or not isinstance(contacts, Contacts):
        raise InvalidInput(
            "correct_pose: expected an ObjectModel and Contacts, "
            f"got {type(model).__name__} and {type(contacts).__name__}"
        )
    if vision is not None and not isinstance(vision, PosePrior):
        raise InvalidInput(f"vision: expected a PosePrior or None, got {type(vision).__name__}")
    hand = NO_POINTS
    if outside is not None and np.size(outside):
        hand = checks.finite(outside, "outside", (None, 3))
    if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or not 0 <= samples <= 10**7:
        raise InvalidInput(f"samples: expected a whole number from 0 to 10000000, got {samples!r}")
    problem = Problem(model, contacts, vision, hand)
    if options is USUAL and not samples:
        estimate: PoseEstimate | None = compiled_solver().near(problem)
        if estimate is not None:
            return estimate
    if isinstance(options, PaperMethod):
        return _by_paper(problem, options)
    return _by_two_phases(problem, options, int(samples))


def follow_pose(
    model: ObjectModel, contacts: Contacts, vision: PosePrior, T_start: Array, outside: Array | None = None
) -> PoseEstimate | None:
    """What `correct_pose` answers where it descends from a pose that was right a moment ago, and from there alone.

    None where the evidence does not fit there: then search anew. `T_start` (4, 4); `outside` (m, 3) [m] or None.
    """
    problem = Problem(model, contacts, vision, NO_POINTS if outside is None else outside)
    followed: PoseEstimate | None = compiled_solver().near(problem, T_start)
    return followed


def _method(method: str | TwoPhase | PaperMethod) -> TwoPhase | PaperMethod:
    if isinstance(method, TwoPhase | PaperMethod):
        return method
    if method not in METHODS:
        raise InvalidInput(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    return METHODS[method]


@cache
def compiled_solver() -> ModuleType:
    """The compiled solver, once it is asked for: numba takes half a second to import."""
    from handsight.correction import compiled

    return compiled


def _by_two_phases(problem: Problem, options: TwoPhase, samples: int) -> PoseEstimate:
    solver: Solver = compiled_solver() if options.compiled else plain
    found = outliers.solve_robustly(problem, options, solver)
    estimate = solver.explained(problem, found.descent, found.used)
    if not samples:
        return estimate
    return mean_by_sampling(problem, estimate, found.used, samples, solver.cost)


def _by_paper(problem: Problem, options: PaperMethod) -> PoseEstimate:
    """The published method's pose; the uncertainty beside it is ours, taken at that pose."""
    model, contacts = problem.model, problem.contacts
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
    used = np.ones((1, len(contacts)), dtype=bool)
    information, by_touch, chi2, cost = two_phase.posterior(problem, T[None], used)
    known = modes.complete(information[0], model.radius, blind=False)
    sigma = modes.covariance(information[0], model.radius) if known else None
    return PoseEstimate(
        T_palm_object=T,
        covariance=sigma,
        information=information[0],
        converged=answer.converged,
        iterations=answer.iterations,
        residuals=two_phase.residuals(problem, T),
        unobservable=two_phase.open_directions(model, by_touch[0], T),
        consistent=modes.fits(float(chi2[0]), two_phase.freedom(problem, used)),
        outliers=(),
        hypotheses=(Hypothesis(T, information[0], sigma, 1.0, float(cost[0])),),
    )
