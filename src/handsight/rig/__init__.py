"""The robot: hand, fingertips with their sensors, camera, table, topics, as one value read from `rig.yaml`."""

from handsight.rig.parts import Camera, Finger, ObjectEntry, Table, Topics
from handsight.rig.rig import Rig

__all__ = ["Camera", "Finger", "ObjectEntry", "Rig", "Table", "Topics"]
