"""Raw messages of a robot, the names of their types and topics, and the counts of the messages on each topic."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

from handsight.messages.definitions import CONTACTS, PLAIN_TAXELS, SHADOW, TAXELS
from handsight.rig import Rig

Role = Literal[
    "joints", "wrench", "contact", "skin", "vision", "truth", "color", "depth", "detections", "mask", "tf", "tf_static",
    "info",
]  # fmt: skip


class RosType:
    """`RosType` names the types of the messages that are read or written, as ROS 2 does: `package/msg/Name`."""

    JOINTS = "sensor_msgs/msg/JointState"
    WRENCH = "geometry_msgs/msg/WrenchStamped"
    CONTACT = SHADOW
    ARRAY = "std_msgs/msg/Float32MultiArray"
    POSE = "geometry_msgs/msg/PoseStamped"
    POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
    TF = "tf2_msgs/msg/TFMessage"
    TF_ROS1 = "tf/msg/tfMessage"
    IMAGE = "sensor_msgs/msg/Image"
    COMPRESSED = "sensor_msgs/msg/CompressedImage"
    DETECTIONS = "vision_msgs/msg/Detection2DArray"
    INFO = "sensor_msgs/msg/CameraInfo"
    DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
    MARKERS = "visualization_msgs/msg/MarkerArray"
    TEXT = "std_msgs/msg/String"
    EMPTY = "std_msgs/msg/Empty"


class OwnTopic:
    """`OwnTopic` names the topics that handsight publishes, and those on which it takes a user's requests."""

    POSE = "/handsight/pose"
    TF = "/tf"
    MARKERS = "/handsight/markers"
    DIAGNOSTICS = "/diagnostics"
    START = "/handsight/start"
    OBJECT = "/handsight/object"
    RESET = "/handsight/reset"


MAX_GAP = 0.1  # a longer time between two joint states is counted as a gap [s]
MAX_CLOCK_DIFFERENCE = 0.1  # a larger difference of clocks is reported [s]
MAX_REASONS = 8  # reasons that are kept for a topic; bounded, as one may quote its message


class RosMessage(Protocol):
    """A `RosMessage` is a decoded message of ROS 1 or 2; rosbags generates its class, with the fields as attributes."""

    def __getattr__(self, name: str, /) -> Any:
        """Returns the field of that name; raises AttributeError where the type has none."""


class TaxelSource(NamedTuple):
    """A `TaxelSource` says where a tactile surface's readings are in a message."""

    name: str  # the surface's
    field: str  # path into the message; empty: the message is nothing but the readings
    shape: tuple[int, ...]  # of its readings, such as rows and columns


class RawMessage(NamedTuple):
    """A `RawMessage` is one serialised message of a file or of a running robot."""

    topic: str
    type: str  # as ROS 2 writes it: `package/msg/Name`
    encoding: str  # `cdr` of ROS 2 or `ros1`; anything else is rejected
    log_time: float  # when it was recorded or received [s]
    data: bytes
    definition: str = ""
    """The definition of its type, as the recording or the publisher gives it; empty: not given."""


class MessageRejected(Exception):
    """A `MessageRejected` says why a message is not used; `nan`: it has NaN or infinity. It never leaves this room."""

    def __init__(self, reason: str, *, nan: bool = False) -> None:
        super().__init__(reason)
        self.nan = nan


