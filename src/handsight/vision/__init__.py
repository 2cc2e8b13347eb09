"""Vision: depth cameras, and the poses of object and palm in their images."""

from handsight._deprecated import renamed
from handsight.vision.depth_noise import PRESETS, STEREO, STRUCTURED_LIGHT, TIME_OF_FLIGHT, DepthNoise
from handsight.vision.object.depth_points import depth_points
from handsight.vision.object.depth_tracker import DepthTracker, Sighting
from handsight.vision.object.first_pose import JudgedStarts, ObjectDetection
from handsight.vision.object.locate import FirstPoseSource, Recognition, locate, locate_detected, recognise
from handsight.vision.object.locate_all import ObjectInstance, SceneDetection, locate_all
from handsight.vision.object.shape_index import ShapeIndex
from handsight.vision.palm.hand_appearance import HandAppearance, PlacedHand
from handsight.vision.palm.hand_in_image import hand_mask
from handsight.vision.palm.palm_detector import PalmDetection, PalmNotFound, detect_palm, follow_palm
from handsight.vision.pixels import read_camera, read_color, read_depth
from handsight.vision.registration import register_color

__all__ = [
    "PRESETS", "STEREO", "STRUCTURED_LIGHT", "TIME_OF_FLIGHT", "DepthNoise", "DepthTracker", "FirstPoseSource",
    "HandAppearance", "JudgedStarts", "ObjectDetection", "ObjectInstance", "PalmDetection", "PalmNotFound",
    "PlacedHand", "Recognition", "SceneDetection", "ShapeIndex", "Sighting", "depth_points", "detect_palm",
    "follow_palm", "hand_mask", "locate", "locate_all", "locate_detected", "read_camera", "read_color", "read_depth",
    "recognise", "register_color",
]  # fmt: skip

__getattr__ = renamed(__name__, {
    "Found": "handsight.vision.ObjectDetection",
    "HandLook": "handsight.vision.HandAppearance",
    "HandNotSeen": "handsight.vision.PalmNotFound",
    "Drawn": "handsight.camera.DrawnTriangles",
    "PinholeCamera": "handsight.camera.Camera",
    "SeenHand": "handsight.vision.PalmDetection",
    "followed_hand": "handsight.vision.follow_palm",
    "seen_hand": "handsight.vision.detect_palm",
})  # fmt: skip
