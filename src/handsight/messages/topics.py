"""Raw messages of a robot, the names of their types and topics, and the counts of the messages on each topic."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

from handsight.messages.definitions import CONTACTS, PLAIN_TAXELS, SHADOW, TAXELS, definitions_in
from handsight.rig import Rig
from handsight.rig.rig import JointReading

Role = Literal[
    "joints", "wrench", "contact", "skin", "vision", "truth", "color", "depth", "detections", "mask", "tf", "tf_static",
    "info",
]  # fmt: skip


class RosType:
    """Types of the messages that are read or written, as ROS 2 names them: `package/msg/Name`."""

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
    """Topics that handsight publishes, and those on which it takes a user's requests."""

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
    """A decoded message of ROS 1 or 2; rosbags generates its class, with the fields as attributes."""

    def __getattr__(self, name: str, /) -> Any:
        """Returns the field of that name; raises AttributeError where the type has none."""


class TaxelSource(NamedTuple):
    """Where a tactile surface's readings are in a message."""

    name: str  # the surface's
    field: str  # path into the message; empty: the message is nothing but the readings
    shape: tuple[int, ...]  # of its readings, such as rows and columns
    indentation: bool = False  # whether they may be an image with more pixels


class RawMessage(NamedTuple):
    """One serialised message of a file or of a running robot."""

    topic: str
    type: str  # as ROS 2 writes it: `package/msg/Name`
    encoding: str  # `cdr` of ROS 2 or `ros1`; anything else is rejected
    log_time: float  # when it was recorded or received [s]
    data: bytes
    definition: str = ""
    """The definition of its type, as the recording or the publisher gives it; empty: not given."""


class MessageRejected(Exception):
    """Why a message is not used; `nan`: it has NaN or infinity. It never leaves this room."""

    def __init__(self, reason: str, *, nan: bool = False) -> None:
        super().__init__(reason)
        self.nan = nan


