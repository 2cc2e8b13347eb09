"""A robot's own hand in its camera's depth images: where it is, and which pixels it covers."""

from collections.abc import Mapping

import numpy as np
import scipy  # loads its parts when they are used

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask
from handsight.rig import Rig
from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT
from handsight.vision.palm.hand_appearance import HandAppearance, PlacedHand
from handsight.vision.palm.palm_detector import PalmDetection, PalmNotFound, detect_palm, follow_palm

AROUND, SLACK = 3, 0.012
"""Margins for joints that are off by a degree: around the drawn links [pixels], in front and behind [m]."""
Joints = Mapping[str, float] | None


class HandInImage:
    """A `HandInImage` finds the hand of a rig by the shapes of its links; a hand without shapes is not found."""

    def __init__(self, rig: Rig) -> None:
        self._shape, self._sigma_joint = rig.hand.shape(), rig.sigma_joint_offset
        self._noise = STRUCTURED_LIGHT if rig.camera is None else PRESETS[rig.camera.depth_camera]
        self._appearance = HandAppearance.of(rig.hand) if len(self._shape.faces) else None

    def placed(self, joint_positions: Joints) -> PlacedHand | None:
        """Returns the hand with its joints there; None without shapes, or where a joint is missing."""
        joints = joint_positions or {}
        if self._appearance is None or not joints.keys() >= set(self._shape.joints):
            return None
        return self._appearance.placed(joints, sigma_joint=self._sigma_joint)

    def detected(
        self,
        camera: Camera,
        depth: Depth,
        joint_positions: Joints,
        T_camera_palm: Array,
        sigmas: tuple[float, float],
        *,
        follow: bool = False,
    ) -> PalmDetection | PalmNotFound | None:
        """Returns the palm as `detect_palm` does, with sigmas of its predicted pose [m, rad]; None where `placed` is.
        `follow`: the palm was found there in the last image, and is searched only if it no longer fits there."""
        hand = self.placed(joint_positions)
        if hand is None:
            return None
        found = follow_palm(camera, depth, hand, T_camera_palm, noise=self._noise) if follow else None
        known = {"sigma_position": sigmas[0], "sigma_rotation": sigmas[1]}
        return found or detect_palm(camera, depth, hand, T_camera_palm, noise=self._noise, **known)

    def mask(
        self, camera: Camera, depth: Depth, joint_positions: Joints, T_camera_palm: Array
    ) -> Mask | None:
        """Returns (h, w) whether a pixel is the hand's; None where `placed` is."""
        joints = joint_positions or {}
        if self._appearance is None or not joints.keys() >= set(self._shape.joints):
            return None
        return hand_mask(camera, depth, self._shape.vertices_palm(joints), self._shape.faces, T_camera_palm)


def hand_mask(
    camera: Camera,
    depth: Depth,
    vertices_palm: Array,
    faces: Indices,
    T_camera_palm: Array,
    slack: float = SLACK,
) -> Mask:
    """Returns (h, w) whether a pixel of a depth image (h, w) [m] is the hand's.

    The hand is triangles `faces` (m, 3) of vertices (k, 3) [m]. What is in front of it is not masked: it may be the
    object.
    """
    drawn = camera.draw(se3.apply(T_camera_palm, vertices_palm), faces).depth
    rows, columns = np.nonzero(np.isfinite(drawn))
    mask = np.zeros(depth.shape, dtype=bool)
    if not len(rows):
        return mask
    box = tuple(slice(max(r.min() - AROUND, 0), r.max() + AROUND + 1) for r in (rows, columns))
    size, near = 2 * AROUND + 1, drawn[box]
    far = np.where(np.isfinite(near), near, -np.inf)
    nearest = scipy.ndimage.minimum_filter(near, size=size, mode="constant", cval=np.inf)
    farthest = scipy.ndimage.maximum_filter(far, size=size, mode="constant", cval=-np.inf)
    mask[box] = (nearest - slack < depth[box]) & (depth[box] < farthest + slack)
    return mask
