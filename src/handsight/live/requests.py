"""What a user asks a running tracker for, by topics that every transport has: a start, an object, a new beginning."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.correction import PosePrior
from handsight.errors import HandsightError, InvalidInput
from handsight.messages import RawMessage, TopicReport
from handsight.messages.decode import decode, typestore
from handsight.messages.fast import FastReaders
from handsight.messages.topics import POSE_COVARIANCE
from handsight.objects import ObjectModel
from handsight.observation import PoseMeasurement
from handsight.rig import Rig

TEXT, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"
START_TOPIC, OBJECT_TOPIC, RESET_TOPIC = "/handsight/start", "/handsight/object", "/handsight/reset"
ASKED: dict[str, tuple[str, ...]] = {
    START_TOPIC: (POSE_COVARIANCE,),
    OBJECT_TOPIC: (TEXT,),
    RESET_TOPIC: (EMPTY,),
}
SIGMAS = 0.03, float(np.deg2rad(15.0))
"""Of a user's pose that comes without a covariance [m, rad]."""


def asked_text(message: RawMessage) -> str:
    """Returns the text of a String; raises InvalidInput."""
    try:
        if message.type != TEXT:
            raise InvalidInput(f"expected a {TEXT}, got {message.type}")
        store: Any = typestore(message.encoding)
        return str(getattr(store, f"deserialize_{message.encoding}")(message.data, TEXT).data)
    except HandsightError:
        raise
    except Exception as error:  # code that rosbags generates raises anything
        raise InvalidInput(f"expected a {TEXT}, got bytes that are none ({str(error)[:80]})") from None


def asked_start(message: RawMessage, rig: Rig, T_world_palm: Array | None) -> PosePrior:
    """Returns a user's pose in the palm; raises InvalidInput. `T_world_palm`: now, for a pose in the world; None: not
    known."""
    topic = TopicReport(message.topic, "vision", (POSE_COVARIANCE,))
    found = decode(message, topic, rig.frames, FastReaders())
    if not found:
        raise InvalidInput(next(iter(topic.reasons), "expected a pose"))
    pose: PoseMeasurement = found[0].value
    T, on = pose.T_frame_object, pose.frame
    T_mount_frame = np.eye(4)
    if pose.frame == "camera":
        if rig.camera is None:
            raise InvalidInput("expected a pose in the palm or the world (the rig has no camera)")
        T_mount_frame, on = rig.camera.T_mount_camera, rig.camera.on
    if on == "world":
        if T_world_palm is None:
            raise InvalidInput("expected a pose in the palm, as the palm's pose in the world is not known")
        T_mount_frame = se3.inverse(T_world_palm) @ T_mount_frame
    T = T_mount_frame @ T
    if pose.covariance is None:
        return PosePrior.from_sigmas(T, *SIGMAS)
    return PosePrior(T, se3.rotate_covariance(T_mount_frame[:3, :3], pose.covariance))


def model_named(name: str, rig: Rig) -> ObjectModel:
    """Returns the object of that name: of the rig, a mesh file, or of the library; raises a HandsightError."""
    if name in rig.objects:
        return replace(rig.objects[name].model(), name=name)
    if Path(name).is_file():
        return ObjectModel.from_file(name)
    try:
        return ObjectModel.from_library(name)
    except HandsightError as error:
        known = ", ".join(rig.objects) or "none"
        raise InvalidInput(
            f"object: expected one of the rig ({known}), a mesh file or one of the library, "
            f"got {checks.brief(repr(name))} ({error})"
        ) from None
