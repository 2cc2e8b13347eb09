"""Vision: depth cameras, and the poses of object and palm in their images."""

from handsight.vision.camera_file import read_camera
from handsight.vision.depth_noise import PRESETS, STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.depth_tracker import DepthTracker, Sighting
from handsight.vision.object.first_pose import ObjectDetection
from handsight.vision.object.locate import FirstPoseSource, Recognition, locate, locate_detected, recognise
from handsight.vision.object.locate_all import ObjectInstance, SceneDetection, locate_all
from handsight.vision.palm.hand_appearance import HandAppearance, PlacedHand
from handsight.vision.palm.hand_in_image import hand_mask
from handsight.vision.palm.palm_detector import PalmDetection, PalmNotFound, detect_palm, follow_palm
from handsight.vision.pixels import read_color, read_depth

__all__ = [
    "PRESETS", "STRUCTURED_LIGHT", "DepthNoise", "DepthTracker", "FirstPoseSource",
    "HandAppearance", "ObjectDetection", "ObjectInstance", "PalmDetection", "PalmNotFound",
    "PlacedHand", "Recognition", "SceneDetection", "Sighting", "detect_palm",
    "follow_palm", "hand_mask", "locate", "locate_all", "locate_detected", "read_camera", "read_color", "read_depth",
    "recognise",
]  # fmt: skip
