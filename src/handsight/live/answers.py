"""A tracker's answers as messages: pose, transform and diagnostics, as bytes in the transport's encoding."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.messages.decode import typestore
from handsight.messages.encode import Message, header, pose_with_covariance, split_stamp, transform
from handsight.messages.topics import OwnTopic, RosType

OBJECT_FRAME = "object"
"""The object's frame id in /tf, a child of the palm's."""


class Answer(NamedTuple):
    """An `Answer` is a message to be published."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    data: bytes


class Level(IntEnum):
    """`Level` is how serious a status of the diagnostics is."""

    OK = 0
    WARN = 1
    ERROR = 2


class Status(NamedTuple):
    """A `Status` is one part of the diagnostics."""

    name: str
    level: Level
    text: str
    values: Mapping[str, object]


class Template:
    """A `Template` is a message that is written very often: only its stamp and the numbers at its end change."""

    def __init__(self, example: Answer, stamp_at: int, count: int) -> None:
        """`stamp_at`: the first byte of the stamp in the example; `count` of the numbers."""
        self._example, self._stamp_at, self._numbers = example, stamp_at, struct.Struct(f"<{count}d")

    def answer(self, stamp: float, numbers: Sequence[float]) -> Answer:
        """Returns the message of a stamp [s] and of numbers; raises InvalidInput for a stamp that it cannot hold."""
        data = bytearray(self._example.data)
        struct.pack_into("<iI", data, self._stamp_at, *split_stamp(stamp))
        self._numbers.pack_into(data, len(data) - self._numbers.size, *numbers)
        return self._example._replace(data=bytes(data))


def pose_numbers(T: Array) -> tuple[float, ...]:
    """Returns x, y, z [m], and the quaternion's x, y, z, w, of a pose (4, 4)."""
    return (*T[:3, 3].tolist(), *se3.quaternion_from_rotation(T[:3, :3]).tolist())


class Writer:
    """A `Writer` turns messages to bytes in one encoding, `cdr` or `ros1`."""

    def __init__(self, encoding: str, palm: str) -> None:
        """`palm`: its frame id. Raises MissingExtra."""
        store, T = typestore(encoding), np.eye(4)
        self._serialize = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
        self.palm = palm
        body = pose_with_covariance(T, None)
        example = self.answer(OwnTopic.POSE, RosType.POSE_COVARIANCE, header=header(0.0, palm), pose=body)
        self._pose = Template(example, 4, 7 + 36)
        example = self.answer(OwnTopic.TF, RosType.TF, transforms=[transform(T, 0.0, palm, OBJECT_FRAME)])
        self._transform = Template(example, 8, 7)

    def answer(self, topic: str, kind: str, **fields: Any) -> Answer:
        """Returns a message of that type and these fields."""
        return Answer(topic, kind, bytes(self._serialize(Message(**fields), kind)))

    def pose(self, stamp: float, estimate: PoseEstimate, numbers: Sequence[float]) -> Answer:
        """Returns a PoseWithCovarianceStamped in the palm; unobservable directions have a variance of 1 or more.

        `numbers`: the `pose_numbers` of the estimate.
        """
        return self._pose.answer(stamp, (*numbers, *estimate.bounded_covariance.ravel().tolist()))

    def transform(self, stamp: float, numbers: Sequence[float]) -> Answer:
        """Returns the transform from the palm to the object, whose pose has these `pose_numbers`, on /tf."""
        return self._transform.answer(stamp, numbers)

    def diagnostics(self, stamp: float, statuses: Iterable[Status]) -> Answer:
        """Returns a DiagnosticArray."""
        body = [
            Message(
                level=int(each.level),
                name=f"handsight: {each.name}",
                message=each.text,
                hardware_id="",
                values=[Message(key=key, value=str(value)) for key, value in each.values.items()],
            )
            for each in statuses
        ]
        return self.answer(OwnTopic.DIAGNOSTICS, RosType.DIAGNOSTICS, header=header(stamp), status=body)
