"""A mode's mean and covariance in place of its maximum, by integration or by sampling.

Two fingers and a thumb on opposite faces leave a flat direction that edges bound but do not fix: the maximum of the
density is at an end of the interval, its mean in the middle. The code that integrates is in
`_kernels/posterior/mean.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from handsight import checks, se3
from handsight._kernels.posterior.options import INTEGRATION
from handsight._kernels.solve import batch
from handsight.checks import Array, Mask
from handsight.correction import conflicts, few_contacts, modes, solve
from handsight.correction.estimate import PoseEstimate, bounded_covariance
from handsight.correction.problem import Problem, Records, descents_at, taken
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import tangents

KINDS = {"best": 1, "maximum": 0, "mean": 2}
"""An answer, as the `mean` of an ANSWER; "best" is the mean where a mode is not Gaussian, else the maximum."""
ANSWERS = tuple(KINDS)


class SamplingOptions(NamedTuple):
    """`SamplingOptions` are the numbers of the Metropolis sampler."""

    chains: int = 64  # Markov chains that move at once: one call of the kernel evaluates all of them
    burn_in: int = 100  # least number of first steps, which tune the stride and are discarded
    acceptance: float = (
        0.35  # share of accepted steps that the stride is tuned to: about where mixing is fastest
    )


SAMPLING = SamplingOptions()


def checked_answer(answer: object, name: str = "answer") -> str:
    """Returns the answer if it is one of `ANSWERS`; else raises InvalidInput, which begins with `name`."""
    if not isinstance(answer, str) or answer not in ANSWERS:
        raise InvalidInput(f"{name}: expected one of {', '.join(ANSWERS)}, got {checks.brief(answer)!r}")
    return answer


def kind_of(problem: Problem, answer: str) -> int:
    """Returns the ANSWER's `mean` for an answer; 0 too where its modes may have to be drawn from."""
    return 0 if answer == "best" and few_contacts.may_draw(problem) else KINDS[answer]


def after_draws(problem: Problem, estimate: PoseEstimate, answer: str) -> PoseEstimate:
    """Returns the estimate of one start; where its mode is to be drawn from, after that."""
    row = estimate.answer
    if row["mean"] or answer == "maximum" or row["departure"] <= INTEGRATION.max_gaussian_rise:
        return estimate
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    return with_means(problem, np.array([row]), used, answer)


def with_means(problem: Problem, rows: Records, used: Mask, answer: str) -> PoseEstimate:
    """Returns the estimate of modes (K,) ANSWER, likeliest first, each that is not Gaussian replaced by its mean: with
    `answer` "mean" the first mode in any case, with "maximum" no mode.

    `used` (1, n): the contacts in use. Only the likeliest modes are tested. A mode along the same flat direction as
    another is part of that one's mean, and is no hypothesis any more; of means that are not distinct, one remains, the
    mean of all. Without vision, a mode with an unobservable direction stays a maximum: the direction is not bounded,
    and several maxima along it are more informative than one mean.
    """
    draw = answer == "best" and few_contacts.have_draws(rows) and few_contacts.may_draw(problem)
    if draw:
        rows = few_contacts.with_draws(problem, rows, used)
    elif answer != "maximum" and not rows[0]["mean"]:
        rows["mean"], rows["mean"][0] = 1, KINDS[answer]
        batch.summarize_all(*problem.arguments(used), rows)
    if len(rows) > 1 and not draw:
        left = np.flatnonzero(rows["weight"] >= 0)
        rows = taken(rows, left[np.argsort(-rows["log_weight"][left], kind="stable")])
        rows = _merged(problem, rows, answer) if len(rows) > 1 else rows
    share = np.exp(rows["log_weight"] - rows["log_weight"][0])
    rows["weight"] = share / share.sum()
    residuals = solve.residuals(problem, rows["T_palm_object"][0])
    consistent, contradictions = conflicts.judged(problem, rows[0], used)
    rejected = tuple(np.flatnonzero(~used[0]).tolist())
    return PoseEstimate(rows, residuals, consistent, rejected, conflicts=contradictions)


