"""The solver in plain NumPy: what the compiled one means."""

import numpy as np

from handsight.checks import Array, Mask
from handsight.correction import modes, two_phase
from handsight.correction.estimate import PoseEstimate
from handsight.correction.solve import Descent
from handsight.correction.two_phase import Problem
from handsight.objects.symmetry import nearest


def solve(problem: Problem, Ts_start: Array, used: Mask) -> tuple[Descent, Mask]:
    """Candidates, cheapest first, and which contacts (K, n) count for each."""
    return two_phase.solve(problem, Ts_start, used)


def largest_gain(problem: Problem, T_palm_object: Array, used: Mask) -> float:
    """The most that χ² falls, to first order, when one contact is left out."""
    return float(two_phase.gains(problem, T_palm_object, used).max())


def explained(problem: Problem, descent: Descent, used: Mask) -> PoseEstimate:
    """The answer to a problem from its minima, all of which use the contacts `used` (1, n)."""
    model, Ts = problem.model, descent.Ts_palm_object
    if problem.vision is not None:
        Ts = nearest(model.symmetries, Ts, problem.vision.T_palm_object, model.radius)
    informations, by_touch, chi2, costs = two_phase.posterior(problem, Ts, used)
    ranked = modes.hypotheses(
        model,
        Ts,
        informations,
        costs,
        lambda poses: two_phase.cost(problem, poses, used),
        blind=problem.vision is None,
    )
    best = ranked[0]
    k = int(np.flatnonzero((Ts == best.T_palm_object).all(axis=(1, 2)))[0])
    return PoseEstimate(
        T_palm_object=best.T_palm_object,
        covariance=best.covariance,
        information=best.information,
        converged=bool(descent.converged[k]),
        iterations=int(descent.iterations[k]),
        residuals=two_phase.residuals(problem, best.T_palm_object),
        unobservable=two_phase.open_directions(model, by_touch[k], best.T_palm_object),
        consistent=modes.fits(float(chi2[k]), two_phase.freedom(problem, used)),
        outliers=tuple(int(i) for i in np.flatnonzero(~used[0])),
        hypotheses=ranked,
    )


def cost(problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
    """Minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant."""
    return two_phase.cost(problem, Ts_palm_object, used)
