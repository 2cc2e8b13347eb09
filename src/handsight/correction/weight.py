"""The object's weight as evidence of its pose: its centre of mass in the object, and as measured in the palm."""

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
"""The 99 % quantile of χ² with three degrees of freedom."""


@dataclass(frozen=True, slots=True, eq=False)
class WeightEvidence:
    """An object's centre of mass in the object, and in the palm by the fingertips' loads."""

    center_object: Array
    """(3,) position of the centre of mass in the object's frame [m]."""
    center_palm: Array
    """(3,) position of the centre of mass in the palm frame [m]."""
    covariance: Array
    """(3, 3) covariance of the difference of the two, along the palm's axes, positive definite [m²]."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        for name in ("center_object", "center_palm"):
            object.__setattr__(self, name, checks.in_reach(getattr(self, name), f"weight.{name}", (3,)))
        covariance = checks.covariance(self.covariance, "weight.covariance", (3, 3))
        if not np.linalg.eigvalsh(covariance)[0] >= checks.MIN_SIGMA**2:
            raise InvalidInput("weight.covariance: expected a positive definite one, got a singular one")
        object.__setattr__(self, "covariance", covariance)

    def added_to(self, constraints: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of CONSTRAINTS (1,) with this evidence in it."""
        record = constraints.copy()
        weight = record[0]["weight"]
        weight["known"] = True
        weight["center_object"] = self.center_object
        weight["center_palm"] = self.center_palm
        weight["information"] = np.linalg.inv(self.covariance)
        return record

    def of(self, model: ObjectModel) -> WeightEvidence:
        """Returns the evidence with the centre of mass moved to the nearest point that the object's symmetries leave in
        place; raises InvalidInput where that is more than two standard deviations and 1 mm away."""
        center = kept_center(model.symmetries, self.center_object)
        limit = 2.0 * float(np.sqrt(np.trace(self.covariance) / 3))
        check_kept(center, self.center_object, limit, "weight.center_object")
        return WeightEvidence(center, self.center_palm, self.covariance)

    def contradicts(self, estimate: PoseEstimate) -> bool:
        """Returns whether all other evidence contradicts the weight, at the estimate that was found with it.

        It is a χ² test of the residuals. With J their derivative by the pose, Σ their covariance and C that of the
        pose, their covariance at the estimate is Σ - J C Jᵀ: the more the weight itself has determined the pose, the
        smaller it is. It is taken to be at least Σ / 50 in every direction.
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
