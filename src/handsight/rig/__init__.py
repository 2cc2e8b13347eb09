"""The robot: hand, fingertips with their sensors, camera, table, topics, as one value read from `rig.yaml`."""

from handsight.rig.rig import Camera, Finger, ObjectEntry, Rig, Table, Topics

__all__ = ["Camera", "Finger", "ObjectEntry", "Rig", "Table", "Topics"]
