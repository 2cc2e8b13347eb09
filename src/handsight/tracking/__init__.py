"""Time: observations to the object's pose in the palm, again and again."""

from handsight.tracking.settings import TrackerSettings
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.touch import Skin, Touch
from handsight.tracking.tracker import State, Tracker

__all__ = ["PoseBiasSmoother", "Skin", "State", "Touch", "Tracker", "TrackerSettings"]
