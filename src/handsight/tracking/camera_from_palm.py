"""The constant error of a camera's calibration, measured by the hand itself in the camera's images.

The robot knows where its palm is; the camera, placed as it was calibrated, detects the palm elsewhere, off by the
calibration's error, and the object is off by the same error. One detection measures that error with the detection's
covariance. Detections from one side share their error, above all by the joints' offsets, so only one of them counts.
"""

from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.gaussian_pose import GaussianPose

OTHER_SIDE = 0.1, float(np.deg2rad(20.0))
"""A palm that is farther away [m], or turned by more [rad], is detected from another side."""
AGREE_CHI2 = 22.5
"""χ² of six numbers that one in a thousand exceeds: beyond it two views do not have the same error."""
IN_A_ROW = 3
"""How many views in a row must agree before they are believed, also against what was believed before."""


@dataclass(frozen=True, slots=True, eq=False)
class HandView:
    """A `HandView` is the palm in the camera's mount at one instant, as the robot and as the camera have it."""

    T_mount_palm: Array
    """(4, 4) by the robot's joints."""
    pose_mount_palm: GaussianPose
    """As the camera detects it."""

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) where the camera should detect a palm that is at T_mount_palm (4, 4)."""
        return np.asarray(self.pose_mount_palm.T_a_b @ se3.inverse(self.T_mount_palm) @ T_mount_palm)

    def bias(self, pivot: Array) -> GaussianPose:
        """Returns vision's bias about a pivot (3,) in the mount [m], as `PoseAndBias.T_measured_true` defines it."""
        pivot_palm = se3.apply(se3.inverse(self.T_mount_palm), pivot[None])[0]
        detected = self.pose_mount_palm.at_point(pivot_palm)
        R = detected.T_a_b[:3, :3] @ self.T_mount_palm[:3, :3].T
        return GaussianPose(se3.compose(R, detected.T_a_b[:3, 3] - pivot), detected.covariance)

    def agrees(self, other: "HandView") -> bool:
        """Returns whether both views may have the same error."""
        pivot = self.T_mount_palm[:3, 3]
        mine, theirs = self.bias(pivot), other.bias(pivot)
        off = se3.difference(theirs.T_a_b, mine.T_a_b)
        return bool(off @ np.linalg.solve(mine.covariance + theirs.covariance, off) < AGREE_CHI2)

    def same_side(self, other: "HandView") -> bool:
        """Returns whether the camera sees the palm from about the same side as in another view."""
        off = se3.difference(self.pose_mount_palm.T_a_b, other.pose_mount_palm.T_a_b)
        return bool(np.linalg.norm(off[:3]) < OTHER_SIDE[0] and np.linalg.norm(off[3:]) < OTHER_SIDE[1])


@dataclass(frozen=True, slots=True, eq=False)
class CameraFromPalm:
    """A `CameraFromPalm` is what views of the hand have measured of the camera's error so far."""

    believed: tuple[HandView, ...] = ()
    """One from each side."""
    recent: tuple[HandView, ...] = ()
    """The last ones, each agreeing with the one before."""

    def updated(self, view: HandView) -> "CameraFromPalm":
        """Returns the value after another view.

        A view that agrees with those just before it is believed, unless one from its side is believed already. It
        replaces all that was believed if one of these contradicts it.
        """
        agrees = self.recent and view.agrees(self.recent[-1])
        recent = (*self.recent[1 - IN_A_ROW :], view) if agrees else (view,)
        believed = self.believed
        if len(recent) == IN_A_ROW:
            if not all(view.agrees(old) for old in believed):
                believed = (view,)
            elif not any(view.same_side(old) for old in believed):
                believed = (*believed, view)
        return replace(self, believed=believed, recent=recent)
