"""A user's requests to a running tracker, as messages on topics: a first pose, another object, a new track."""

import numpy as np

from handsight import se3
from handsight.checks import Array, brief
from handsight.correction import PosePrior
from handsight.errors import HandsightError, InvalidInput
from handsight.messages import RawMessage, TopicReport
from handsight.messages.decode import decode
from handsight.messages.read import deserialized
from handsight.messages.topics import MessageRejected, OwnTopic, RosType, Topic
from handsight.objects import Library, ObjectModel, find_model
from handsight.observation import PoseMeasurement
from handsight.rig import Rig

REQUESTS: dict[str, tuple[str, ...]] = {
    OwnTopic.START: (RosType.POSE_COVARIANCE,),
    OwnTopic.OBJECT: (RosType.TEXT,),
    OwnTopic.RESET: (RosType.EMPTY,),
}
"""The types that a request may have, by topic."""


def requested_text(message: RawMessage) -> str:
    """Returns the text of a std_msgs/String; raises InvalidInput."""
    try:
        return str(deserialized(message._replace(type=RosType.TEXT)).data)
    except MessageRejected as error:
        raise InvalidInput(str(error)) from None


def requested_start(message: RawMessage, rig: Rig, T_world_palm: Array | None) -> PosePrior:
    """Returns a user's pose of the object, converted to the palm's frame; raises InvalidInput.

    `T_world_palm`: the current pose of the palm, for a user's pose in the world; None: unknown.
    """
    report = TopicReport(Topic(message.topic, "vision", (RosType.POSE_COVARIANCE,)))
    found = decode(message, report, rig.frames, fast={})
    if not found:
        raise InvalidInput(next(iter(report.reasons)))
    pose: PoseMeasurement = found[0].value
    T_mount_frame = np.eye(4)
    mount = pose.frame
    if pose.frame == "camera":
        if rig.camera is None:
            raise InvalidInput("expected a pose in the palm or the world (the rig has no camera)")
        T_mount_frame = rig.camera.T_mount_camera
        mount = rig.camera.on
    T_palm_frame = T_mount_frame
    if mount == "world":
        if T_world_palm is None:
            raise InvalidInput("expected a pose in the palm, as the palm's pose in the world is not known")
        T_palm_frame = se3.inverse(T_world_palm) @ T_mount_frame
    T_palm_object = T_palm_frame @ pose.T_frame_object
    if pose.covariance is None:
        return PosePrior.from_sigmas(T_palm_object, 0.03, float(np.deg2rad(15.0)))
    return PosePrior(T_palm_object, se3.rotate_covariance(T_palm_frame[:3, :3], pose.covariance))


def requested_model(name: str, rig: Rig) -> ObjectModel:
    """Returns the object of that name in the rig, of a mesh file, or of the library; raises a HandsightError."""
    place = f"the rig ({', '.join(rig.objects) or 'none'})"
    try:
        return find_model(name, rig.objects, place, library=Library())
    except HandsightError:
        raise
    except (OSError, ValueError) as error:  # of a name that no file can have, or a file that cannot be read
        raise InvalidInput(f"object: expected a name of {place}, got {brief(name)}: {error}") from None
