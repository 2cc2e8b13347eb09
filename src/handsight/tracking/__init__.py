"""Time: observations to the object's pose in the palm, again and again."""

from handsight.tracking.belief import Belief
from handsight.tracking.fingertips import FingertipContacts, FingertipSensors
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.tracker import State, Tracker

__all__ = ["Belief", "FingertipContacts", "FingertipSensors", "State", "Tracker", "TrackerSettings"]
