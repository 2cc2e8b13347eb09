"""Depth images of a robot's recording to `Frame`s, its hand masked where it is seen."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidFile, InvalidInput
from handsight.observation import Observation
from handsight.recording.frames import Frame, Frames
from handsight.recording.open import open_recording
from handsight.rig import Rig
from handsight.vision import PalmDetection
from handsight.vision.palm.hand_in_image import HandInImage

KNOWN = 0.01, float(np.deg2rad(2))
"""How far the hand may be off where the last picture had it, once one has shown it: sigma [m, rad]."""


def recorded_frames(path: Path, rig: Rig) -> Frames:
    """Returns the frames of a recording in order of stamp; raises InvalidFile where it has no depth images,
    InvalidInput where neither it nor the rig says what camera they are of.

    Hand: its links as they are seen (`detect_palm`), else where the rig's camera should see them. Unknown without joint
    positions, or where a camera in the world does not know of the palm.
    """
    if rig.topics.depth is None:
        raise InvalidInput("rig: expected topics.depth, where the recording has its depth images, got none")
    return Frames(None, _frames(path, rig))


class HandPixels:
    """A `HandPixels` says which pixels are the hand's, picture after picture of one camera."""

    def __init__(self, rig: Rig) -> None:
        """A camera that is calibrated as well as the rig says."""
        self._rig, self._hand = rig, HandInImage(rig)
        # Of the palm in the camera, as constant as the calibration's error.
        self._T_measured_believed: Array | None = None

    def mask(self, camera: Camera, depth: Depth, detected: Observation) -> Mask | None:
        """Returns (h, w); None where nobody knows of a hand."""
        T_camera_palm = self.palm(camera, depth, detected)
        if T_camera_palm is None:
            return None
        return self._hand.mask(camera, depth, detected.joint_positions, T_camera_palm)

    def palm(self, camera: Camera, depth: Depth, detected: Observation) -> Array | None:
        """Returns T_camera_palm (4, 4) as the hand is seen; else as believed, by what it was off when it was last
        seen."""
        believed, joints, of = believed_palm(self._rig, detected), detected.joint_positions, self._rig.camera
        if believed is None or of is None:
            return None
        last = self._T_measured_believed
        off = (of.sigma_position_constant, of.sigma_rotation_constant) if last is None else KNOWN
        near = believed if last is None else last @ believed
        detect = self._hand.detected if last is None else self._hand.followed
        found = detect(camera, depth, joints, near, off) if min(off) > 0 else None
        if isinstance(found, PalmDetection):
            near = found.T_camera_palm
            self._T_measured_believed = near @ se3.inverse(believed)
        return near


def _frames(path: Path, rig: Rig) -> Iterator[Frame]:
    pixels, camera = HandPixels(rig), None
    with open_recording(path, rig) as recording:
        for detected in recording.observations():
            if detected.depth is None:
                continue
            camera = camera or recording.intrinsics or Camera.of(rig.camera)
            if detected.depth.shape != camera.size[::-1]:
                (width, height), (h, w) = camera.size, detected.depth.shape
                message = f"expected depth of {width} x {height} pixels as its camera's, got {w} x {h}"
                raise InvalidFile(f"{path}: {message}")
            alike = detected.color is not None and detected.color.shape[:2] == detected.depth.shape
            yield Frame(
                name=f"{detected.stamp:.3f} s",
                camera=camera,
                depth=detected.depth,
                color=detected.color if alike else None,
                hand=pixels.mask(camera, np.nan_to_num(detected.depth), detected),
            )
    if camera is None:
        raise InvalidFile(f"{path}: expected depth images on {rig.topics.depth}, got none")


def believed_palm(rig: Rig, detected: Observation) -> Array | None:
    """Returns T_camera_palm (4, 4) by the camera's calibration; None where it does not tell."""
    if rig.camera is None:
        return None
    T_camera_mount = se3.inverse(rig.camera.T_mount_camera)
    if rig.camera.on == "palm":
        return T_camera_mount
    return None if detected.T_world_palm is None else T_camera_mount @ detected.T_world_palm
