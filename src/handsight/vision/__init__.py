"""Sight: depth cameras, and what their images say of hand and object."""

from handsight.vision.camera import Drawn, PinholeCamera
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.depth_points import depth_points
from handsight.vision.depth_tracker import DepthTracker, Sighting
from handsight.vision.files import read_camera, read_color, read_depth
from handsight.vision.first_pose import Found
from handsight.vision.hand_look import HandLook, PlacedHand
from handsight.vision.hand_mask import hand_mask
from handsight.vision.locate import locate
from handsight.vision.recognition import Recognition, recognise
from handsight.vision.registration import register_color
from handsight.vision.seen_hand import HandNotSeen, SeenHand, followed_hand, seen_hand

__all__ = [
    "DepthNoise",
    "DepthTracker",
    "Drawn",
    "Found",
    "HandLook",
    "HandNotSeen",
    "PinholeCamera",
    "PlacedHand",
    "Recognition",
    "SeenHand",
    "Sighting",
    "depth_points",
    "followed_hand",
    "hand_mask",
    "locate",
    "read_camera",
    "read_color",
    "read_depth",
    "recognise",
    "register_color",
    "seen_hand",
]
