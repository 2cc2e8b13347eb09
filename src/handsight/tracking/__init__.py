"""Tracking: the object's pose in the palm over time, from a stream of observations."""

from handsight.tracking.camera_calibration import HandViews, calibrate_camera
from handsight.tracking.estimates import Estimated, estimated_values
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.replay import Step, Tally, best_weight
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinContacts, SkinSensors
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.track_state import TrackState
from handsight.tracking.tracker import State, Tracker

__all__ = [
    "Estimated",
    "FingertipContacts",
    "FingertipSensors",
    "HandViews",
    "JointOffsets",
    "PoseBiasSmoother",
    "SkinContacts",
    "SkinSensors",
    "State",
    "Step",
    "Tally",
    "TrackState",
    "Tracker",
    "TrackerSettings",
    "best_weight",
    "calibrate_camera",
    "estimated_values",
]
