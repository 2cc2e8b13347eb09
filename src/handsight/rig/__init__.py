"""A rig is a robot as one value, read from `rig.yaml`: hand, fingertips with sensors, camera, table and topics."""

from handsight.rig.rig import Camera, Finger, ObjectEntry, Rig, Table, Topics

__all__ = ["Camera", "Finger", "ObjectEntry", "Rig", "Table", "Topics"]
