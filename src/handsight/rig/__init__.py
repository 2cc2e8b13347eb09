"""A rig is a robot as one value, read from `rig.yaml`: hand, fingertips with sensors, camera, table and topics."""

from handsight._deprecated import renamed
from handsight.rig.rig import DepthCamera, Finger, MountedCamera, Rig, Table, Topics

__all__ = ["DepthCamera", "Finger", "MountedCamera", "Rig", "Table", "Topics"]

__getattr__ = renamed(
    __name__, {"Camera": "handsight.rig.MountedCamera", "ObjectEntry": "handsight.objects.ObjectSpec"}
)
