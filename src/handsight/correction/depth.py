"""Points of a depth image as evidence, in place of the pose that was estimated from that image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.records import MOST_DEPTH_POINTS
from handsight.checks import Array
from handsight.correction.estimate import PosePrior
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.representation import short_repr


@dataclass(frozen=True, slots=True, eq=False)
class DepthPoints:
    """`DepthPoints` are points of one depth image that lie on the object's surface."""

    points_palm: Array
    """(n, 3) points in the palm frame, n from 1 to 48 [m]."""
    sigma: float
    """One standard deviation of a point's distance to the surface [m]. It must include errors that all points share:
    if n points share one error, sigma is √n times that error."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        points = np.array(checks.position(self.points_palm, "depth.points_palm", (None, 3)))
        if not 1 <= len(points) <= MOST_DEPTH_POINTS:
            expected = f"expected from 1 to {MOST_DEPTH_POINTS} points"
            raise InvalidInput(f"depth.points_palm: {expected}, got {len(points)}")
        points.flags.writeable = False
        object.__setattr__(self, "points_palm", points)
        object.__setattr__(self, "sigma", checks.sigma(self.sigma, "depth.sigma"))

    def __len__(self) -> int:
        return len(self.points_palm)

    @classmethod
    def of_image(cls, model: ObjectModel, points_palm: ArrayLike, vision: PosePrior) -> DepthPoints | None:
        """Returns the points of a depth image that are near the object's surface, evenly chosen; None without any.

        points_palm: (n, 3) floats [m], of the object and of its surroundings; NaN for pixels without a depth. vision:
        the object's pose in the palm that was estimated from the same image, with a positive definite covariance of all
        its errors: noise, the camera's constant error, the pose of the palm in the camera. The points share these
        errors, so their σ is the least with which all points together have no more information than that pose in any
        direction: σ² = λ_max(Σ Jᵀ J), with J the derivative of the distances by the pose and Σ the pose's covariance.
        So that pose must not be given as a prior as well. Raises InvalidInput.
        """
        points = np.asarray(points_palm)
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
            came = f"{points.dtype} of {points.shape}"
            raise InvalidInput(f"points_palm: expected floats of shape (n, 3), got {came}")
        points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
        T = vision.T_palm_object
        surface = model.evaluate(se3.apply(se3.inverse(T), checks.position(points, "points_palm", (None, 3))))
        near = np.flatnonzero(np.abs(surface.distance) < 0.05 * model.diameter)
        if not len(near):
            return None
        count = min(len(near), MOST_DEPTH_POINTS)
        near = near[np.arange(count) * len(near) // count]
        normals, arms = surface.gradient[near] @ T[:3, :3].T, points[near] - T[:3, 3]
        scale = np.repeat([1.0, model.radius], 3)
        by_pose = np.hstack([normals, np.cross(arms, normals)]) / scale
        try:
            root = np.linalg.cholesky(vision.covariance * np.outer(scale, scale))
        except np.linalg.LinAlgError:
            raise InvalidInput(
                "vision.covariance: expected a positive definite one, got a singular one"
            ) from None
        # The norm is the largest singular value.
        return cls(points[near], float(np.linalg.norm(by_pose @ root, 2)))

    def added_to(self, constraints: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of CONSTRAINTS (1,) with this evidence in it."""
        record = constraints.copy()
        depth = record[0]["depth"]
        depth["count"], depth["variance"] = len(self), self.sigma**2
        depth["points"][: len(self)] = self.points_palm
        return record
