"""Depth images as measurements: of the object's pose in the camera, and, by the hand, of the camera's own pose."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import MountedCamera, Rig
from handsight.tracking.camera_from_palm import CameraFromPalm, HandView
from handsight.tracking.hints import SearchHints
from handsight.tracking.smoother import STILL, Motion
from handsight.vision import FirstPoseSource, PalmDetection
from handsight.vision.depth_noise import PRESETS
from handsight.vision.object.depth_tracker import HIDDEN, DepthTracker
from handsight.vision.object.rivals import NO_RIVALS, Rivals
from handsight.vision.palm.hand_in_image import HandInImage

if TYPE_CHECKING:
    from handsight.tracking.concurrent_images import ConcurrentImages


CORRELATION_TIME = 1.0
"""Images within this time share their errors, which come from smoothing, bias and the visible side [s]."""
PALM_PERIOD = 0.5
"""Time between two searches for a palm that was detected; in between, its pose follows from the joints [s]."""
SIGMA_PALM_POSITION = 0.01
"""Uncertainty of the palm's position in the next image once it was detected, per axis [m]."""
SIGMA_PALM_ROTATION = float(np.deg2rad(3))  # the same of its rotation [rad]
HISTORY_SECONDS = 1.0  # how long joints and palm are kept: an image arrives later than it was taken [s]
PALM_TWIST = 0.03
"""Time before and after an instant, between which the velocity of the palm is measured [s]."""
SLACK = 0.1  # by which a stamp may be older than that [s]
MOST_INSTANTS = 2000  # that are kept, however fast they come
STAMP = attrgetter("stamp")


class Instant(NamedTuple):
    """The joint positions and the palm's pose at one stamp; None where they were not measured."""

    stamp: float
    joint_positions: Mapping[str, float] | None
    T_world_palm: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """The instants of the last second, and the one before them."""

    instants: tuple[Instant, ...] = ()
    """In the order of their stamps."""

    def after(self, instant: Instant) -> History:
        """Returns the history with one more instant, which replaces one of the same stamp."""
        before = self.instants
        if before and before[-1].stamp == instant.stamp:
            before = before[:-1]
        first = bisect_left(before, instant.stamp - HISTORY_SECONDS - SLACK, key=STAMP) - 1
        return History((*before[max(first, len(before) - MOST_INSTANTS, 0) :], instant))

    def at(self, stamp: float | None) -> Instant | None:
        """Returns the instant nearest to a stamp [s] (None: the last); None where the history is too short for it."""
        kept = self.instants
        if stamp is None or not kept:
            return kept[-1] if kept else None
        if stamp < max(kept[0].stamp, kept[-1].stamp - HISTORY_SECONDS) - SLACK:
            return None
        k = bisect_left(kept, stamp, key=STAMP)
        return min(kept[max(k - 1, 0) : k + 1], key=lambda instant: abs(instant.stamp - stamp))

    def palm_at(self, stamp: float, latency: float) -> tuple[Array, Motion] | None:
        """Returns T_world_palm (4, 4) when vision took what has a stamp, and how it moved; None where unknown.

        It is that of the instant nearest to the stamp less the latency [s]; its motion says how far it is from that.
        """
        then = self.at(stamp - latency)
        if then is None or then.T_world_palm is None:
            return None
        before = self.at(then.stamp - PALM_TWIST)
        after = self.at(then.stamp + PALM_TWIST)
        ends = [each for each in (before, after) if each is not None and each.T_world_palm is not None]
        twist = STILL.twist
        if len(ends) == 2 and ends[1].stamp > ends[0].stamp:
            moved = se3.difference(*(np.asarray(end.T_world_palm) for end in reversed(ends)))
            twist = moved / (ends[1].stamp - ends[0].stamp)
        return then.T_world_palm, Motion(twist, stamp - then.stamp)


class TakenImage(NamedTuple):
    """A depth image with what was known when it was taken."""

    stamp: float
    """[s]"""
    depth: Depth
    then: Instant
    from_palm: CameraFromPalm
    """The camera's error, as earlier images have measured it."""
    T_palm_object: Array | None
    """(4, 4) the pose of an object in the hand; None where it is not grasped."""
    source: FirstPoseSource
    """Finds the object where nothing else says where it is."""


