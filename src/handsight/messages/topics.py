"""Raw messages of a robot, the names of their types and topics, and what a rig expects on each of its topics."""

from collections.abc import Mapping
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


class RosMessage(Protocol):
    """A decoded message of ROS 1 or 2; rosbags generates its class, with the fields as attributes."""

    def __getattr__(self, name: str, /) -> Any:
        """Returns the field of that name; raises AttributeError where the type has none."""


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


class TaxelSource(NamedTuple):
    """Where a tactile surface's readings are in a message."""

    name: str  # the surface's
    field: str  # path into the message; empty: the message is nothing but the readings
    shape: tuple[int, ...]  # of its readings, such as rows and columns
    indentation: bool = False  # whether they may be an image with more pixels


@dataclass(frozen=True, slots=True)
class Topic:
    """What a rig expects on one topic."""

    name: str
    role: Role  # what the rig uses the topic for
    expected: tuple[str, ...]  # the types that its messages may have
    finger: str = ""  # the finger of a wrench
    tips: Mapping[str, str] = field(default_factory=dict)
    """The body to which the fingertip of a contact is fixed, by finger."""
    surfaces: tuple[TaxelSource, ...] = ()  # where the readings of tactile surfaces are in a message
    joints: JointReading | None = None  # how the positions of joints are read; None: those of a JointState
    wanted: str = ""
    """What is missing without the topic, such as `finger ff: no wrench`; empty: it may be absent."""
    offset: float = 0.0  # what is added to its stamps [s]

    @property
    def any_defined(self) -> bool:
        """Whether its messages may be of any type that comes with its definition, as the rig has a path into them."""
        by_path = self.joints is not None and bool(self.joints.field)
        return by_path or any(surface.field for surface in self.surfaces)

    def accepts(self, raw: RawMessage) -> bool:
        """Returns whether a message is of a type that is expected here, or has a path into it and its definition."""
        return raw.type in self.expected or (bool(raw.definition) and self.any_defined)


def rig_topics(rig: Rig) -> dict[str, Topic]:
    """Returns what the rig expects on each of its topics, by name."""
    found = [_joints(rig), *_wrenches(rig), *_contacts(rig), *_skin(rig), *_of_camera_and_world(rig)]
    return {topic.name: topic for topic in found}


def _topic(rig: Rig, name: str, role: Role, expected: tuple[str, ...], wanted: str, **how: Any) -> Topic:
    return Topic(name, role, expected, wanted=wanted, offset=rig.topics.offsets.get(name, 0.0), **how)


def _joints(rig: Rig) -> Topic:
    """Returns the topic of the joint states, whose messages may have the whole hand's taxels too."""
    topics = rig.topics
    reading = topics.joint_reading
    types: tuple[str, ...] = (RosType.JOINTS,)
    if reading is not None and reading.field:
        types = (RosType.JOINTS, *PLAIN_TAXELS, *definitions_in(topics.messages))
    name = topics.joint_states
    surfaces = tuple(_taxel_source(each, rig) for each in topics.skin if topics.skin[each] == name)
    return _topic(rig, name, "joints", types, "no joint states", joints=reading, surfaces=surfaces)


def _wrenches(rig: Rig) -> list[Topic]:
    return [
        _topic(rig, name, "wrench", (RosType.WRENCH,), f"finger {finger}: no wrench", finger=finger)
        for finger, name in rig.topics.wrenches.items()
    ]


def _contacts(rig: Rig) -> list[Topic]:
    found = list[Topic]()
    for name, fingers in _by_topic(rig.topics.contacts).items():
        tips = {finger: rig.fingers[finger].frame if finger in rig.fingers else "" for finger in fingers}
        wanted = f"finger {', '.join(fingers)}: no contacts"
        found.append(_topic(rig, name, "contact", CONTACTS, wanted, tips=tips))
    return found


def _skin(rig: Rig) -> list[Topic]:
    own = tuple(definitions_in(rig.topics.messages))
    found = list[Topic]()
    for name, surfaces in _by_topic(rig.topics.skin).items():
        sources = tuple(_taxel_source(each, rig) for each in surfaces)
        types = (*TAXELS, *own) if all(source.field for source in sources) else PLAIN_TAXELS
        wanted = f"skin {', '.join(surfaces)}: no readings"
        if name != rig.topics.joint_states:
            found.append(_topic(rig, name, "skin", types, wanted, surfaces=sources))
    return found


def _of_camera_and_world(rig: Rig) -> list[Topic]:
    topics = rig.topics
    tf = topics.tf if rig.world_from == "tf" else None
    calibrated = rig.camera is not None and rig.camera.intrinsics is not None
    poses = (RosType.POSE, RosType.POSE_COVARIANCE)
    transforms = (RosType.TF, RosType.TF_ROS1)
    images = (RosType.IMAGE, RosType.COMPRESSED)
    rows: tuple[tuple[Role, str | None, tuple[str, ...], str], ...] = (
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
    return [_topic(rig, name, role, types, wanted) for role, name, types, wanted in rows if name]


def _taxel_source(name: str, rig: Rig) -> TaxelSource:
    """Returns where the readings of a tactile surface are."""
    path = rig.topics.skin_fields.get(name, "")
    surface = rig.skin.get(name)
    if surface is None:
        return TaxelSource(name, path, (0, 0))
    return TaxelSource(name, path, surface.shape, surface.indentation)


def _by_topic(topics: Mapping[str, str]) -> dict[str, list[str]]:
    """Returns the names of fingers or surfaces by topic."""
    return {topic: [name for name in topics if topics[name] == topic] for topic in topics.values()}