def _merged(problem: Problem, rows: Records, answer: str) -> Records:
    """Returns the distinct ones of modes (K,) ANSWER, likeliest first; unless the answer is to be the "maximum", each
    becomes the mean, and has the covariance, of itself and those beside it."""
    model = problem.model
    means = descents_at(rows["T_palm_object"])
    chosen = solve.distinct(model, means, np.arange(len(rows)), modes.MODES.max_modes, modes.SAME_MODE)
    repeats = np.ones(len(rows), dtype=bool)
    repeats[chosen] = False
    rest, merged = np.flatnonzero(repeats), taken(rows, chosen)
    if answer == "maximum" or not len(rest):
        return merged
    for row in merged:
        T = row["T_palm_object"].copy()
        shift, turn = modes.pose_distances(model, rows["T_palm_object"][rest], T)
        near = (shift <= modes.SAME_MODE[0]) & (turn <= modes.SAME_MODE[1])
        beside, rest = rows[rest[near]], rest[~near]
        share = np.exp(beside["log_weight"] - row["log_weight"])
        if share.sum() < 0.01:
            continue
        Ts = model.nearest(beside["T_palm_object"], T)
        offsets = np.vstack([np.zeros(6), se3.difference(Ts, T)])
        shares = np.append(1.0, share) / (1 + share.sum())
        middle = shares @ offsets
        parts = [
            r["covariance"] if r["complete"] else bounded_covariance(r["information"]) for r in (row, *beside)
        ]
        C = np.einsum("k,kij->ij", shares, parts)
        C += (offsets - middle).T @ ((offsets - middle) * shares[:, None])
        row["T_palm_object"], row["covariance"] = se3.moved(T, middle), C
        row["log_weight"] += np.log1p(share.sum())
        row["information"] = known_information(model, row["T_palm_object"], C)
    return taken(merged, np.argsort(-merged["log_weight"], kind="stable"))


def known_information(model: ObjectModel, T: Array, covariance: Array) -> Array:
    """Returns the inverse of a covariance (6, 6), zero along the declared symmetry axes."""
    scale = np.repeat([1.0, 1 / model.radius], 3)
    known = across_axes(tangents(model.symmetries, T), model.radius)
    metres = known @ (covariance / scale[:, None] / scale) @ known.T
    # Of the correlations, as variances may differ by a factor that is beyond rounding; positive definite in any case.
    deviations = np.sqrt(metres.diagonal())
    values, vectors = np.linalg.eigh(metres / deviations[:, None] / deviations)
    rows = (vectors / np.sqrt(np.maximum(values, 1e-12))).T / deviations @ known / scale
    return np.asarray(rows.T @ rows)


def mean_by_sampling(problem: Problem, estimate: PoseEstimate, used: Mask, samples: int) -> PoseEstimate:
    """Returns the estimate with pose and covariance replaced by mean and covariance of draws from the posterior.

    `used` (1, n): the contacts in use. `samples`: the number of draws, at least one for each chain. Markov chains
    (Metropolis) start at the maximum and move along the eigenvectors of the information there. That information must be
    without walls: a maximum at the end of an interval is at a wall, whose information would tilt the eigenvectors so
    that chains hardly get away (measured: 4 000 samples left the mean of a gripped box 2 mm nearer to its maximum than
    80 000 did). Chains do not move about a declared symmetry axis, which has no mean; with such an axis the covariance
    is None.
    """
    T_mode, radius = estimate.T_palm_object, problem.model.radius
    axes = tangents(problem.model.symmetries, T_mode)
    metres, basis = modes.in_metres(estimate.information, radius), across_axes(axes, radius)
    values, vectors = np.linalg.eigh(basis @ metres @ basis.T)
    length = 1 / np.sqrt(np.maximum(values, 1 / radius**2))
    scale = np.repeat([1.0, 1 / radius], 3)
    directions = (vectors.T @ basis) * length[:, None] * scale
    samples = max(samples, SAMPLING.chains)
    draws = _metropolis(lambda poses: -solve.cost(problem, poses, used) / 2, T_mode, directions, samples)
    T = se3.moved(T_mode, draws.mean(axis=0))
    spread = np.cov(draws.T)
    # No chain has moved about a symmetry axis, so the spread there is nearly zero; the information there must be zero.
    return estimate.with_gaussian(
        T,
        None if len(axes) else spread,
        known_information(problem.model, T, spread),
        solve.residuals(problem, T),
    )


def across_axes(axes: Array, radius: float) -> Array:
    """Returns (k, 6) orthonormal directions (δp, radius δθ) across the symmetry axes (n, 6)."""
    if not len(axes):
        return np.eye(6)
    scaled = axes * np.repeat([1.0, radius], 3)
    _, _, rows = np.linalg.svd(scaled)
    return np.asarray(rows[np.linalg.matrix_rank(scaled) :])


def _metropolis(
    log_density: Callable[[Array], Array], T_mode: Array, directions: Array, samples: int
) -> Array:
    """Returns (samples, 6) perturbations (δp [m], δθ [rad]) of the mode, drawn from a posterior.

    `log_density`: poses (c, 4, 4) to its logarithm (c,), up to a constant. `directions` (k, 6): steps of about one
    standard deviation.
    """
    rng = np.random.default_rng(0)
    chains = SAMPLING.chains
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
