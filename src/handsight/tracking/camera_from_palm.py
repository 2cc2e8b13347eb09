"""A camera's constant error, measured: the hand itself was seen in its images.

The robot knows where its palm is; where the camera, placed as it was calibrated, sees it is off by the calibration's
error, which is the same for the object. One view says so with the covariance of the seen hand. Views from one side are
wrong together, by the joints' offsets above all, so only one of them counts.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from handsight import se3
from handsight.checks import Array

OTHER_SIDE = 0.1, float(np.deg2rad(20.0))
"""A palm that is farther off [m], or turned by more [rad], in the camera is seen from another side."""
AGREE_CHI2 = 22.5
"""χ² of six numbers that one in a thousand exceeds: such views are of two cameras, or one of them is wrong."""
IN_A_ROW = 3
"""So many views that agree are believed, and so many that contradict what was believed end that."""


@dataclass(frozen=True, slots=True, eq=False)
class HandView:
    """A `HandView` is the palm in the camera's mount at one instant."""

    T_mount_palm: Array
    """(4, 4) where the robot knows it."""
    T_mount_palm_detected: Array
    """(4, 4) where the camera sees it."""
    covariance: Array
    """(6, 6) of what is seen, (δp, δθ) along the mount's axes."""

    def expected(self, T_mount_palm: Array) -> Array:
        """Returns (4, 4) where the camera should see a palm that is elsewhere, T_mount_palm (4, 4)."""
        return np.asarray(self.T_mount_palm_detected @ se3.inverse(self.T_mount_palm) @ T_mount_palm)

    def bias(self, pivot: Array) -> tuple[Array, Array]:
        """Returns what it says of vision's bias about a pivot (3,) in the mount [m]: (4, 4) as
        `PoseAndBias.T_measured_true` has it, and its covariance (6, 6)."""
        E = self.T_mount_palm_detected @ se3.inverse(self.T_mount_palm)
        R, arm = E[:3, :3], E[:3, :3] @ (pivot - self.T_mount_palm[:3, 3])
        to_pivot = se3.point_jacobian(arm)
        shift = E[:3, 3] + R @ pivot - pivot
        return se3.compose(R, shift), to_pivot @ self.covariance @ to_pivot.T

    def agrees(self, other: "HandView") -> bool:
        """Returns whether both may be of one camera."""
        pivot = self.T_mount_palm[:3, 3]
        (mine, covariance), (theirs, more) = self.bias(pivot), other.bias(pivot)
        off = se3.difference(theirs, mine)
        return bool(off @ np.linalg.solve(covariance + more, off) < AGREE_CHI2)

    def same_side(self, other: "HandView") -> bool:
        """Returns whether the palm is seen about as in another view."""
        # Of one camera: where its own frame is does not matter.
        off = se3.difference(self.T_mount_palm_detected, other.T_mount_palm_detected)
        return bool(np.linalg.norm(off[:3]) < OTHER_SIDE[0] and np.linalg.norm(off[3:]) < OTHER_SIDE[1])


@dataclass(frozen=True, slots=True, eq=False)
class CameraFromPalm:
    """A `CameraFromPalm` is what views of the hand have said of the camera so far."""

    believed: tuple[HandView, ...] = ()
    """One from each side."""
    recent: tuple[HandView, ...] = field(default=())
    """The last ones, each agreeing with the one before."""

    def updated(self, view: HandView) -> "CameraFromPalm":
        """Returns the value after another view: it is believed once it has agreed with those just before, unless it
        is of a side that is known; and alone, if what was believed before contradicts it."""
        recent = (
            (*self.recent[1 - IN_A_ROW :], view) if self.recent and view.agrees(self.recent[-1]) else (view,)
        )
        after = replace(self, recent=recent)
        if len(recent) < IN_A_ROW:
            return after
        if not all(view.agrees(old) for old in self.believed):
            return replace(after, believed=(view,))
        if any(view.same_side(old) for old in self.believed):
            return after
        return replace(after, believed=(*self.believed, view))

    def biases(self, pivot: Array) -> Iterator[tuple[Array, Array]]:
        """Returns what each believed view says of vision's bias about a pivot."""
        return (view.bias(pivot) for view in self.believed)
