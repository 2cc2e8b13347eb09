"""What the robot measured at one instant.

What is missing is None, or not in the mapping: nothing stands for a reading that was not taken.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput

VisionFrame = Literal["camera", "world", "palm"]
MAX_STAMP = 1e11
"""No stamp is beyond it [s], some 3000 years: what is, is in milliseconds or nanoseconds."""
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
    stamp: float | None = None
    """When what it is seen in was taken [s], as the observation's; None: at the observation's."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_frame_object", se3.check(self.T_frame_object, "vision.T_frame_object"))
        if not isinstance(self.frame, str) or self.frame not in VISION_FRAMES:
            known, came = ", ".join(VISION_FRAMES), checks.brief(repr(self.frame))
            raise InvalidInput(f"vision.frame: expected one of {known}, got {came}")
        if self.covariance is not None:
            covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
            object.__setattr__(self, "covariance", covariance)
            covariance.setflags(write=False)
        if self.stamp is not None:
            object.__setattr__(self, "stamp", _seconds(self.stamp, "vision.stamp"))
        self.T_frame_object.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class ContactMeasurement:
    """Where a fingertip that senses contacts itself says it is touched."""

    point: Array
    """(3,) [m]."""
    normal: Array
    """(3,) the way the object pushes the tip. It is turned to lead into the tip, and its length does not matter."""
    frame: str = "tip"
    """In what both are given: `tip` (the rig's: origin at the surface's centre, the tip points along +z), `palm`, or
    the name of the body that the tip moves with."""
    force: float | None = None
    """Along the normal [N]; None: it does not say. Below the tip's `min_force` there is no contact."""
    covariance: Array | None = None
    """(6, 6) of point [m] and normal [rad] along the frame's axes, the joints' errors not in it; None: as the rig's
    finger says."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", checks.position(self.point, "contact.point", (3,)))
        object.__setattr__(self, "normal", checks.unit(self.normal, "contact.normal", (3,)))
        if not isinstance(self.frame, str) or not self.frame:
            came = checks.brief(repr(self.frame))
            raise InvalidInput(f"contact.frame: expected tip, palm or the name of a body, got {came}")
        if self.force is not None:
            checks.load(self.force, "contact.force", ())
        if self.covariance is not None:
            covariance = checks.covariance(self.covariance, "contact.covariance", (6, 6))
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Joints, wrenches, vision and the palm's pose at one instant, each only if it was measured.

    It is checked where it is used, as its arrays are the caller's: by `Tracker.update`, or where it is written.
    """

    stamp: float
    """When [s], of one clock for all that is in it; within `MAX_STAMP`."""
    joint_positions: Mapping[str, float] | None = None
    """By joint name [rad]; joints of other parts of the robot may be among them."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By finger: (6,) force [N] and torque [N m] as the sensor reads them, in its frame and about its origin, bias
    and weight still in them. NaN among them: the sensor has no reading. Sensors of other parts of the robot may be
    among them."""
    vision: PoseMeasurement | None = None
    """A pose from vision that arrived since the last observation."""
    T_world_palm: Array | None = None
    """(4, 4)."""
    color: NDArray[np.uint8] | None = None
    """(h, w, 3) red, green, blue; an image that arrived since the last observation."""
    depth: NDArray[np.float32] | None = None
    """(h, w) along the optical axis [m], NaN where there is none."""
    image_stamp: float | None = None
    """When the images were taken [s], of the same clock; None: at `stamp`."""
    contacts: Mapping[str, ContactMeasurement | None] = field(default_factory=dict)
    """By finger, of tips that sense contacts themselves; None: it says that it touches nothing. Such a finger's
    wrench is not asked for a contact."""
    skin: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """By tactile array: (rows, columns) what its taxels read; NaN: that taxel reads nothing."""


def check_observation(observation: Observation) -> Observation:
    """The observation with its stamp as a float and a `T_world_palm` of its own; raises InvalidInput.

    Joint positions, wrenches and images are left to those who read them: they know of which joints and fingers.
    """
    if not isinstance(observation, Observation):
        raise InvalidInput(f"observation: expected an Observation, got {type(observation).__name__}")
    stamp, vision, T = observation.stamp, observation.vision, observation.T_world_palm
    if type(stamp) is not float or not -MAX_STAMP <= stamp <= MAX_STAMP:
        stamp = _seconds(stamp, "observation.stamp")
    if vision is not None and not isinstance(vision, PoseMeasurement):
        came = type(vision).__name__
        raise InvalidInput(f"observation.vision: expected a PoseMeasurement or None, got {came}")
    if T is not None:
        T = se3.check(T, "observation.T_world_palm")
        T.setflags(write=False)
    joints, wrenches, taken = observation.joint_positions, observation.wrenches, observation.image_stamp
    if taken is not None:
        taken = _seconds(taken, "observation.image_stamp")
    color, depth = observation.color, observation.depth
    touched = observation.contacts, observation.skin
    return Observation(stamp, joints, wrenches, vision, T, color, depth, taken, *touched)


def _seconds(stamp: float, name: str) -> float:
    """A stamp as a float; raises InvalidInput where it is none."""
    seconds = float(checks.finite(stamp, name, ()))
    if abs(seconds) > MAX_STAMP:
        expected = f"expected seconds within {MAX_STAMP:g}"
        raise InvalidInput(f"{name}: {expected}, got {seconds:g} (milliseconds or nanoseconds?)")
    return seconds
