"""The hand's pixels in a robot's depth images, and the images as `View`s to reconstruct an object.

An object in the hand is static in the palm, unless it slips; the palm's pose comes from the hand in the image. An
object on a table is static in the world. If the camera's motion in the world is unknown, all views start from the same
pose, and the reconstruction estimates theirs.
"""

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipSensors
from handsight.vision import PalmDetection
from handsight.vision.object.region import check_metres
from handsight.vision.palm.hand_in_image import HandInImage
from handsight.vision.reconstruction.reconstruct import View, within
from handsight.vision.reconstruction.segmentation import (
    IN_HAND_BOUNDS,
    MIN_PIXELS,
    InHandView,
    without_table,
)


class HandPixels:
    """The hand's pixels in the consecutive images of one camera."""

    def __init__(self, rig: Rig) -> None:
        """The search for the palm is as wide as the constant standard deviations of the rig's camera."""
        self._rig = rig
        self._hand = HandInImage(rig)
        # The constant error of the calibration: the palm's detected pose relative to the one by calibration.
        self._T_detected_calibrated: Array | None = None
        self.found = False
        """Whether the palm was detected in the last image, or is where a calibration without error puts it."""

    def mask(self, camera: Camera, depth: Depth, observation: Observation) -> Mask | None:
        """Returns the hand's pixels (h, w); None: the palm's pose is unknown."""
        T_camera_palm = self.palm(camera, depth, observation)
        if T_camera_palm is None:
            return None
        return self._hand.mask(camera, depth, observation.joint_positions, T_camera_palm)

    def palm(self, camera: Camera, depth: Depth, observation: Observation) -> Array | None:
        """Returns `T_camera_palm` (4, 4) of the detected hand, else by the calibration and its last known error.

        None: the palm's pose is unknown by the calibration too.
        """
        calibrated = _in_camera("palm", self._rig, observation)
        of = self._rig.camera
        if calibrated is None or of is None:
            return None
        last = self._T_detected_calibrated
        near = calibrated
        sigma = (of.sigma_position_constant, of.sigma_rotation_constant)
        if last is not None:  # the hand was detected before, so it is near [m, rad]
            near = last @ calibrated
            sigma = (0.01, float(np.deg2rad(2)))
        given = camera, depth, observation.joint_positions, near, sigma
        found = self._hand.detected(*given, follow=last is not None) if min(sigma) > 0 else None
        self.found = min(sigma) <= 0 or isinstance(found, PalmDetection)
        if isinstance(found, PalmDetection):
            near = found.T_camera_palm
            self._T_detected_calibrated = near @ se3.inverse(calibrated)
        return near


def views_of(observations: Iterable[Observation], rig: Rig, camera: Camera) -> Iterator[View | str]:
    """Yields the depth images of the observations, 0 at the hand's pixels, with the pose of the world.

    Instead of an image that has no pose, since the palm's is missing, that reason is yielded. Raises InvalidInput for
    images of another size than the camera's, or in another unit.
    """
    pixels = HandPixels(rig)
    for observation in observations:
        if observation.depth is None:
            continue
        depth = _depth(observation.depth, camera)
        hand = pixels.mask(camera, depth, observation)
        T = _in_camera("world", rig, observation)
        if T is None and rig.camera is not None and rig.world_from is not None:
            yield "no pose of the palm in the world"
            continue
        if hand is not None:
            depth[hand] = 0
        yield View(depth, np.eye(4) if T is None else T)


def in_hand_views(observations: Iterable[Observation], rig: Rig, camera: Camera) -> Iterator[View | str]:
    """Yields the depth images of the observations, 0 at pixels near the hand, with the pose of the object in the hand.

    The object's frame has the palm's axes, and its origin in the middle of the fingertips of the first view. Instead of
    an image in which nothing can be in the hand, or whose palm is not found, the reason is yielded. Raises InvalidInput
    for images of another size than the camera's, or in another unit, and for a rig without a camera.
    """
    if rig.camera is None:
        raise InvalidInput("camera: expected one in the rig, to find the hand in the images, got none")
    pixels = HandPixels(rig)
    sensors = FingertipSensors(rig)
    in_hand = InHandView(rig.hand, rig.joint_errors(rig.hand.shape().joints, rig.sigma_joint_offset))
    T_palm_object: Array | None = None
    for observation in observations:
        joints = observation.joint_positions
        if observation.depth is None:
            continue
        depth = _depth(observation.depth, camera)
        if joints is None or not joints.keys() >= in_hand.joints:
            yield "no joint positions"
            continue
        touching = sensors.contacts(observation).fingers
        if not touching and (observation.wrenches or observation.contacts):
            yield "no finger touched"
            continue
        T = pixels.palm(camera, depth, observation)
        if T is None or not pixels.found:
            yield "the palm was not found" if T is not None else "no pose of the palm in the world"
            continue
        tips = rig.hand.Ts_palm_tip(joints)[:, :3, 3]
        at_middle = se3.compose(np.eye(3), tips.mean(axis=0)) if T_palm_object is None else T_palm_object
        if len(touching) > 1:
            tips = tips[[list(rig.hand.tips).index(name) for name in touching]]
        alone = without_table(camera, in_hand.without_hand(camera, depth, joints, T))
        view = View(alone, T @ at_middle, tips - at_middle[:3, 3])
        if within(camera, view, IN_HAND_BOUNDS).sum() < MIN_PIXELS:
            yield "nothing but the hand"
            continue
        T_palm_object = at_middle
        yield view


def _depth(depth: Depth, camera: Camera) -> Depth:
    """Returns a copy of the depth (h, w) [m], 0 where unknown; raises InvalidInput for another size or unit."""
    depth = camera.check_depth(depth)
    check_metres(depth)
    return np.where((depth > 0) & (depth < np.inf), depth, 0).astype(np.float32)


def _in_camera(body: Literal["palm", "world"], rig: Rig, observation: Observation) -> Array | None:
    """Returns `T_camera_body` (4, 4) by the camera's calibration; None: unknown."""
    if rig.camera is None:
        return None
    T_camera_mount = se3.inverse(rig.camera.T_mount_camera)
    T_world_palm = observation.T_world_palm
    if rig.camera.on == body:
        return T_camera_mount
    if T_world_palm is None:
        return None
    return T_camera_mount @ (T_world_palm if body == "palm" else se3.inverse(T_world_palm))
