"""A mode's mean and covariance in place of its maximum.

Two fingers and a thumb on opposite faces leave a flat direction that edges bound but do not fix: the maximum of the
density is at an end of the interval, its mean in the middle. The code that integrates is in
`correction/kernels/mean.py`.
"""

import numpy as np

from handsight import se3
from handsight.checks import Array, Mask
from handsight.correction import conflicts, few_contacts, modes, solve
from handsight.correction.estimate import PoseEstimate, bounded_covariance
from handsight.correction.kernels import batch
from handsight.correction.kernels.integration_options import INTEGRATION
from handsight.correction.problem import Problem, Records, descents_at
from handsight.objects import ObjectModel
from handsight.objects.symmetry import tangents


def after_draws(problem: Problem, estimate: PoseEstimate) -> PoseEstimate:
    """Returns the estimate of one start; where its mode is to be drawn from, after that."""
    row = estimate.answer
    if row["mean"] or row["departure"] <= INTEGRATION.max_gaussian_rise:
        return estimate
    return with_means(problem, np.array([row]), problem.everyone)


def with_means(problem: Problem, rows: Records, used: Mask, *, means: bool = True) -> PoseEstimate:
    """Returns the estimate of modes (K,) ANSWER, likeliest first, each that is not Gaussian replaced by its mean;
    without `means`, none.

    `used` (1, n): the contacts in use. Only the likeliest modes are tested. A mode along the same flat direction as
    another is part of that one's mean, and is no hypothesis any more; of means that are not distinct, one remains, the
    mean of all. Without vision, a mode with an unobservable direction stays a maximum: the direction is not bounded,
    and several maxima along it are more informative than one mean.
    """
    draw = means and few_contacts.have_draws(rows) and few_contacts.may_draw(problem)
    if draw:
        rows = few_contacts.with_draws(problem, rows, used)
    elif means and not rows[0]["mean"]:
        rows["mean"] = True
        batch.summarize_all(*problem.arguments(used), rows)
    if len(rows) > 1 and not draw:
        left = np.flatnonzero(rows["weight"] >= 0)
        rows = rows.take(left[np.argsort(-rows["log_weight"][left], kind="stable")])
        rows = merged(problem, rows, means=means)
    rows = with_weights(rows)
    residuals = solve.residuals(problem, rows["T_palm_object"][0])
    consistent, contradictions = conflicts.judged(problem, rows[0], used)
    rejected = tuple(np.flatnonzero(~used[0]).tolist())
    return PoseEstimate(rows, residuals, consistent, rejected, conflicts=contradictions)


def with_weights(rows: Records) -> Records:
    """Returns modes (K,) ANSWER, likeliest first, with their probabilities among each other."""
    share = np.exp(rows["log_weight"] - rows["log_weight"][0])
    rows["weight"] = share / share.sum()
    return rows


def merged(problem: Problem, rows: Records, *, means: bool = True) -> Records:
    """Returns the distinct ones of modes (K,) ANSWER, likeliest first; with `means` each becomes the mean, and has the
    covariance, of itself and those beside it."""
    if len(rows) == 1:
        return rows
    model = problem.model
    descents = descents_at(rows["T_palm_object"])
    chosen = solve.distinct(model, descents, np.arange(len(rows)), modes.MAX_MODES, modes.SAME_MODE)
    repeats = np.ones(len(rows), dtype=bool)
    repeats[chosen] = False
    rest, kept = np.flatnonzero(repeats), rows.take(chosen)
    if not means or not len(rest):
        return kept
    for row in kept:
        T = row["T_palm_object"].copy()
        shift, turn = modes.pose_distances(model, rows["T_palm_object"][rest], T)
        near = (shift <= modes.SAME_MODE[0]) & (turn <= modes.SAME_MODE[1])
        beside = rows[rest[near]]
        rest = rest[~near]
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
        row["T_palm_object"] = se3.moved(T, middle)
        row["covariance"] = C
        row["log_weight"] += np.log1p(share.sum())
        row["information"] = known_information(model, row["T_palm_object"], C)
    return kept.take(np.argsort(-kept["log_weight"], kind="stable"))


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


def across_axes(axes: Array, radius: float) -> Array:
    """Returns (k, 6) orthonormal directions (δp, radius δθ) across the symmetry axes (n, 6)."""
    if not len(axes):
        return np.eye(6)
    scaled = axes * np.repeat([1.0, radius], 3)
    _, _, rows = np.linalg.svd(scaled)
    return np.asarray(rows[np.linalg.matrix_rank(scaled) :])
