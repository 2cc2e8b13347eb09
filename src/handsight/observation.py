"""What the robot measured at one instant.

What is missing is None, or not in the mapping: nothing stands for a reading that was not taken.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput

VisionFrame = Literal["camera", "world", "palm"]
VISION_FRAMES: tuple[VisionFrame, ...] = ("camera", "world", "palm")


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """Where vision says the object is."""

    T_frame_object: Array
    """(4, 4)."""
    frame: VisionFrame = "camera"
    """In what the pose is given: the rig's camera (optical frame), the world or the palm."""
    covariance: Array | None = None
    """(6, 6) of (δp [m], δθ [rad]) along the frame's axes; None: vision does not say, the rig does."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_frame_object", se3.check(self.T_frame_object, "vision.T_frame_object"))
        if self.frame not in VISION_FRAMES:
            known = ", ".join(VISION_FRAMES)
            raise InvalidInput(f"vision.frame: expected one of {known}, got {self.frame!r}")
        if self.covariance is not None:
            covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Joints, wrenches, vision and the palm's pose at one instant, each only if it was measured."""

    stamp: float
    """When [s], of one clock for all that is in it."""
    joint_positions: Mapping[str, float] | None = None
    """By joint name [rad]; joints of other parts of the robot may be among them."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By finger: (6,) force [N] and torque [N m] as the sensor reads them, in its frame and about its origin, bias
    and weight still in them."""
    vision: PoseMeasurement | None = None
    """A pose from vision that arrived since the last observation."""
    T_world_palm: Array | None = None
    """(4, 4)."""
    color: NDArray[np.uint8] | None = None
    """(h, w, 3) red, green, blue; an image that arrived since the last observation."""
    depth: NDArray[np.float32] | None = None
    """(h, w) along the optical axis [m], NaN where there is none."""
