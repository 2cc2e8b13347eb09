"""Kinematics: joint positions of a hand to poses of its tips, and points on its surface."""

from handsight.hand.description import HandWarning
from handsight.hand.hand import Hand, HandPose
from handsight.hand.paths import find_file
from handsight.hand.shape import LinkMesh
from handsight.hand.surface import HandSurface

__all__ = ["Hand", "HandPose", "HandSurface", "HandWarning", "LinkMesh", "find_file"]
