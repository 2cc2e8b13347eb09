"""A robot's messages as bytes, the names of their types and topics, and the counts of what came on each topic."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

from handsight.rig import Rig

Role = Literal[
    "joints", "wrench", "contact", "skin", "vision", "truth", "color", "depth", "tf", "tf_static", "info"
]


class RosType:
    """`RosType` names the types of the messages that are read or written, as ROS 2 does: `package/msg/Name`."""

    JOINTS = "sensor_msgs/msg/JointState"
    WRENCH = "geometry_msgs/msg/WrenchStamped"
    CONTACT = "sr_robot_msgs/msg/ShadowContactStateStamped"
    ARRAY = "std_msgs/msg/Float32MultiArray"
    POSE = "geometry_msgs/msg/PoseStamped"
    POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
    TF = "tf2_msgs/msg/TFMessage"
    TF_ROS1 = "tf/msg/tfMessage"
    IMAGE = "sensor_msgs/msg/Image"
    COMPRESSED = "sensor_msgs/msg/CompressedImage"
    INFO = "sensor_msgs/msg/CameraInfo"
    DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
    MARKERS = "visualization_msgs/msg/MarkerArray"
    TEXT = "std_msgs/msg/String"
    EMPTY = "std_msgs/msg/Empty"


class OwnTopic:
    """`OwnTopic` names the topics that handsight publishes, and those by which a user asks for something."""

    POSE = "/handsight/pose"
    TF = "/tf"
    MARKERS = "/handsight/markers"
    DIAGNOSTICS = "/diagnostics"
    START = "/handsight/start"
    OBJECT = "/handsight/object"
    RESET = "/handsight/reset"


class TopicOptions(NamedTuple):
    """`TopicOptions` say what a report mentions of a topic."""

    max_gap: float = 0.1  # a longer time between two joint states is counted as a gap [s]
    max_clock_difference: float = 0.1  # a larger difference of clocks is reported [s]
    max_reasons: int = 8  # different reasons that are kept for a topic: a reason may quote the message


TOPICS = TopicOptions()


class RosMessage(Protocol):
    """A `RosMessage` is a decoded message of ROS 1 or 2; rosbags generates its class, with the fields as attributes."""

    def __getattr__(self, name: str, /) -> Any:
        """Returns the field of that name; raises AttributeError where the type has none."""


class RawMessage(NamedTuple):
    """A `RawMessage` is one message as it lies in a file or comes from a robot."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    encoding: str
    """`cdr` of ROS 2 or `ros1`; anything else is rejected."""
    log_time: float
    """When it was recorded or received [s]."""
    data: bytes


class MessageRejected(Exception):
    """A `MessageRejected` says why a message is not used; `nan`: it holds NaN or infinity. It stays in this room."""

    def __init__(self, reason: str, *, nan: bool = False) -> None:
        super().__init__(reason)
        self.nan = nan