class ImageResult(NamedTuple):
    """What an image has measured."""

    vision: PoseMeasurement | None
    """The object's pose in the camera; None where it was not detected."""
    hand: HandView | None
    """The palm in the image; None where it was not searched for, or not detected."""


class ImageVision:
    """Evaluates the images of a rig's depth camera for one object, over time."""

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        source: FirstPoseSource,
        *,
        on: bool,
        follow: Callable[[Rig, ObjectModel], ObjectInImages | ConcurrentImages],
    ) -> None:
        """`source`: finds the object where nothing else says where it is. `follow`: evaluates the images.

        Observations are left unchanged if it is not `on`, or if the rig has no camera with intrinsics.
        """
        named = rig.objects.get(model.name)
        self._hints = SearchHints(named.label or model.name if named else model.name, source)
        self._rig, self._model = rig, model
        self.history = History()
        """Joint positions and palm of the last second."""
        self._on = on and rig.camera is not None and rig.camera.intrinsics is not None
        self._follow = follow
        self._images: ObjectInImages | ConcurrentImages | None = None
        """None before the first depth image."""

    def copied(self) -> ImageVision:
        """Returns a copy that evolves apart from this one."""
        other = copy(self)
        if isinstance(other._images, ObjectInImages):
            other._images = copy(other._images)
            other._images.tracker = copy(other._images.tracker)
        return other

    def close(self) -> None:
        """Ends the thread of images that are evaluated beside the tracker's, if there is one."""
        if self._images is not None and not isinstance(self._images, ObjectInImages):
            self._images.close()

    @property
    def counts(self) -> dict[str, int]:
        """How many images were evaluated, and with what result; empty before the first image."""
        return {} if self._images is None else dict(self._images.counts)

    @property
    def rivals(self) -> Rivals:
        """Other poses that all images explain, in the frame of the object at the one that is followed."""
        return NO_RIVALS if self._images is None else self._images.rivals

    def observe(
        self, observation: Observation, from_palm: CameraFromPalm, T_palm_object: Array | None
    ) -> tuple[Observation, HandView | None]:
        """Returns the observation with an image's pose as its vision, and the palm in that image, None: not detected.

        The image is the observation's, or an earlier one. `from_palm`: the camera's error, as earlier images have
        measured it. `T_palm_object` (4, 4): the pose of an object in the hand; None where it is not grasped. Raises
        InvalidInput for an image that cannot be the camera's.
        """
        now = Instant(observation.stamp, observation.joint_positions, observation.T_world_palm)
        self.history = self.history.after(now)
        camera = self._rig.camera
        depth = observation.depth
        hand = None
        if self._on and camera is not None:
            self._hints = self._hints.after(observation)
            taken = None
            if depth is not None:
                self._images = self._images or self._follow(self._rig, self._model)
                stamp = observation.stamp if observation.image_stamp is None else observation.image_stamp
                if (then := self.history.at(stamp - camera.latency)) is not None:
                    source = self._hints.source()
                    taken = TakenImage(stamp, depth, then, from_palm, T_palm_object, source)
            result = None if self._images is None else self._images.evaluated(taken)
            if result is not None:
                hand, vision = result.hand, observation.vision
                # Where the image does not show the object, a pose from outside may still know where it is.
                if result.vision is not None or vision is None or vision.frame != "camera":
                    return replace(observation, vision=result.vision), hand
        vision = observation.vision
        followed = self._images is not None and not self._images.lost
        if followed and depth is None and vision is not None and vision.frame == "camera":
            # This camera's images are the better measurement, so poses that come between them are left out.
            observation = replace(observation, vision=None)
        return observation, hand


