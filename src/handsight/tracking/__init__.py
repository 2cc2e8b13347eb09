"""Tracking: the object's pose in the palm over time, from a stream of observations."""

from handsight.tracking.camera_calibration import HAND_VIEWS, HandViews, calibrate_camera
from handsight.tracking.diagnosis import Diagnoser, diagnose
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.replay import Step, Tally, best_weight
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinContacts, SkinSensors
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.track_state import TrackState
from handsight.tracking.tracker import State, Tracker
from handsight.tracking.verdicts import Diagnosed, Diagnosis

__all__ = [
    "HAND_VIEWS",
    "Diagnosed",
    "Diagnoser",
    "Diagnosis",
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
    "diagnose",
]