@dataclass(slots=True)
class TopicReport:
    """A `TopicReport` counts the messages of one topic; of /tf it counts the transforms.

    `messages` is the sum of the counts from `used` to `stuck`, once all messages have come.
    """

    name: str
    role: Role
    """Its role for the rig."""
    expected: tuple[str, ...]
    """Message types that it may have."""
    finger: str = ""
    """The finger of a wrench or a contact, or the name of a tactile array."""
    body: str = ""
    """The body of the hand that the fingertip of a contact moves with."""
    shape: tuple[int, int] = (0, 0)
    """Rows and columns of a tactile array."""
    type: str = ""
    messages: int = 0
    used: int = 0
    """Used in order of stamp; of several between two joint states, the newest is in the observation."""
    duplicated: int = 0
    """With the stamp of an earlier message of the same publisher."""
    nan: int = 0
    """With NaN or infinity in it."""
    late: int = 0
    """Too late to be put in order of stamp."""
    bad: int = 0
    """Not readable as one of the expected types."""
    stale: int = 0
    """Too old when the next joint states came."""
    stuck: int = 0
    """From a sensor that is stuck or at full scale."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Number of messages that were not used, by the reason."""
    last: float | None = None
    """Latest stamp that was used, in the clock of the joint states [s]."""
    gap: float = 0.0
    """Longest time between two messages that were used [s]."""
    gaps: int = 0
    """Number of such times above `TopicOptions.max_gap`."""
    difference: float = 0.0
    """How far its log time minus stamp (the median of the first second) is above that of the joint states [s]."""
    shifted: bool = False
    """Whether the difference was added to the stamps, because they are of another clock."""
    unstamped: bool = False
    """Whether its stamps are all 0, so that log times are used instead."""

    def reject(self, error: MessageRejected) -> None:
        """Counts a message as nan or bad, with its reason."""
        self.nan, self.bad = self.nan + error.nan, self.bad + (not error.nan)
        reason = str(error)
        if reason not in self.reasons and len(self.reasons) >= TOPICS.max_reasons:
            reason = "other reasons"
        self.reasons[reason] += 1

    def use(self, stamp: float) -> None:
        """Counts a message of that stamp [s] as used; stamps must come in order."""
        self.used += 1
        gap = 0.0 if self.last is None else stamp - self.last
        self.gap, self.gaps, self.last = max(self.gap, gap), self.gaps + (gap > TOPICS.max_gap), stamp

    def sentences(self) -> Iterator[str]:
        """Yields a sentence for each problem of this topic that a user should know of."""
        for count, sentence in (
            (self.duplicated, "came twice with one stamp and were used once"),
            (self.late, "came too late to be put in order of stamp and were left out"),
            (self.stale, "were too old when the next joint states came and were left out"),
            *((count, f"left out: {reason}") for reason, count in self.reasons.items()),
        ):
            if count:
                yield f"{self.name}: {count} of {self.messages} messages {sentence}"
        if self.unstamped:
            yield f"{self.name}: no stamps (all 0); timed by when it was recorded"
        if abs(self.difference) > TOPICS.max_clock_difference:
            what = "shifted by that: another clock" if self.shifted else "left as they are"
            yield f"{self.name}: stamps {self.difference:+.3f} s off the joint states' clock, {what}"


def rig_topics(rig: Rig) -> dict[str, TopicReport]:
    """Returns a report without counts for each topic that the rig listens to, by name."""
    topics = rig.topics
    tf = topics.tf if rig.world_from == "tf" else None
    poses, transforms = (RosType.POSE, RosType.POSE_COVARIANCE), (RosType.TF, RosType.TF_ROS1)
    images = RosType.IMAGE, RosType.COMPRESSED
    found = [TopicReport(topics.joint_states, "joints", (RosType.JOINTS,))]
    found += [
        TopicReport(topic, "wrench", (RosType.WRENCH,), name) for name, topic in topics.wrenches.items()
    ]
    for name, topic in topics.contacts.items():
        body = rig.fingers[name].frame if name in rig.fingers else ""
        found.append(TopicReport(topic, "contact", (RosType.CONTACT,), name, body))
    for name, topic in topics.skin.items():
        shape = rig.skin[name].shape if name in rig.skin else (0, 0)
        found.append(TopicReport(topic, "skin", (RosType.ARRAY, RosType.IMAGE), name, shape=shape))
    others: tuple[tuple[Role, str | None, tuple[str, ...]], ...] = (
        ("tf", tf, transforms),
        ("tf_static", tf and f"{tf}_static", transforms),
        ("vision", topics.vision, poses),
        ("truth", topics.truth, poses),
        ("color", topics.color, images),
        ("depth", topics.depth, images),
        ("info", topics.camera_info, (RosType.INFO,)),
    )
    found += [TopicReport(topic, role, types) for role, topic, types in others if topic is not None]
    return {each.name: each for each in found}
