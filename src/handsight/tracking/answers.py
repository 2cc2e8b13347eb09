"""What a belief, or a correction some time ago, says of the pose now."""

from dataclasses import replace

import numpy as np

from handsight.checks import Array
from handsight.correction import Hypothesis, PoseEstimate, Residuals
from handsight.objects import ObjectModel
from handsight.tracking.belief import Belief, grown

EYE_6 = np.eye(6)


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


def sigma_position(estimate: PoseEstimate, model: ObjectModel) -> float:
    """Largest standard deviation of the position of the object's middle [m], along no declared symmetry."""
    scaled = estimate.information.copy()
    scaled[:, 3:] /= model.radius
    scaled[3:] /= model.radius
    values, vectors = np.linalg.eigh(scaled)
    # What a declared axis leaves at zero is no uncertainty.
    spread = np.where(values > 1e-9 * max(values[-1], 1e-300), 1 / np.maximum(values, 1e-300), 0.0)
    position = (vectors[:3] * spread) @ vectors[:3].T
    return float(np.sqrt(np.linalg.eigvalsh(position)[-1]))
