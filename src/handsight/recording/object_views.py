"""Views of one object out of what a robot measured: the hand taken away, and where the object was if the robot knows.

What a hand holds stays where it is in the palm, as far as the grip holds; the palm is where the hand is seen. An object
on a table stays where it is in the world. If the robot does not know how its camera has moved against that,
all views begin at one pose, and the growing surface finds theirs.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.recording.robot_images import HandPixels
from handsight.rig import Rig
from handsight.vision.reconstruction.reconstruct import View, within
from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS, SEGMENTATION, InHandView


def views_of(observations: Iterable[Observation], rig: Rig, camera: Camera) -> Iterator[View]:
    """Yields the depth images among observations, the hand's pixels 0, by the pose of the world.

    Raises InvalidInput for images of another size than the camera's. Observations that do not say where the palm was,
    if the camera's place against the object follows from it, are passed over.
    """
    pixels = HandPixels(rig)
    for observation in observations:
        if observation.depth is None:
            continue
        depth = camera.check_depth(observation.depth)
        depth = np.where(depth > 0, depth, 0).astype(np.float32)
        hand = pixels.mask(camera, depth, observation)
        T = _world(rig, observation)
        if T is None and rig.camera is not None and rig.world_from is not None:
            continue
        if hand is not None:
            depth[hand] = 0
        yield View(depth, np.eye(4) if T is None else T)


def in_hand_views(observations: Iterable[Observation], rig: Rig, camera: Camera) -> Iterator[View]:
    """Yields the depth images among observations, pixels near the hand 0, by the pose of what the hand holds.

    Its frame: the palm's axes about the middle that the fingertips had in the first of them. Observations without
    joint positions or a belief where the palm is, and those that show nothing but hand there, are passed over. Raises
    InvalidInput for images of another size than the camera's, and for a rig that cannot tell its hand from the object.
    """
    if rig.camera is None:
        raise InvalidInput("camera: expected one in the rig, to tell where the hand is, got none")
    pixels, in_hand = HandPixels(rig), InHandView(rig.hand, rig.sigma_joint_offset)
    T_palm_object: Array | None = None
    for observation in observations:
        joints = observation.joint_positions
        if observation.depth is None or joints is None or not in_hand.tells(joints):
            continue
        depth = camera.check_depth(observation.depth)
        depth = np.where(depth > 0, depth, 0).astype(np.float32)
        T = pixels.palm(camera, depth, observation)
        if T is None:
            continue
        T_camera_object = T @ (
            se3.compose(np.eye(3), in_hand.middle(joints)) if T_palm_object is None else T_palm_object
        )
        view = View(in_hand.without_hand(camera, depth, joints, T), T_camera_object)
        if within(camera, view, IN_HAND_BOUNDS).sum() < SEGMENTATION.min_pixels:
            continue
        T_palm_object = se3.inverse(T) @ T_camera_object
        yield view


def _world(rig: Rig, observation: Observation) -> Array | None:
    """Returns T_camera_world (4, 4) by the camera's calibration; None where it does not tell."""
    if rig.camera is None:
        return None
    T_camera_mount = se3.inverse(rig.camera.T_mount_camera)
    if rig.camera.on == "world":
        return T_camera_mount
    return (
        None if observation.T_world_palm is None else T_camera_mount @ se3.inverse(observation.T_world_palm)
    )
