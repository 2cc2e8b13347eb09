"""Views of one object out of what a robot measured: the hand taken away, and where the object was if the robot knows.

An object on a table stays where it is in the world. If the robot does not know how its camera has moved against that,
all views begin at one pose, and the growing surface finds theirs.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.observation import Observation
from handsight.recording.robot_images import HandPixels
from handsight.rig import Rig
from handsight.vision import PinholeCamera
from handsight.vision.reconstruction import View


def views_of(observations: Iterable[Observation], rig: Rig, camera: PinholeCamera) -> Iterator[View]:
    """The depth images among observations, the hand's pixels 0, by the pose of the world.

    Raises InvalidInput for images of another size than the camera's. Observations that do not say where the palm was,
    if the camera's place against the object follows from it, are passed over.
    """
    pixels = HandPixels(rig)
    for seen in observations:
        if seen.depth is None:
            continue
        depth = camera.check_depth(seen.depth)
        depth = np.where(depth > 0, depth, 0).astype(np.float32)
        hand = pixels.mask(camera, depth, seen)
        T = _world(rig, seen)
        if T is None and rig.camera is not None and rig.world_from is not None:
            continue
        if hand is not None:
            depth[hand] = 0
        yield View(depth, np.eye(4) if T is None else T)


def _world(rig: Rig, seen: Observation) -> Array | None:
    """T_camera_world (4, 4) by the camera's calibration; None where it does not tell."""
    if rig.camera is None:
        return None
    T_camera_mount = se3.inverse(rig.camera.T_mount_camera)
    if rig.camera.on == "world":
        return T_camera_mount
    return None if seen.T_world_palm is None else T_camera_mount @ se3.inverse(seen.T_world_palm)


def camera_of(rig: Rig, intrinsics: tuple[Array, tuple[int, int], Array] | None) -> PinholeCamera:
    """The camera of a recording, by its CameraInfo or else its rig; raises InvalidInput where neither tells."""
    return PinholeCamera.of(rig.camera) if intrinsics is None else PinholeCamera(*intrinsics)
