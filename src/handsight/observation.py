"""What a robot measured at one instant.

A measurement that was not taken is None, or has no entry in its mapping; no number stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.representation import short_repr

VisionFrame = Literal["camera", "world", "palm"]
MAX_STAMP = 1e11
"""Largest stamp [s], some 3000 years; a larger one is in milliseconds or nanoseconds."""
MAX_JUMP = 1.0
"""A stamp that differs by more from the one before it is a jump of the clock, which later stamps must confirm [s]."""
MAX_PIXEL = 1e6
"""Largest column or row of a detection."""
VISION_FRAMES: tuple[VisionFrame, ...] = ("camera", "world", "palm")


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """The object's pose as vision measured it."""

    T_frame_object: Array
    """(4, 4) pose of the object in `frame`."""
    frame: VisionFrame = "camera"
    """Frame of the pose: the rig's camera (optical frame), the world or the palm."""
    covariance: Array | None = None
    """(6, 6) covariance of (δp [m], δθ [rad]) along the frame's axes; None: the sigmas of the rig's camera are used."""
    stamp: float | None = None
    """Time at which the image was taken, on the observation's clock [s]; None: the observation's stamp."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_frame_object", se3.check(self.T_frame_object, "vision.T_frame_object"))
        if not isinstance(self.frame, str) or self.frame not in VISION_FRAMES:
            known = ", ".join(VISION_FRAMES)
            came = checks.brief(repr(self.frame))
            raise InvalidInput(f"vision.frame: expected one of {known}, got {came}")
        if self.covariance is not None:
            covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
            object.__setattr__(self, "covariance", covariance)
            covariance.setflags(write=False)
        if self.stamp is not None:
            object.__setattr__(self, "stamp", _checked_stamp(self.stamp, "vision.stamp"))
        self.T_frame_object.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class ContactMeasurement:
    """A contact from a fingertip that senses contacts directly, without a wrench."""

    point: Array
    """(3,) position [m]."""
    normal: Array
    """(3,) direction in which the object pushes the tip, of any length; one that points out of the tip is reversed."""
    frame: str = "tip"
    """Frame of point and normal: `tip` (the rig's: origin at the surface's centre, the tip points along +z), `palm`, or
    the name of the body that the tip moves with."""
    force: float | None = None
    """Force along the normal [N]; None: not measured. Below the tip's `min_force` there is no contact."""
    covariance: Array | None = None
    """(6, 6) covariance of point [m] and normal [rad] along the frame's axes, without the joints' errors; None: the
    sigmas of the rig's finger are used."""

    __repr__ = short_repr

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
class Detection2D:
    """Where another detector has an object in an image; no pose belongs to it."""

    label: str = ""
    """The name of the object, or its number as text; empty: it may be any."""
    score: float | None = None
    """The detector's confidence in (0, 1]; None: unknown."""
    box: tuple[float, float, float, float] | None = None
    """u0, v0, u1, v1: first column and row, last column and row [pixels]; None: unknown."""
    mask: NDArray[np.bool_] | None = None
    """(h, w) the object's pixels; None: all in the box."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.box is not None:
            corners = checks.finite(self.box, "detection.box", (4,))
            if (corners[2:] < corners[:2]).any() or np.abs(corners).max() > MAX_PIXEL:
                expected = f"expected u0 <= u1, v0 <= v1 within {MAX_PIXEL:g} pixels"
                raise InvalidInput(f"detection.box: {expected}, got {checks.brief(corners)}")
        if self.score is not None and checks.positive(self.score, "detection.score") > 1:
            expected = "expected a number above 0 and at most 1"
            raise InvalidInput(f"detection.score: {expected}, got {self.score:g}")


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Joints, wrenches, vision and the palm's pose at one instant, those that were measured.

    Its arrays belong to the caller, who may change them. So they are checked when they are used: by `Tracker.update`,
    or by a writer of recordings.
    """

    stamp: float
    """Time [s] within ± `MAX_STAMP`; the whole observation has one clock."""
    joint_positions: Mapping[str, float] | None = None
    """Positions by joint name [rad]; joints of other parts of the robot may be among them."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By finger: (6,) raw force [N] and torque [N m] in the sensor's frame, about its origin, which still include bias
    and the tip's weight; NaN where the sensor has no reading."""
    vision: PoseMeasurement | None = None
    """Pose from vision, if one has arrived since the last observation."""
    T_world_palm: Array | None = None
    """(4, 4) pose of the palm in the world."""
    color: NDArray[np.uint8] | None = None
    """(h, w, 3) image in red, green, blue, if one has arrived since the last observation."""
    depth: NDArray[np.float32] | None = None
    """(h, w) depth along the optical axis, if an image has arrived [m]; NaN for pixels without depth."""
    image_stamp: float | None = None
    """Time at which the images were taken, on the same clock [s]; None: `stamp`."""
    contacts: Mapping[str, ContactMeasurement | None] = field(default_factory=dict)
    """By finger, the contact of a tip that senses it directly; None: the tip touches nothing. A finger in this mapping
    gets no contact from its wrench."""
    skin: Mapping[str, Array] = field(default_factory=dict)
    """By tactile array: (rows, columns) readings of its taxels, NaN where a taxel has no reading."""
    detections: tuple[Detection2D, ...] | None = None
    """Where another detector has objects in an image, if its answer has arrived since the last observation."""
    mask: NDArray[np.integer] | None = None
    """(h, w) which object each pixel of an image is of, by label, 0: none, if such an image has arrived."""

    __repr__ = short_repr


def check_observation(observation: Observation) -> Observation:
    """Returns the observation with its stamp as a float and a copy of `T_world_palm`; raises InvalidInput.

    Joint positions, wrenches and images are checked by the functions that use them, which know the joints and fingers.
    """
    if not isinstance(observation, Observation):
        raise InvalidInput(f"observation: expected an Observation, got {type(observation).__name__}")
    stamp = observation.stamp
    vision = observation.vision
    T = observation.T_world_palm
    stamp = _checked_stamp(stamp, "observation.stamp")
    for name in ("wrenches", "contacts", "skin"):
        given = getattr(observation, name)
        if not isinstance(given, Mapping):
            raise InvalidInput(f"observation.{name}: expected a mapping by name, got {checks.brief(given)}")
    if vision is not None and not isinstance(vision, PoseMeasurement):
        came = type(vision).__name__
        raise InvalidInput(f"observation.vision: expected a PoseMeasurement or None, got {came}")
    if T is not None:
        T = se3.check(T, "observation.T_world_palm")
        T.setflags(write=False)
    image_stamp = observation.image_stamp
    if image_stamp is not None:
        image_stamp = _checked_stamp(image_stamp, "observation.image_stamp")
    return replace(observation, stamp=stamp, T_world_palm=T, image_stamp=image_stamp)


def seconds(now: float, then: float) -> float:
    """Returns the time between two stamps [s], to the microsecond.

    Stamps that count from 1970 are rounded to a quarter of one: so a recording is answered alike whenever it was made.
    """
    return round(now - then, 6)


def _checked_stamp(stamp: float, name: str) -> float:
    """Returns a stamp [s] as a float; raises InvalidInput where it is not a plausible time in seconds."""
    number = float(checks.finite(stamp, name, ()))
    if abs(number) > MAX_STAMP:
        expected = f"expected seconds within {MAX_STAMP:g}"
        raise InvalidInput(f"{name}: {expected}, got {number:g} (milliseconds or nanoseconds?)")
    return number
