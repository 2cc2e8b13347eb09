"""A robot's own hand in its camera's depth images: where it is, and which pixels are its."""

from collections.abc import Mapping

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.rig import Rig
from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT
from handsight.vision.palm.hand_appearance import HandAppearance, PlacedHand
from handsight.vision.palm.hand_mask import hand_mask
from handsight.vision.palm.palm_detector import PalmDetection, PalmNotFound, detect_palm, follow_palm


class HandInImage:
    """A `HandInImage` is the hand of a rig, by its shapes; nothing is known of a hand whose file has none."""

    def __init__(self, rig: Rig) -> None:
        self._shape, self._sigma_joint = rig.hand.shape(), rig.sigma_joint_offset
        self._noise = STRUCTURED_LIGHT if rig.camera is None else PRESETS[rig.camera.depth_camera]
        self._appearance = HandAppearance.of(rig.hand) if len(self._shape.faces) else None

    def placed(self, joint_positions: Mapping[str, float] | None) -> PlacedHand | None:
        """Returns the hand with its joints there; None without shapes, or where a joint is missing."""
        joints = joint_positions or {}
        if self._appearance is None or not joints.keys() >= {
            *self._shape.joints,
            *self._appearance.chains.joints,
        }:
            return None
        return self._appearance.placed(joints, sigma_joint=self._sigma_joint)

    def detected(
        self,
        camera: Camera,
        depth: Depth,
        joint_positions: Mapping[str, float] | None,
        T_camera_palm: Array,
        sigmas: tuple[float, float],
    ) -> PalmDetection | PalmNotFound | None:
        """Works as `detect_palm`, with sigmas of the believed pose [m, rad]; None where nothing is known of the
        hand."""
        hand = self.placed(joint_positions)
        if hand is None:
            return None
        return detect_palm(
            camera,
            depth,
            hand,
            T_camera_palm,
            sigma_position=sigmas[0],
            sigma_rotation=sigmas[1],
            noise=self._noise,
        )

    def followed(
        self,
        camera: Camera,
        depth: Depth,
        joint_positions: Mapping[str, float] | None,
        T_camera_palm: Array,
        sigmas: tuple[float, float],
    ) -> PalmDetection | PalmNotFound | None:
        """Works as `detected`, from where the last picture has had the palm: searched only where it does not fit
        there."""
        hand = self.placed(joint_positions)
        found = None if hand is None else follow_palm(camera, depth, hand, T_camera_palm, noise=self._noise)
        return found or self.detected(camera, depth, joint_positions, T_camera_palm, sigmas)

    def mask(
        self,
        camera: Camera,
        depth: Depth,
        joint_positions: Mapping[str, float] | None,
        T_camera_palm: Array,
    ) -> Mask | None:
        """Returns (h, w) which pixels are the hand's; None where nothing is known of it."""
        joints = joint_positions or {}
        if not len(self._shape.faces) or not joints.keys() >= set(self._shape.joints):
            return None
        vertices = self._shape.vertices_palm(joints)
        return hand_mask(camera, depth, vertices, self._shape.faces, T_camera_palm)
