"""Tracking: the object's pose in the palm over time, from a stream of observations."""

from handsight.tracking.camera_calibration import calibrate_camera
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.replay import best_weight
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.tracker import State, Tracker

__all__ = [
    "FingertipContacts",
    "FingertipSensors",
    "JointOffsets",
    "PoseBiasSmoother",
    "State",
    "Tracker",
    "TrackerSettings",
    "best_weight",
    "calibrate_camera",
]
