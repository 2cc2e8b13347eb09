"""A mode's mean and covariance in place of its maximum, by integration or by sampling.

Two fingers and a thumb on opposite faces leave a flat direction that edges bound but do not fix: the maximum of the
density is at the interval's end, its mean in the middle. How it is integrated: `_kernels/posterior/mean.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from handsight import checks, se3
from handsight._kernels.posterior import mean
from handsight._kernels.posterior.options import INTEGRATION
from handsight.checks import Array, Mask
from handsight.correction import modes, solve
from handsight.correction.estimate import PoseEstimate
from handsight.correction.problem import Problem, descents_at
from handsight.errors import InvalidInput
from handsight.objects.symmetry import tangents

ANSWERS = ("best", "maximum", "mean")
"""The mean where a mode is not Gaussian, else the maximum; or always one of them."""


class SamplingOptions(NamedTuple):
    """`SamplingOptions` say how the posterior is sampled."""

    chains: int = 64  # Markov chains that move at once; one evaluation serves them all
    burn_in: int = 100  # least number of steps that tune the stride and are discarded
    acceptance: float = 0.35  # share of accepted steps that explores a line fastest, about


SAMPLING = SamplingOptions()


def checked_answer(answer: object, name: str = "answer") -> str:
    """Returns one of `ANSWERS`; raises InvalidInput."""
    if not isinstance(answer, str) or answer not in ANSWERS:
        raise InvalidInput(f"{name}: expected one of {', '.join(ANSWERS)}, got {checks.brief(answer)!r}")
    return answer


def with_means(problem: Problem, estimate: PoseEstimate, answer: str) -> PoseEstimate:
    """Returns the estimate with means in place of its likeliest modes where these are not Gaussian; if `answer` is
    "mean", in place of its first one in any case.

    Another mode along the same flat direction is part of the mean, and no hypothesis any more, nor is the second of two
    means that are not distinct. Without vision, a mode with a direction that is not known stays its maximum: such a
    direction is not bounded, and several maxima along it say more than one mean.
    """
    likeliest = estimate.modes[: INTEGRATION.max_modes]
    integrated = [
        row["departure"] > INTEGRATION.max_gaussian_rise and (row["complete"] or not problem.blind)
        for row in likeliest
    ]
    if answer == "maximum" or not (answer == "mean" or any(integrated)):
        return estimate
    rows = np.array(estimate.modes)
    rows["departure"][: len(integrated)][~np.array(integrated, dtype=bool)] = 0.0
    if answer == "mean":
        rows["departure"][0] = np.inf
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    used[0, list(estimate.outliers)] = False
    mean.integrate(*problem.arguments(used), rows)
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


def mean_by_sampling(problem: Problem, estimate: PoseEstimate, used: Mask, samples: int) -> PoseEstimate:
    """Returns the estimate with pose and covariance replaced by mean and covariance of `samples` posterior draws.

    Markov chains (Metropolis) start from the mode and move along the eigenvectors of the information there, which must
    have no wall in it: at the end of an interval, where the mode is, a wall tilts them, and chains along tilted ones do
    not get away from it (measured: 4 000 samples left the mean of a gripped box 2 mm nearer to its maximum than 80 000
    did). They do not move along a declared symmetry axis, which has no mean, and with one the covariance is None.
    """
    T_mode, radius = estimate.T_palm_object, problem.model.radius
    axes = tangents(problem.model.symmetries, T_mode)
    metres, basis = modes.in_metres(estimate.information, radius), _across(axes, radius)
    values, vectors = np.linalg.eigh(basis @ metres @ basis.T)
    length = 1 / np.sqrt(np.maximum(values, 1 / radius**2))
    scale = np.repeat([1.0, 1 / radius], 3)
    directions = (vectors.T @ basis) * length[:, None] * scale
    draws = _metropolis(lambda poses: -solve.cost(problem, poses, used) / 2, T_mode, directions, samples)
    T = se3.moved(T_mode, draws.mean(axis=0))
    spread = np.cov(draws.T)
    # Along an axis no chain has moved, so that the spread is next to none; there nothing is known, not everything.
    known = _across(tangents(problem.model.symmetries, T), radius)
    inverse = known.T @ np.linalg.inv(known @ (spread / scale[:, None] / scale) @ known.T) @ known
    return estimate.with_gaussian(
        T,
        None if len(axes) else spread,
        inverse / scale[:, None] / scale,
        solve.residuals(problem, descents_at(T[None])),
    )


def _across(axes: Array, radius: float) -> Array:
    """Returns (k, 6) orthonormal directions (δp, radius δθ) across the symmetry axes (n, 6)."""
    if not len(axes):
        return np.eye(6)
    scaled = axes * np.repeat([1.0, radius], 3)
    _, _, rows = np.linalg.svd(scaled)
    return np.asarray(rows[np.linalg.matrix_rank(scaled) :])


def _metropolis(
    log_density: Callable[[Array], Array], T_mode: Array, directions: Array, samples: int
) -> Array:
    """Returns (samples, 6) perturbations of the mode, drawn from a posterior whose logarithm is given up to a
    constant; `directions` (k, 6) are steps of about one standard deviation."""
    rng = np.random.default_rng(0)
    chains = min(SAMPLING.chains, samples)
    kept = -(-samples // chains)
    burn = max(kept, SAMPLING.burn_in)
    at = np.repeat(T_mode[None], chains, axis=0)
    density = log_density(at)
    stride, draws = np.ones(len(directions)), []
    for step in range(burn + kept):
        j = step % len(directions)
        proposal = se3.moved(at, rng.normal(size=(chains, 1)) * stride[j] * directions[j])
        proposed = log_density(proposal)
        accepted = np.log(rng.random(chains)) < proposed - density
        at = np.where(accepted[:, None, None], proposal, at)
        density = np.where(accepted, proposed, density)
        if step < burn:
            stride[j] *= np.exp(accepted.mean() - SAMPLING.acceptance)
        else:
            draws.append(se3.difference(at, T_mode))
    return np.concatenate(draws)[:samples]
