"""What a belief, or a correction some time ago, says of the pose now."""

from dataclasses import replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import Hypothesis, PoseEstimate, Residuals
from handsight.objects import ObjectModel
from handsight.tracking.smoother import Belief, grown

EYE_3, EYE_6 = np.eye(3), np.eye(6)


def by_belief(belief: Belief) -> PoseEstimate:
    """The pose without any touch: every direction is open to it."""
    covariance = belief.pose_covariance
    information: Array = np.linalg.inv(covariance).astype(np.float64)
    none = np.empty(0)
    return PoseEstimate(
        T_palm_object=belief.T_palm_object,
        covariance=covariance,
        information=information,
        converged=True,
        iterations=0,
        residuals=Residuals(none, none),
        unobservable=EYE_6,
        consistent=True,
        outliers=(),
        hypotheses=(Hypothesis(belief.T_palm_object, information, covariance, 1.0, 0.0),),
    )


def held(estimate: PoseEstimate, variance: Array) -> PoseEstimate:
    """The estimate after the object may have walked in the palm by `variance` (6,)."""
    information = grown(estimate.information, variance)
    covariance = None if estimate.covariance is None else estimate.covariance + np.diag(variance)
    return replace(estimate, information=information, covariance=covariance)


def known_covariance(information: Array, radius: float) -> Array:
    """(6, 6) the inverse of an information (6, 6); what a declared axis leaves at zero is no uncertainty."""
    scale = np.array([1.0, 1, 1, 1 / radius, 1 / radius, 1 / radius])
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    spread = np.where(values > 1e-9 * max(values[-1], 1e-300), 1 / np.maximum(values, 1e-300), 0.0)
    root = scale[:, None] * vectors
    return np.asarray((root * spread) @ root.T)


def point_covariance(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> Array:
    """(3, 3) of the place in the palm [m] of a point fixed on the object (3,), along no declared symmetry."""
    by_pose = np.hstack([EYE_3, -se3.skew(estimate.T_palm_object[:3, :3] @ point_object)])
    return np.asarray(by_pose @ known_covariance(estimate.information, model.radius) @ by_pose.T)


def sigma_position(estimate: PoseEstimate, model: ObjectModel) -> float:
    """Largest standard deviation of the position of the object's middle [m], along no declared symmetry."""
    return float(np.sqrt(np.linalg.eigvalsh(point_covariance(estimate, model, model.center_object))[-1]))
