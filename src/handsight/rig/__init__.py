"""A rig is a robot as one value, read from `rig.yaml`: hand, fingertips with sensors, camera, table and topics."""

from handsight.rig.rig import DepthCamera, Finger, JointReading, MountedCamera, Rig, Table, Topics

__all__ = ["DepthCamera", "Finger", "JointReading", "MountedCamera", "Rig", "Table", "Topics"]
