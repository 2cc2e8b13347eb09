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
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior, bounded_covariance
from handsight.correction.kernels.integration_options import INTEGRATION
from handsight.correction.kernels.search_options import ACCEPTANCE
from handsight.correction.modes import MAX_MODES, SAME_MODE, apart, chi2_limit, in_metres, pose_distances
from handsight.correction.weight import CONTRADICTS
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.symmetry import tangents
from handsight.tracking.search import Solver
from handsight.vision.object.rivals import Rivals

OVERLAP = chi2_limit(6, 0.05)
"""Two Gaussian poses overlap if the χ² of their difference is below this, its 95 % quantile."""
RELEVANT_WEIGHT = 0.05  # probability of another hypothesis from which on the answer is uncertain


@dataclass(frozen=True, slots=True, eq=False)
class Alternatives:
    """The explanations other than the likeliest one."""

    share: float
    """Probability of the likeliest explanation among those that overlap with it."""
    mean: Array
    """(6,) the mean (δp, δθ) of those that overlap, relative to the likeliest [m, rad]."""
    spread: Array
    """(6, 6) what the others add to the covariance, that of the likeliest having been multiplied by `share`."""
    others: tuple[np.void, ...]
    """ANSWER of each mode that does not overlap; with the likeliest explanation their weights sum to 1."""

    @classmethod
    def of(cls, model: ObjectModel, parts: Sequence[tuple[float, PoseEstimate]]) -> "Alternatives":
        """Returns the alternatives of several (probability, estimate), the likeliest first, of which one is true."""
        first = parts[0][0]
        T = parts[0][1].T_palm_object
        covariance = parts[0][1].bounded_covariance
        near = first
        mean = np.zeros(6)
        spread = np.zeros((6, 6))
        others = list[np.void]()
        for probability, row in ((p * float(row["weight"]), row) for p, e in parts[1:] for row in e.modes):
            step = se3.difference(model.nearest(row["T_palm_object"], T), T)
            own = bounded_covariance(row["information"])
            if step @ np.linalg.solve(covariance + own, step) < OVERLAP:
                near += probability
                mean += probability * step
                spread += probability * (own + np.outer(step, step))
            else:
                others.append(row.copy())
                others[-1]["weight"] = probability
        mean, spread = mean / near, spread / near
        return cls(first / near, mean, spread - np.outer(mean, mean), tuple(others))

    def added(self, model: ObjectModel, estimate: PoseEstimate) -> PoseEstimate:
        """Returns the likeliest explanation's estimate with its alternatives."""
        likeliest = 1 - sum(float(row["weight"]) for row in self.others)
        own = [row.copy() for row in estimate.modes[1:]]
        for row in own:
            row["weight"] *= likeliest
        # A direction about which nothing is known, such as a spin about a symmetry axis, stays unknown.
        values, vectors = np.linalg.eigh(in_metres(estimate.information, model.radius))
        known = vectors[:, values > 1e-9 * values[-1]].T * np.repeat([1.0, model.radius], 3)
        covariance = self.share * estimate.bounded_covariance + self.spread
        information = known.T @ np.linalg.inv(known @ covariance @ known.T) @ known
        T = se3.moved(estimate.T_palm_object, self.mean)
        complete = estimate.covariance is not None
        best = estimate.with_gaussian(T, covariance if complete and len(known) == 6 else None, information)
        best.answer["weight"] *= likeliest
        return with_others(model, best, (*own, *self.others))


def with_others(model: ObjectModel, estimate: PoseEstimate, others: Sequence[np.void]) -> PoseEstimate:
    """Returns an estimate with its best mode and the distinct ones of others (ANSWER), likeliest first.

    A mode joins its weight with that of a likelier one which it is near to; all are divided by their sum.
    """
    found = [estimate.answer.copy()]
    for row in sorted(others, key=lambda row: -row["weight"]):
        Ts = np.stack([one["T_palm_object"] for one in found])
        shift, turn = pose_distances(model, Ts, row["T_palm_object"])
        same = np.flatnonzero((shift <= SAME_MODE[0]) & (turn <= SAME_MODE[1]))
        if len(same):
            found[same[0]]["weight"] += row["weight"]
        elif len(found) < MAX_MODES:
            found.append(row.copy())
    total = sum(float(row["weight"]) for row in found)
    for row in found:
        row["weight"] /= total
    return replace(estimate, modes=np.array(found))


def ambiguity(model: ObjectModel, estimate: PoseEstimate, evidence: str) -> str:
    """Returns how far the relevant hypotheses are apart that some evidence explains, for a person; empty where there is
    one."""
    relevant = [row["T_palm_object"] for row in estimate.modes[1:] if row["weight"] > RELEVANT_WEIGHT]
    Ts = np.array(relevant).reshape(-1, 4, 4)
    return apart(model, Ts, estimate.modes[0]["T_palm_object"], evidence)


