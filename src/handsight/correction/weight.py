"""The object's weight as evidence of its pose: where its centre of mass is, in the object and in the palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.correction.estimate import PoseEstimate
from handsight.correction.modes import chi2_limit
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import check_kept, kept_center
from handsight.representation import short_repr

CONTRADICTS = chi2_limit(3, 0.01)
"""χ² of three numbers that one right measurement in a hundred exceeds."""


@dataclass(frozen=True, slots=True, eq=False)
class WeightEvidence:
    """A `WeightEvidence` says where an object's centre of mass is: in the object, and in the palm by the loads on the
    fingertips."""

    center_object: Array
    """(3,) [m]"""
    center_palm: Array
    """(3,) [m]"""
    covariance: Array
    """(3, 3) of both together, along the palm's axes, positive definite [m²]."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        for name in ("center_object", "center_palm"):
            object.__setattr__(self, name, checks.in_reach(getattr(self, name), f"weight.{name}", (3,)))
        covariance = checks.covariance(self.covariance, "weight.covariance", (3, 3))
        if not np.linalg.eigvalsh(covariance)[0] > 0:
            raise InvalidInput("weight.covariance: expected a positive definite one, got a singular one")
        object.__setattr__(self, "covariance", covariance)

    def added_to(self, constraints: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of CONSTRAINTS (1,) with this evidence in it."""
        record = constraints.copy()
        weight = record[0]["weight"]
        weight["known"], weight["center_object"] = True, self.center_object
        weight["center_palm"], weight["information"] = self.center_palm, np.linalg.inv(self.covariance)
        return record

    def of(self, model: ObjectModel) -> WeightEvidence:
        """Returns the evidence about an object, whose symmetries must leave the centre of mass in place, moved to where
        they do exactly; raises InvalidInput where they move it farther than its error."""
        center = kept_center(model.symmetries, self.center_object)
        # A symmetry that moves it by more than two sigmas is not one of an object that weighs like this.
        limit = 2.0 * float(np.sqrt(np.trace(self.covariance) / 3))
        check_kept(center, self.center_object, limit, "weight.center_object")
        return WeightEvidence(center, self.center_palm, self.covariance)

    def contradicts(self, estimate: PoseEstimate) -> bool:
        """Returns whether all other evidence contradicts the weight at the pose that was found with it.

        With J the derivative of the residuals, Σ their covariance and C that of the pose, the residuals at the pose
        have the covariance Σ - J C Jᵀ: the smaller, the more the weight itself has determined the pose. Directions in
        which that is below a fiftieth of Σ count as a fiftieth.
        """
        T, C = estimate.T_palm_object, estimate.bounded_covariance
        arm = T[:3, :3] @ self.center_object
        J = se3.point_jacobian(arm)[:3]
        root = np.linalg.cholesky(self.covariance)
        off = np.linalg.solve(root, T[:3, 3] + arm - self.center_palm)
        whitened = np.linalg.solve(root, J)
        values, vectors = np.linalg.eigh(np.eye(3) - whitened @ C @ whitened.T)
        along = (vectors.T @ off) ** 2
        return bool((along / np.maximum(values, 0.02)).sum() > CONTRADICTS)
