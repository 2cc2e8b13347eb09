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

AROUND = 3
SLACK = 0.012
"""Margins for joints that are off by a degree: around the drawn links [pixels], in front and behind [m]."""
Joints = Mapping[str, float] | None


class HandInImage:
    """Finds the hand of a rig by the shapes of its links; a hand without shapes is not found."""

    def __init__(self, rig: Rig) -> None:
        self._shape = rig.hand.shape()
        self._joint_errors = rig.joint_errors(self._shape.joints, rig.sigma_joint_offset)
        self._noise = STRUCTURED_LIGHT if rig.camera is None else PRESETS[rig.camera.depth_camera]
        self._appearance = HandAppearance.of(rig.hand) if len(self._shape.faces) else None

    def knows(self, joint_positions: Joints) -> bool:
        """Returns whether the hand has shapes, and these are the positions of all its joints."""
        return self._appearance is not None and (joint_positions or {}).keys() >= set(self._shape.joints)

    def placed(self, joint_positions: Joints) -> PlacedHand | None:
        """Returns the hand with its joints there; None without shapes, or where a joint is missing."""
        if self._appearance is None or not self.knows(joint_positions):
            return None
        return self._appearance.placed(joint_positions or {}, sigma_joint=self._joint_errors)

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
        if not self.knows(joint_positions):
            return None
        vertices = self._shape.vertices_palm(joint_positions or {})
        return hand_mask(camera, depth, vertices, self._shape.faces, T_camera_palm)


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
    size = 2 * AROUND + 1
    near = drawn[box]
    far = np.where(np.isfinite(near), near, -np.inf)
    nearest = scipy.ndimage.minimum_filter(near, size=size, mode="constant", cval=np.inf)
    farthest = scipy.ndimage.maximum_filter(far, size=size, mode="constant", cval=-np.inf)
    mask[box] = (nearest - slack < depth[box]) & (depth[box] < farthest + slack)
    return mask