def among_rivals(
    model: ObjectModel, solver: Solver, rivals: Rivals, estimate: PoseEstimate, prior: PosePrior
) -> tuple[PoseEstimate, PosePrior, list[np.void]]:
    """Returns the likeliest of an estimate and of those at the poses that images cannot tell from it, with its prior,
    and the modes of the others; touch and images weigh them. Raises Unfinished."""
    if not len(rivals):
        return estimate, prior, []
    found = [(0.0, estimate, prior)]
    of_touch = log_evidence(model, estimate, prior)
    for T_object_rival, log_odds in zip(rivals.T_object_rivals, rivals.log_odds, strict=True):
        there = _at_rival(prior, T_object_rival)
        other = solver.refine(there, estimate.T_palm_object_maximum @ T_object_rival)
        if other is not None:
            gain = log_evidence(model, other, there) - of_touch
            found.append((log_odds + gain, other, there))
    return _likeliest(found)


def with_rivals(model: ObjectModel, estimate: PoseEstimate, rivals: Rivals) -> PoseEstimate:
    """Returns the likeliest of the estimate of a followed object without touch and of the poses that images cannot tell
    from it, with the others."""
    if not len(rivals):
        return estimate
    prior = PosePrior.trusted(estimate.T_palm_object, estimate.bounded_covariance)
    found = [(0.0, estimate, prior)]
    for T_object_rival, log_odds in zip(rivals.T_object_rivals, rivals.log_odds, strict=True):
        there = _at_rival(prior, T_object_rival)
        other = PoseEstimate.from_gaussian(there.T_palm_object, there.covariance, estimate.unobservable)
        found.append((float(log_odds), other, there))
    best, _, others = _likeliest(found)
    return with_others(model, best, others)


def _likeliest(
    found: Sequence[tuple[float, PoseEstimate, PosePrior]],
) -> tuple[PoseEstimate, PosePrior, list[np.void]]:
    """Returns the likeliest of several (log weight, estimate, prior), and the best mode (ANSWER) of each of the others,
    weighed against it."""
    (log_best, best, prior), *rest = sorted(found, key=lambda one: -one[0])
    others = list[np.void]()
    for log_weight, other, _ in rest:
        others.append(other.answer.copy())
        others[-1]["weight"] = best.answer["weight"] * math.exp(log_weight - log_best)
    return best, prior, others


def _at_rival(prior: PosePrior, T_object_rival: Array) -> PosePrior:
    """Returns a prior for a rival (4, 4), whose pose is known as well as that of a prior."""
    there = GaussianPose(prior.T_palm_object, prior.covariance).at_point(T_object_rival[:3, 3])
    return PosePrior.trusted(prior.T_palm_object @ T_object_rival, there.covariance)


def normalised(log_weights: Array) -> Array:
    """Returns the weights of these logarithms (k,), divided by their sum."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def log_evidence(model: ObjectModel, estimate: PoseEstimate, prior: PosePrior) -> float:
    """Returns the log density of all touch under a prior, up to a constant that is the same for all priors.

    It is Laplace's approximation at each mode. A contact that was rejected counts as if it were just as far off as is
    rejected, and so does the weight, so that rejecting a measurement does not pay.
    """
    row = estimate.modes[0]
    radius = model.radius
    if row["departure"] > INTEGRATION.max_gaussian_rise:  # a mean, whose volume was integrated
        log_weight = float(row["log_weight"])
    else:
        values = np.linalg.eigvalsh(in_metres(row["information"], radius))
        log_weight = -0.5 * float(row["posterior_cost"] + np.log(np.maximum(values, 1e-9 / radius**2)).sum())
    log_weight -= math.log(row["weight"])
    used = max(len(estimate.residual_rows) - len(estimate.outliers), 1)
    log_spread = float(row["posterior_cost"] - row["chi2"]) / used
    log_weight -= 0.5 * len(estimate.outliers) * (ACCEPTANCE.decisive + log_spread)
    log_weight -= 0.5 * CONTRADICTS * (estimate.weight_fits is False)
    information = np.asarray(np.linalg.inv(prior.covariance), dtype=np.float64)
    for spin in tangents(model.symmetries, prior.T_palm_object):  # about which a prior says nothing
        along = information @ spin
        information -= np.outer(along, along) / (spin @ along)
    values = np.linalg.eigvalsh(in_metres(information, radius))[len(model.symmetries.axes) :]
    return log_weight + 0.5 * float(np.log(values).sum())
