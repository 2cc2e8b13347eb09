"""The constant error of a camera's calibration, measured by the hand itself in the camera's images.

The robot knows its palm's pose. The camera, at its calibrated pose, detects the palm elsewhere: off by the error of
the calibration, and the object is off by the same error. So one detection of the palm measures that error, with the
detection's covariance. Detections from one side have common errors, mainly the joints' offsets, so only one counts.
"""

from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.gaussian_pose import GaussianPose

OTHER_SIDE_POSITION = 0.1
"""A palm that has moved farther in the mount is detected from another side [m]."""
OTHER_SIDE_ROTATION = float(np.deg2rad(20))  # the same for its rotation [rad]
AGREEMENT_CHI2 = 22.5
"""χ² of six numbers that one in a thousand exceeds: beyond it two views do not have the same error."""
IN_A_ROW = 3
"""A view is confirmed once so many in a row agree, even if they contradict what was confirmed before."""


@dataclass(frozen=True, slots=True, eq=False)
class HandView:
    """The palm's pose in the camera's mount at one instant, by the robot and by the camera."""

    T_mount_palm: Array
    """(4, 4) by the robot's joints."""
    pose_mount_palm: GaussianPose
    """By the camera's detection, with the camera at its calibrated pose."""

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) the pose at which the camera should detect a palm that is at T_mount_palm (4, 4)."""
        return np.asarray(self.pose_mount_palm.T_a_b @ se3.inverse(self.T_mount_palm) @ T_mount_palm)

    def bias(self, pivot: Array) -> GaussianPose:
        """Returns vision's bias about a pivot (3,) in the mount [m], see `PoseAndBias.T_measured_true`."""
        pivot_palm = se3.apply(se3.inverse(self.T_mount_palm), pivot[None])[0]
        detected = self.pose_mount_palm.at_point(pivot_palm)
        R = detected.T_a_b[:3, :3] @ self.T_mount_palm[:3, :3].T
        return GaussianPose(se3.compose(R, detected.T_a_b[:3, 3] - pivot), detected.covariance)

    def agrees(self, other: "HandView") -> bool:
        """Returns whether both views may have the same error."""
        pivot = self.T_mount_palm[:3, 3]
        mine, theirs = self.bias(pivot), other.bias(pivot)
        off = se3.difference(theirs.T_a_b, mine.T_a_b)
        return bool(off @ np.linalg.solve(mine.covariance + theirs.covariance, off) < AGREEMENT_CHI2)

    def same_side(self, other: "HandView") -> bool:
        """Returns whether the camera detected the palm from about the same side as in another view."""
        off = se3.difference(self.pose_mount_palm.T_a_b, other.pose_mount_palm.T_a_b)
        shift = np.linalg.norm(off[:3])
        turn = np.linalg.norm(off[3:])
        return bool(shift < OTHER_SIDE_POSITION and turn < OTHER_SIDE_ROTATION)


@dataclass(frozen=True, slots=True, eq=False)
class CameraFromPalm:
    """The camera's error, as views of the hand have measured it so far."""

    confirmed: tuple[HandView, ...] = ()
    """The views that count, one from each side."""
    recent: tuple[HandView, ...] = ()
    """The last views, as many as agree with the one before them, at most `IN_A_ROW`."""

    def updated(self, view: HandView) -> "CameraFromPalm":
        """Returns the value after another view.

        A view that agrees with those just before it is confirmed, unless one from its side is confirmed already. If it
        contradicts a confirmed view, it replaces all of them.
        """
        agrees = self.recent and view.agrees(self.recent[-1])
        recent = (*self.recent[1 - IN_A_ROW :], view) if agrees else (view,)
        confirmed = self.confirmed
        if len(recent) == IN_A_ROW:
            if not all(view.agrees(old) for old in confirmed):
                confirmed = (view,)
            elif not any(view.same_side(old) for old in confirmed):
                confirmed = (*confirmed, view)
        return CameraFromPalm(confirmed, recent)