@dataclass(slots=True)
class TopicReport:
    """Counts of the messages of one topic, or of the transforms of /tf.

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
    joints: JointReading | None = None  # how the positions of joints are read; None: those of a JointState
    wanted: str = ""
    """What is missing without the topic, such as `finger ff: no wrench`; empty: it may be absent."""
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
    reasons: Counter[str] = field(
        default_factory=Counter
    )  # number of `nan`, `bad` and `stuck` messages, by reason
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
        paths = [surface.field for surface in self.surfaces]
        if self.joints is not None:
            paths.append(self.joints.field)
        return any(paths)

    @property
    def readable(self) -> int:
        """Number of messages that could be read, and whose numbers are finite."""
        return self.messages - self.nan - self.bad

    @property
    def left_out(self) -> int:
        """Number of messages that were left out, for whatever reason."""
        return self.duplicated + self.nan + self.late + self.bad + self.stale + self.stuck

    def reject(self, reason: str, *, nan: bool) -> None:
        """Counts a message as `nan` or `bad`, with its reason."""
        self.nan += nan
        self.bad += not nan
        self._leave_out(reason)

    def take_back(self, reason: str) -> None:
        """Counts a message that was used as `stuck`, with its reason."""
        self.used -= 1
        self.stuck += 1
        self._leave_out(reason)

    def _leave_out(self, reason: str) -> None:
        if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
            reason = "other reasons"
        self.reasons[reason] += 1

    def use(self, stamp: float) -> None:
        """Counts a message of that stamp [s] as used; stamps must come in order."""
        self.used += 1
        if self.last is not None:
            gap = stamp - self.last
            self.gap = max(self.gap, gap)
            self.gaps += gap > MAX_GAP
        self.last = stamp

    @property
    def faults(self) -> Counter[str]:
        """Numbers of messages of which a user should know something, by what that is."""
        found = Counter({f"left out: {reason}": count for reason, count in self.reasons.items()})
        found["came twice with one stamp and were used once"] = self.duplicated
        found["came too late to be put in order of stamp and were left out"] = self.late
        found["were too old when the next joint states came and were left out"] = self.stale
        return +found

    def notes(self) -> Iterator[str]:
        """Yields a sentence for each problem that all messages of this topic have."""
        if self.unstamped and not self.type.endswith("MultiArray"):  # which cannot have a stamp
            yield f"{self.name}: no stamps (all 0); timed by when it was recorded"
        if abs(self.difference) > MAX_CLOCK_DIFFERENCE:
            what = "shifted by that: another clock" if self.shifted else "left as they are"
            yield f"{self.name}: stamps {self.difference:+.3f} s off the joint states' clock, {what}"


def _taxel_source(name: str, rig: Rig) -> TaxelSource:
    """Returns where the readings of a tactile surface are."""
    path = rig.topics.skin_fields.get(name, "")
    surface = rig.skin.get(name)
    if surface is None:
        return TaxelSource(name, path, (0, 0))
    return TaxelSource(name, path, surface.shape, surface.indentation)


def rig_topics(rig: Rig) -> dict[str, TopicReport]:
    """Returns an empty report for each topic of the rig, by name."""
    topics = rig.topics
    reading = topics.joint_reading
    own = tuple(definitions_in(topics.messages))
    by_path = reading is not None and bool(reading.field)
    types = (RosType.JOINTS, *PLAIN_TAXELS, *own) if by_path else (RosType.JOINTS,)
    joints = TopicReport(topics.joint_states, "joints", types, joints=reading, wanted="no joint states")
    found = [joints]
    for finger, topic in topics.wrenches.items():
        wanted = f"finger {finger}: no wrench"
        found.append(TopicReport(topic, "wrench", (RosType.WRENCH,), finger, wanted=wanted))
    bodies = {name: finger.frame for name, finger in rig.fingers.items()}
    for topic, fingers in _by_topic(topics.contacts).items():
        tips = {finger: bodies.get(finger, "") for finger in fingers}
        wanted = f"finger {', '.join(fingers)}: no contacts"
        found.append(TopicReport(topic, "contact", CONTACTS, tips=tips, wanted=wanted))
    for topic, names in _by_topic(topics.skin).items():
        sources = [_taxel_source(name, rig) for name in names]
        if topic == joints.name:  # a message of the whole hand
            joints.surfaces = tuple(sources)
            continue
        types = (*TAXELS, *own) if all(source.field for source in sources) else PLAIN_TAXELS
        wanted = f"skin {', '.join(names)}: no readings"
        found.append(TopicReport(topic, "skin", types, surfaces=tuple(sources), wanted=wanted))
    tf = topics.tf if rig.world_from == "tf" else None
    calibrated = rig.camera is not None and rig.camera.intrinsics is not None
    poses = (RosType.POSE, RosType.POSE_COVARIANCE)
    transforms = (RosType.TF, RosType.TF_ROS1)
    images = RosType.IMAGE, RosType.COMPRESSED
    others: tuple[tuple[Role, str | None, tuple[str, ...], str], ...] = (
        ("tf", tf, transforms, "no transforms"),
        ("tf_static", tf and f"{tf}_static", transforms, ""),
        ("vision", topics.vision, poses, "no vision"),
        ("truth", topics.truth, poses, ""),
        ("color", topics.color, images, "no color images"),
        ("depth", topics.depth, images, "no depth images"),
        ("detections", topics.detections, (RosType.DETECTIONS,), ""),
        ("mask", topics.mask, (RosType.IMAGE,), ""),
        ("info", topics.camera_info, (RosType.INFO,), "" if calibrated else "no camera info"),
    )
    found += [TopicReport(name, role, types, wanted=what) for role, name, types, what in others if name]
    return {each.name: each for each in found}


def _by_topic(topics: Mapping[str, str]) -> dict[str, list[str]]:
    """Returns the names of fingers or surfaces by topic."""
    return {topic: [name for name in topics if topics[name] == topic] for topic in topics.values()}
