"""A pose with its covariance, and how a change of frame, process noise and a measurement change both.

The covariance is 6 x 6, of the perturbation (δp [m], δθ [rad]) with `p + δp` and `exp(δθ) R`, both along the axes of
the outer frame (ROS' PoseWithCovariance has the same convention).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.representation import short_repr


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPose:
    """The pose of a frame b in a frame a, with its covariance.

    The names of variables say which two frames these are: `pose_mount_object` is the object's pose in the mount.
    """

    T_a_b: Array
    """(4, 4)."""
    covariance: Array
    """(6, 6) of (δp [m], δθ [rad]) of b's origin, along a's axes; positive semidefinite."""

    __repr__ = short_repr

    @classmethod
    def checked(cls, T_a_b: ArrayLike, covariance: ArrayLike, name: str) -> "GaussianPose":
        """Returns a pose from a user's arrays; raises InvalidInput with a message that begins with `name`."""
        T = se3.check(T_a_b, f"{name}.T_a_b")
        return cls(T, checks.covariance(covariance, f"{name}.covariance", (6, 6)))

    def transformed(self, T_c_a: Array) -> "GaussianPose":
        """Returns the pose of b in another frame c, given a's exact pose in c (4, 4)."""
        return GaussianPose(T_c_a @ self.T_a_b, se3.rotate_covariance(T_c_a[:3, :3], self.covariance))

    def at_point(self, point_b: Array) -> "GaussianPose":
        """Returns the pose of a frame with b's axes whose origin is a point (3,) of b [m]."""
        arm = self.T_a_b[:3, :3] @ point_b
        J = se3.point_jacobian(arm)
        T = se3.compose(self.T_a_b[:3, :3], self.T_a_b[:3, 3] + arm)
        return GaussianPose(T, J @ self.covariance @ J.T)

    def inflated(self, variance: Array) -> "GaussianPose":
        """Returns the pose with process noise of `variance` (6,) added to its covariance [m², rad²]."""
        return GaussianPose(self.T_a_b, self.covariance + np.diag(variance))


def stretched(direction: Array, along: float, across: float) -> Array:
    """Returns what to add to the covariance (3, 3) of a sigma `across` per axis, so that the sigma along a unit
    direction (3,) is `along`."""
    return np.asarray((along**2 - across**2) * np.outer(direction, direction))


def kalman_update(
    covariance: Array, H: Array, residual: Array, measurement_covariance: Array
) -> tuple[Array, Array]:
    """Returns the step (n,) of the mean, and the covariance (n, n), after a linear measurement of m numbers.

    `covariance` (n, n) is the covariance before the measurement, `H` (m, n) the derivative of the measurement by the
    state, `residual` (m,) the measured value less the expected one, and `measurement_covariance` (m, m) the covariance
    of the measurement's noise. The update is in Joseph's form, which stays positive semidefinite under rounding.
    """
    gain = np.linalg.solve(H @ covariance @ H.T + measurement_covariance, H @ covariance).T
    keep = np.eye(len(covariance)) - gain @ H
    after = keep @ covariance @ keep.T + gain @ measurement_covariance @ gain.T
    return gain @ residual, (after + after.T) / 2
