"""A tracker's answers as messages: pose, transform and diagnostics, as bytes in the transport's encoding."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace as Message
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.messages.decode import typestore
from handsight.messages.topics import POSE_COVARIANCE, TF
from handsight.recording.write import header, pose, split_stamp
from handsight.tracking.tracker import State

POSE_TOPIC, MARKERS_TOPIC, DIAGNOSTICS_TOPIC = "/handsight/pose", "/handsight/markers", "/diagnostics"
DIAGNOSTICS, MARKERS = "diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"
OBJECT_FRAME = "object"
"""What the object is called in /tf, a child of the palm."""
OK, WARN, ERROR = 0, 1, 2
LEVELS: Mapping[State, int] = {"tracking": OK, "uncertain": WARN, "lost": ERROR}


class Answer(NamedTuple):
    """An `Answer` is a message to be published."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    data: bytes


class Status(NamedTuple):
    """A `Status` is one part of the diagnostics."""

    name: str
    level: int
    text: str
    values: Mapping[str, object]


class Template:
    """A `Template` is a message that is written hundreds of times a second, of which only a stamp and the numbers at
    its end change."""

    def __init__(self, example: Answer, stamp_at: int, count: int) -> None:
        """`stamp_at`: where its stamp is, as bytes from the beginning; `count` of the numbers."""
        self._example, self._stamp_at, self._numbers = example, stamp_at, struct.Struct(f"<{count}d")

    def answer(self, stamp: float, numbers: Sequence[float]) -> Answer:
        """Returns the message of that time [s] and of those numbers; raises InvalidInput for a stamp that it cannot
        hold."""
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
        store = typestore(encoding)
        self._serialize = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
        self._palm = palm
        self._pose, self._transform = self._pose_template(), self._transform_template()

    def answer(self, topic: str, kind: str, **fields: Any) -> Answer:
        """Returns a message of these fields."""
        return Answer(topic, kind, bytes(self._serialize(Message(**fields), kind)))

    def pose(self, stamp: float, estimate: PoseEstimate, numbers: Sequence[float]) -> Answer:
        """Returns a PoseWithCovarianceStamped in the palm; directions that nothing tells of have a variance of 1 or
        more.

        `numbers`: the estimate's, of `pose_numbers`.
        """
        return self._pose.answer(stamp, (*numbers, *estimate.bounded_covariance.ravel().tolist()))

    def transform(self, stamp: float, numbers: Sequence[float]) -> Answer:
        """Returns the transform from the palm to the object, whose pose has these `pose_numbers`, on /tf."""
        return self._transform.answer(stamp, numbers)

    def _pose_template(self) -> "Template":
        body = Message(pose=pose(np.eye(4)), covariance=np.zeros(36))
        example = self.answer(POSE_TOPIC, POSE_COVARIANCE, header=self.header(0.0, self._palm), pose=body)
        return Template(example, 4, 7 + 36)

    def _transform_template(self) -> "Template":
        at = pose(np.eye(4))
        each = Message(
            header=self.header(0.0, self._palm),
            child_frame_id=OBJECT_FRAME,
            transform=Message(translation=at.position, rotation=at.orientation),
        )
        return Template(self.answer("/tf", TF, transforms=[each]), 8, 7)

    def diagnostics(self, stamp: float, statuses: Iterable[Status]) -> Answer:
        """Returns a DiagnosticArray."""
        body = [
            Message(
                level=each.level,
                name=f"handsight: {each.name}",
                message=each.text,
                hardware_id="",
                values=[Message(key=key, value=str(value)) for key, value in each.values.items()],
            )
            for each in statuses
        ]
        return self.answer(DIAGNOSTICS_TOPIC, DIAGNOSTICS, header=self.header(stamp), status=body)

    @staticmethod
    def header(stamp: float, frame: str = "") -> Message:
        """Returns a header of either encoding; ROS 1 counts in it."""
        top = header(stamp, frame)
        top.seq = 0
        return top