@dataclass(slots=True)
class TopicReport:
    """A `TopicReport` counts the messages of one topic, or the transforms of /tf.

    Once no message waits any more, `messages` is the sum of the counts from `used` to `stuck`. A message about several
    fingers or tactile surfaces counts once for each.
    """

    name: str
    role: Role  # what the rig uses the topic for
    expected: tuple[str, ...]  # the types that its messages may have
    finger: str = ""  # the finger of a wrench
    tips: dict[str, str] = field(default_factory=dict)
    """The body to which the fingertip of a contact is fixed, by finger."""
    surfaces: tuple[TaxelSource, ...] = ()  # where the readings of tactile surfaces are in a message
    type: str = ""
    messages: int = 0
    used: int = 0
    """Used in order of stamp; if several come between two joint states, the observation has the newest."""
    duplicated: int = 0  # left out, as an earlier message of the same publisher had the same stamp
    nan: int = 0  # left out, as they have NaN or infinity
    late: int = 0  # left out, as they came too late to be put in order of stamp
    bad: int = 0  # left out, as they cannot be used as one of the expected types
    stale: int = 0  # left out, as they were too old when the next joint states came
    stuck: int = 0  # left out, as their sensor is stuck or at full scale
    reasons: Counter[str] = field(default_factory=Counter)  # number of `nan` and `bad` messages, by reason
    last: float | None = None  # stamp of the last used message, in the clock of the joint states [s]
    gap: float = 0.0  # longest time between two used messages [s]
    gaps: int = 0  # number of times between two used messages above `MAX_GAP`
    difference: float = 0.0
    """Its offset minus that of the joint states [s]; offset: median of log time minus stamp over the first second."""
    shifted: bool = False  # whether the difference was added to its stamps, because they are of another clock
    unstamped: bool = False  # whether its stamps are all 0, so that log times are used instead

    def accepts(self, raw: RawMessage) -> bool:
        """Returns whether a message is of a type that is expected here, or has a path into it and its definition."""
        return raw.type in self.expected or (self.any_defined and bool(raw.definition))

    @property
    def any_defined(self) -> bool:
        """Whether its messages may be of any type that comes with its definition, as the rig has a path into them."""
        return any(surface.field for surface in self.surfaces)

    @property
    def readable(self) -> int:
        """Number of messages that could be read, and whose numbers are finite."""
        return self.messages - self.nan - self.bad

    @property
    def left_out(self) -> int:
        """Number of messages that were left out, for whatever reason."""
        return self.duplicated + self.nan + self.late + self.bad + self.stale + self.stuck

    def reject(self, error: MessageRejected) -> None:
        """Counts a message as `nan` or `bad`, with its reason."""
        self.nan, self.bad = self.nan + error.nan, self.bad + (not error.nan)
        reason = str(error)
        if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
            reason = "other reasons"
        self.reasons[reason] += 1

    def use(self, stamp: float) -> None:
        """Counts a message of that stamp [s] as used; stamps must come in order."""
        self.used += 1
        gap = 0.0 if self.last is None else stamp - self.last
        self.gap, self.gaps, self.last = max(self.gap, gap), self.gaps + (gap > MAX_GAP), stamp

    def sentences(self) -> Iterator[str]:
        """Yields a sentence for each problem of this topic that a user should know about."""
        for count, sentence in (
            (self.duplicated, "came twice with one stamp and were used once"),
            (self.late, "came too late to be put in order of stamp and were left out"),
            (self.stale, "were too old when the next joint states came and were left out"),
            *((count, f"left out: {reason}") for reason, count in self.reasons.items()),
        ):
            if count:
                yield f"{self.name}: {count} of {self.messages} messages {sentence}"
        if self.unstamped and not self.type.endswith("MultiArray"):  # which cannot have a stamp
            yield f"{self.name}: no stamps (all 0); timed by when it was recorded"
        if abs(self.difference) > MAX_CLOCK_DIFFERENCE:
            what = "shifted by that: another clock" if self.shifted else "left as they are"
            yield f"{self.name}: stamps {self.difference:+.3f} s off the joint states' clock, {what}"


def rig_topics(rig: Rig) -> dict[str, TopicReport]:
    """Returns an empty report for each topic of the rig, by name."""
    topics = rig.topics
    tf = topics.tf if rig.world_from == "tf" else None
    poses, transforms = (RosType.POSE, RosType.POSE_COVARIANCE), (RosType.TF, RosType.TF_ROS1)
    images = RosType.IMAGE, RosType.COMPRESSED
    found = [TopicReport(topics.joint_states, "joints", (RosType.JOINTS,))]
    wrenches = topics.wrenches.items()
    found += [TopicReport(topic, "wrench", (RosType.WRENCH,), name) for name, topic in wrenches]
    tips: dict[str, dict[str, str]] = {topic: {} for topic in topics.contacts.values()}
    for name, topic in topics.contacts.items():
        tips[topic][name] = rig.fingers[name].frame if name in rig.fingers else ""
    found += [TopicReport(topic, "contact", CONTACTS, tips=bodies) for topic, bodies in tips.items()]
    surfaces: dict[str, list[TaxelSource]] = {topic: [] for topic in topics.skin.values()}
    for name, topic in topics.skin.items():
        shape = rig.skin[name].shape if name in rig.skin else (0, 0)
        surfaces[topic].append(TaxelSource(name, topics.skin_fields.get(name, ""), shape))
    for topic, sources in surfaces.items():
        types = PLAIN_TAXELS if any(not each.field for each in sources) else TAXELS
        found.append(TopicReport(topic, "skin", types, surfaces=tuple(sources)))
    others: tuple[tuple[Role, str | None, tuple[str, ...]], ...] = (
        ("tf", tf, transforms),
        ("tf_static", tf and f"{tf}_static", transforms),
        ("vision", topics.vision, poses),
        ("truth", topics.truth, poses),
        ("color", topics.color, images),
        ("depth", topics.depth, images),
        ("detections", topics.detections, (RosType.DETECTIONS,)),
        ("mask", topics.mask, (RosType.IMAGE,)),
        ("info", topics.camera_info, (RosType.INFO,)),
    )
    found += [TopicReport(topic, role, types) for role, topic, types in others if topic is not None]
    return {each.name: each for each in found}
