"""Messages as bytes, the role of each topic for a rig, and the counts of its messages."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

from handsight.rig import Rig

Role = Literal[
    "joints", "wrench", "contact", "skin", "vision", "truth", "color", "depth", "tf", "tf_static", "info"
]

JOINTS, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
CONTACT = "sr_robot_msgs/msg/ShadowContactStateStamped"
TF, TF_ROS1 = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
ARRAY = "std_msgs/msg/Float32MultiArray"
POSES, IMAGES, TRANSFORMS = (POSE, POSE_COVARIANCE), (IMAGE, COMPRESSED), (TF, TF_ROS1)


class TopicOptions(NamedTuple):
    """`TopicOptions` say what a report mentions of a topic."""

    max_gap: float = 0.1  # joint states farther apart are counted as a gap [s]
    max_clock_difference: float = 0.1  # clocks farther apart are reported [s]
    max_reasons: int = 8
    """Different reasons that are kept for a topic; a message's own words may be among them."""


TOPICS = TopicOptions()


class RosMessage(Protocol):
    """A `RosMessage` is a decoded message of ROS 1 or 2: its fields are attributes, whose types rosbags generates."""

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
    """A message is not used, for a reason; `nan`: it holds NaN or infinity. It never leaves this package."""

    def __init__(self, reason: str, *, nan: bool = False) -> None:
        super().__init__(reason)
        self.nan = nan


@dataclass(slots=True)
class TopicReport:
    """A `TopicReport` counts the messages of one topic, /tf by transforms.

    `messages` is the sum of the counts from `used` to `stuck`.
    """

    name: str
    role: Role
    """Its role for the rig."""
    expected: tuple[str, ...]
    """Message types that it may have."""
    finger: str = ""
    """Of a wrench or a contact; of a tactile array, its name."""
    body: str = ""
    """Of a contact: the body of the hand that the tip moves with."""
    shape: tuple[int, int] = (0, 0)
    """Of a tactile array: rows and columns."""
    type: str = ""
    messages: int = 0
    used: int = 0
    """In order of stamp; of several between two joint states the newest is in the observation."""
    duplicated: int = 0
    """Of the same topic and stamp as one before."""
    nan: int = 0
    """With NaN or infinity in it."""
    late: int = 0
    """Beyond the reorder window."""
    bad: int = 0
    """Not readable as one of the expected types."""
    stale: int = 0
    """Too old when the next joint states came."""
    stuck: int = 0
    """Of a sensor that is stuck or at full scale."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Why messages were not used, with how many."""
    last: float | None = None
    """Latest stamp that was used, in the clock of the joint states [s]."""
    gap: float = 0.0
    """Longest time between two that were used [s]."""
    gaps: int = 0
    """Number of times longer than 0.1 s."""
    difference: float = 0.0
    """Of its clock from the joint states': log time minus stamp, median of the first second [s]."""
    shifted: bool = False
    """Whether the stamps were shifted by the difference: it is another clock."""
    unstamped: bool = False
    """Whether its stamps are all 0, and log time was taken."""

    def reject(self, error: MessageRejected) -> None:
        """Counts a message as nan or bad, and why."""
        self.nan, self.bad = self.nan + error.nan, self.bad + (not error.nan)
        reason = str(error)
        if reason not in self.reasons and len(self.reasons) >= TOPICS.max_reasons:
            reason = "other reasons"
        self.reasons[reason] += 1

    def use(self, stamp: float) -> None:
        """Counts a message as used, in order of stamp."""
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
    bodies = {finger: tip.frame for finger, tip in rig.fingers.items()}
    shapes = {name: array.shape for name, array in rig.skin.items()}
    found = [TopicReport(topics.joint_states, "joints", (JOINTS,))]
    found += [TopicReport(topic, "wrench", (WRENCH,), finger) for finger, topic in topics.wrenches.items()]
    found += [
        TopicReport(topic, "contact", (CONTACT,), finger, bodies.get(finger, ""))
        for finger, topic in topics.contacts.items()
    ]
    found += [
        TopicReport(topic, "skin", (ARRAY, IMAGE), name, shape=shapes.get(name, (0, 0)))
        for name, topic in topics.skin.items()
    ]
    others: tuple[tuple[Role, str | None, tuple[str, ...]], ...] = (
        ("tf", tf, TRANSFORMS),
        ("tf_static", None if tf is None else f"{tf}_static", TRANSFORMS),
        ("vision", topics.vision, POSES),
        ("truth", topics.truth, POSES),
        ("color", topics.color, IMAGES),
        ("depth", topics.depth, IMAGES),
        ("info", topics.camera_info, (INFO,)),
    )
    found += [TopicReport(topic, role, types) for role, topic, types in others if topic is not None]
    return {each.name: each for each in found}
