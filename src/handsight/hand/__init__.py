"""A robot hand's kinematics, from joint positions to the poses of its tips, and its links' surfaces."""

from handsight.hand.description import HandWarning
from handsight.hand.hand import Hand, HandPose
from handsight.hand.paths import find_file
from handsight.hand.surface import HandSurface, LinkMesh

__all__ = ["Hand", "HandPose", "HandSurface", "HandWarning", "LinkMesh", "find_file"]
