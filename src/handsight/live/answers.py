"""A tracker's answers as serialised messages: pose, transform, and statuses."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.messages.encode import Message, header, pose_with_covariance, transform
from handsight.messages.read import typestore
from handsight.messages.topics import OwnTopic, RosType

OBJECT_FRAME = "object"
"""The object's frame id in /tf; its parent is the palm's."""


class Answer(NamedTuple):
    """A message to be published."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    data: bytes


class Status(NamedTuple):
    """One status of the diagnostics."""

    name: str
    level: int
    """0: OK, 1: a warning, 2: an error, 3: stale, as diagnostic_msgs defines it."""
    message: str
    values: Mapping[str, object]


class Writer:
    """Serialisation of messages in one encoding, `cdr` or `ros1`."""

    def __init__(self, encoding: str, palm: str) -> None:
        """`palm`: the palm's frame id. Raises MissingExtra."""
        store = typestore(encoding)
        self._serialize = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
        self.palm = palm

    def answer(self, topic: str, kind: str, **fields: Any) -> Answer:
        """Returns a serialised message with that topic, type and fields."""
        return Answer(topic, kind, bytes(self._serialize(Message(**fields), kind)))

    def pose(self, stamp: float, estimate: PoseEstimate) -> Answer:
        """Returns a PoseWithCovarianceStamped in the palm; unobservable directions have a variance of 1 or more."""
        body = pose_with_covariance(estimate.T_palm_object, estimate.bounded_covariance)
        return self.answer(OwnTopic.POSE, RosType.POSE_COVARIANCE, header=header(stamp, self.palm), pose=body)

    def transform(self, stamp: float, T_palm_object: Array) -> Answer:
        """Returns the transform from the palm to the object, on /tf."""
        link = transform(T_palm_object, stamp, self.palm, OBJECT_FRAME)
        return self.answer(OwnTopic.TF, RosType.TF, transforms=[link])

    def diagnostics(self, statuses: Sequence[Status]) -> Answer:
        """Returns a DiagnosticArray, stamped by this machine's clock."""
        body = [
            Message(
                level=each.level,
                name=f"handsight: {each.name}",
                message=each.message,
                hardware_id="",
                values=[Message(key=key, value=str(value)) for key, value in each.values.items()],
            )
            for each in statuses
        ]
        return self.answer(OwnTopic.DIAGNOSTICS, RosType.DIAGNOSTICS, header=header(time.time()), status=body)
