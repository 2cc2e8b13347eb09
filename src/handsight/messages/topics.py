"""Messages as bytes, and what each topic is to a rig."""

from typing import Literal, NamedTuple

from handsight.rig import Rig

Role = Literal["joints", "wrench", "vision", "truth", "color", "depth", "tf", "tf_static", "info"]

JOINTS, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
TF, TF_ROS1 = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
TYPES: dict[Role, tuple[str, ...]] = {
    "joints": (JOINTS,),
    "wrench": (WRENCH,),
    "vision": (POSE, POSE_COVARIANCE),
    "truth": (POSE, POSE_COVARIANCE),
    "color": (IMAGE, COMPRESSED),
    "depth": (IMAGE, COMPRESSED),
    "tf": (TF, TF_ROS1),
    "tf_static": (TF, TF_ROS1),
    "info": (INFO,),
}


class RawMessage(NamedTuple):
    """One message as it lies in a file or comes from a robot."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    encoding: str
    """`cdr` of ROS 2 or `ros1`; anything else is rejected."""
    log_time: float
    """When it was recorded or received [s]."""
    data: bytes


class Channel(NamedTuple):
    """What a topic is to the rig."""

    topic: str
    role: Role
    finger: str = ""
    """Of a wrench."""


def channels(rig: Rig) -> dict[str, Channel]:
    """What the rig listens to, by topic."""
    topics = rig.topics
    heard = [Channel(topics.joint_states, "joints")]
    heard += [Channel(topic, "wrench", finger) for finger, topic in topics.wrenches.items()]
    if topics.tf is not None and rig.world_from == "tf":
        heard += [Channel(topics.tf, "tf"), Channel(f"{topics.tf}_static", "tf_static")]
    others: dict[Role, str | None] = {
        "vision": topics.vision,
        "truth": topics.truth,
        "color": topics.color,
        "depth": topics.depth,
        "info": topics.camera_info,
    }
    heard += [Channel(topic, role) for role, topic in others.items() if topic is not None]
    return {channel.topic: channel for channel in heard}