class ObjectInImages:
    """Follows the object in a camera's depth images, without the pixels of the hand."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """`rig`: its camera must have intrinsics."""
        self._mounted = camera = rig.camera or MountedCamera()
        self._camera = Camera.of(camera)
        self.tracker = DepthTracker(model, self._camera, noise=PRESETS[camera.depth_camera])
        self._hand = HandInImage(rig)
        self.lost = True
        """Whether the last image did not show the object."""
        self.rivals = NO_RIVALS
        """Other poses that all images explain, in the frame of the object at the one that is followed."""
        self._detected_at = self._palm_searched_at = -np.inf
        self.counts = {"looked_at": 0, "object_seen": 0, "hand_sought": 0, "hand_seen": 0}
        """The number of images, of those in which the object was detected, of searches for the palm, and of detections
        of the palm."""

    def _count(self, name: str) -> None:
        self.counts = {**self.counts, name: self.counts[name] + 1}

    def evaluated(self, taken: TakenImage | None) -> ImageResult | None:
        """Returns what an image measures; None for None. Raises InvalidInput for one that cannot be the camera's."""
        if taken is None:
            return None
        stamp, depth, then, from_palm, T_palm_object, self.tracker.source = taken
        image = self._camera.check_depth(depth, "observation.depth")
        self._count("looked_at")
        view, mask, T_camera_palm = self._observe_hand(stamp, image, then, from_palm)
        # Touch only says where to look for an object that is lost, or followed far from there: another of its kind. A
        # search that started from touch each time would return what touch has measured as the camera's measurement.
        expected = None if T_palm_object is None or T_camera_palm is None else T_camera_palm @ T_palm_object

        seen: dict[str, Any] = {"hand": mask, "T_camera_palm": T_camera_palm, "gripped": expected is not None}
        found = self.tracker.update(stamp, image, expected=expected, **seen)
        self.lost = found.T_camera_object is None
        self.rivals = self.tracker.rivals
        # The pose of an object that is nearly hidden is only the predicted one, not a measurement.
        if found.T_camera_object is None or found.covariance is None or found.reason == HIDDEN:
            return ImageResult(None, view)
        self._count("object_seen")
        # n images that share their errors tell as much as one, so each gets n times the covariance.
        sharing = max(1.0, CORRELATION_TIME / max(stamp - self._detected_at, 1e-3))
        self._detected_at = stamp
        pose = PoseMeasurement(found.T_camera_object, "camera", sharing * found.covariance, stamp)
        return ImageResult(pose, view)

    def _observe_hand(
        self, stamp: float, depth: Depth, then: Instant, from_palm: CameraFromPalm
    ) -> tuple[HandView | None, Mask | None, Array | None]:
        """Returns the detected palm, the hand's pixels, and T_camera_palm (4, 4); each None where it is unknown."""
        joints, camera = then.joint_positions, self._mounted
        T_mount_palm = np.eye(4) if camera.on == "palm" else then.T_world_palm
        if T_mount_palm is None:
            return None, None, None
        T_camera_mount = se3.inverse(camera.T_mount_camera)
        known = len(from_palm.confirmed) > 0
        sigmas = SIGMA_PALM_POSITION, SIGMA_PALM_ROTATION
        if known:
            T_camera_palm = T_camera_mount @ from_palm.confirmed[-1].expected(T_mount_palm)
        else:
            T_camera_palm = T_camera_mount @ T_mount_palm
            constant = camera.sigma_position_constant, camera.sigma_rotation_constant
            sigmas = max(constant[0], sigmas[0]), max(constant[1], sigmas[1])
        found = None
        if not known or abs(stamp - self._palm_searched_at) >= PALM_PERIOD:
            self._palm_searched_at = stamp
            self._count("hand_sought")
            found = self._hand.detected(self._camera, depth, joints, T_camera_palm, sigmas, follow=known)
        view = None
        if isinstance(found, PalmDetection):
            self._count("hand_seen")
            T_camera_palm = found.T_camera_palm
            detected = GaussianPose(T_camera_palm, found.covariance).transformed(camera.T_mount_camera)
            view = HandView(T_mount_palm, detected)
        elif not known:
            return None, None, None
        return view, self._hand.mask(self._camera, depth, joints, T_camera_palm), T_camera_palm
