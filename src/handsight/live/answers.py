"""A tracker's answers as messages: pose, transform and diagnostics, as bytes in the transport's encoding."""

from collections.abc import Iterable, Mapping
from types import SimpleNamespace as Message
from typing import Any, NamedTuple

from handsight.correction import PoseEstimate
from handsight.messages.decode import typestore
from handsight.messages.topics import POSE_COVARIANCE, TF
from handsight.recording.write import header
from handsight.tracking.tracker import State

POSE_TOPIC, MARKERS_TOPIC, DIAGNOSTICS_TOPIC = "/handsight/pose", "/handsight/markers", "/diagnostics"
DIAGNOSTICS, MARKERS = "diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"
OBJECT_FRAME = "object"
"""What the object is called in /tf, a child of the palm."""
OK, WARN, ERROR = 0, 1, 2
LEVELS: Mapping[State, int] = {"tracking": OK, "uncertain": WARN, "lost": ERROR}


class Answer(NamedTuple):
    """A message to be published."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    data: bytes


class Status(NamedTuple):
    """One part of the diagnostics."""

    name: str
    level: int
    said: str
    values: Mapping[str, object]


class Writer:
    """Messages to bytes in one encoding, `cdr` or `ros1`."""

    def __init__(self, encoding: str, palm: str) -> None:
        """`palm`: its frame id. Raises MissingExtra."""
        store = typestore(encoding)
        self._serialize = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
        self._palm = palm

    def answer(self, topic: str, kind: str, **fields: Any) -> Answer:
        """A message of these fields."""
        return Answer(topic, kind, bytes(self._serialize(Message(**fields), kind)))

    def pose(self, stamp: float, estimate: PoseEstimate, at: Message) -> Answer:
        """PoseWithCovarianceStamped in the palm; directions that nothing tells of have a variance of 1 or more.

        `at`: the estimate's pose as a Pose.
        """
        body = Message(pose=at, covariance=estimate.bounded_covariance.ravel())
        return self.answer(POSE_TOPIC, POSE_COVARIANCE, header=self.header(stamp, self._palm), pose=body)

    def transform(self, stamp: float, at: Message) -> Answer:
        """From the palm to the object, whose Pose is `at`, on /tf."""
        body = Message(translation=at.position, rotation=at.orientation)
        top = self.header(stamp, self._palm)
        return self.answer(
            "/tf", TF, transforms=[Message(header=top, child_frame_id=OBJECT_FRAME, transform=body)]
        )

    def diagnostics(self, stamp: float, statuses: Iterable[Status]) -> Answer:
        """DiagnosticArray."""
        body = [
            Message(
                level=each.level,
                name=f"handsight: {each.name}",
                message=each.said,
                hardware_id="",
                values=[Message(key=key, value=str(value)) for key, value in each.values.items()],
            )
            for each in statuses
        ]
        return self.answer(DIAGNOSTICS_TOPIC, DIAGNOSTICS, header=self.header(stamp), status=body)

    @staticmethod
    def header(stamp: float, frame: str = "") -> Message:
        """A header of either encoding; ROS 1 counts in it."""
        top = header(stamp, frame)
        top.seq = 0
        return top
