"""Time: observations to the object's pose in the palm, again and again."""

from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets
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
]
