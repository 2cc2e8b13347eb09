"""Several explanations of one touch: how likely each is, and the estimate over all of them.

An explanation is a prior (vision's pose, with or without the table, see `tracking/table.py`), or one of the modes that
a correction finds under it. Those whose regions overlap are one: the estimate is their mean, with the covariance of the
mixture. Those that are elsewhere stay hypotheses of their own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight._kernels.posterior.options import INTEGRATION
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior, bounded_covariance
from handsight.correction.modes import MODES, SAME_MODE, chi2_limit, in_metres, pose_distances
from handsight.correction.weight import CONTRADICTS
from handsight.objects import ObjectModel
from handsight.objects.symmetry import tangents

OVERLAP = chi2_limit(6, 0.05)
"""Two Gaussian poses overlap if their difference is within its 95 % region."""


@dataclass(frozen=True, slots=True, eq=False)
class Alternatives:
    """`Alternatives` are the explanations other than the likeliest one."""

    share: float
    """Probability of the likeliest explanation among those that overlap with it."""
    mean: Array
    """(6,) the mean (δp, δθ) of those that overlap, relative to the likeliest [m, rad]."""
    spread: Array
    """(6, 6) what the others add to the covariance, that of the likeliest having been multiplied by `share`."""
    others: tuple[np.void, ...] = ()
    """ANSWER of each mode that does not overlap, the likeliest first; with the likeliest its weights sum to 1."""

    @classmethod
    def of(cls, model: ObjectModel, parts: Sequence[tuple[float, PoseEstimate]]) -> "Alternatives":
        """Returns the alternatives of several (probability, estimate), the likeliest first, of which one is true."""
        rows = [(p * float(row["weight"]), row) for p, estimate in parts for row in estimate.modes]
        rows = [rows[0], *sorted(rows[1:], key=lambda one: -one[0])]
        total = sum(p for p, _ in rows)
        T = rows[0][1]["T_palm_object"]
        covariance = bounded_covariance(rows[0][1]["information"])
        near, mean, spread, others = rows[0][0] / total, np.zeros(6), np.zeros((6, 6)), list[np.void]()
        for p, row in rows[1:]:
            step = se3.difference(model.nearest(row["T_palm_object"], T), T)
            own = bounded_covariance(row["information"])
            if step @ np.linalg.solve(covariance + own, step) < OVERLAP:
                near += p / total
                mean += p / total * step
                spread += p / total * (own + np.outer(step, step))
            else:
                row = row.copy()
                row["weight"] = p / total
                others.append(row)
        mean, spread = mean / near, spread / near
        share = rows[0][0] / total / near
        return cls(share, mean, spread - np.outer(mean, mean), _distinct(model, others))

    def added(self, model: ObjectModel, estimate: PoseEstimate) -> PoseEstimate:
        """Returns the likeliest explanation's estimate with its alternatives."""
        weight = 1 - sum(float(row["weight"]) for row in self.others)
        if self.share < 1:
            # A direction about which nothing is known, such as a spin about a symmetry axis, stays unknown.
            values, vectors = np.linalg.eigh(in_metres(estimate.information, model.radius))
            known = vectors[:, values > 1e-9 * values[-1]].T * np.repeat([1.0, model.radius], 3)
            covariance = self.share * bounded_covariance(estimate.information) + self.spread
            information = known.T @ np.linalg.inv(known @ covariance @ known.T) @ known
            T = se3.moved(estimate.T_palm_object, self.mean)
            complete = estimate.covariance is not None
            estimate = estimate.with_gaussian(T, covariance if complete else None, information)
        answer = estimate.answer.copy()
        answer["weight"] = weight
        return replace(estimate, answer=answer, modes=(answer, *self.others))


def _distinct(model: ObjectModel, rows: Sequence[np.void]) -> tuple[np.void, ...]:
    """Returns the rows without those that are near a likelier one, whose weight they join."""
    found: list[np.void] = []
    for row in rows:
        for other in found:
            shift, turn = pose_distances(model, row["T_palm_object"][None], other["T_palm_object"])
            if shift[0] <= SAME_MODE[0] and turn[0] <= SAME_MODE[1]:
                other["weight"] += row["weight"]
                break
        else:
            found.append(row)
    return tuple(sorted(found, key=lambda row: -row["weight"])[: MODES.max_modes - 1])


def normalised(log_weights: Array) -> Array:
    """Returns the weights of these logarithms (k,), divided by their sum."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def log_evidence(model: ObjectModel, estimate: PoseEstimate, prior: PosePrior) -> float:
    """Returns the log density of all touch under a prior, up to a constant that is the same for all priors.

    It is Laplace's approximation at each mode. A contact that was rejected counts as if it were just as far off as is
    rejected, and so does the weight, so that rejecting a measurement does not pay.
    """
    row, radius = estimate.modes[0], model.radius
    if row["departure"] > INTEGRATION.max_gaussian_rise:  # a mean, whose volume was integrated
        log_weight = float(row["log_weight"])
    else:
        values = np.linalg.eigvalsh(in_metres(row["information"], radius))
        log_weight = -0.5 * float(row["posterior_cost"] + np.log(np.maximum(values, 1e-9 / radius**2)).sum())
    log_weight -= math.log(row["weight"])
    used = max(len(estimate.residual_rows) - len(estimate.outliers), 1)
    log_spread = float(row["posterior_cost"] - row["chi2"]) / used
    log_weight -= 0.5 * len(estimate.outliers) * (MODES.decisive + log_spread)
    log_weight -= 0.5 * CONTRADICTS * (estimate.weight_fits is False)
    information = np.asarray(np.linalg.inv(prior.covariance), dtype=np.float64)
    for spin in tangents(model.symmetries, prior.T_palm_object):  # about which a prior says nothing
        along = information @ spin
        information -= np.outer(along, along) / (spin @ along)
    values = np.linalg.eigvalsh(in_metres(information, radius))[len(model.symmetries.axes) :]
    return log_weight + 0.5 * float(np.log(values).sum())
