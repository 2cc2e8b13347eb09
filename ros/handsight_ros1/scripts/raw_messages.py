"""Messages of ROS 1 as the bytes they are, in and out: decoding and encoding are handsight's."""

from functools import lru_cache

import rospy

from handsight.messages import RawMessage
from handsight.messages.decode import typestore


@lru_cache
def ros2_name(kind):
    """`package/msg/Name`, of a type as ROS 1 writes it."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"


def heard(topic, message, now):
    """An AnyMsg that came now."""
    return RawMessage(topic, ros2_name(message._connection_header["type"]), "ros1", now, message._buff)


def bytes_of(kind):
    """A class of messages of that type that are published as the bytes they are given."""
    definition, md5 = typestore("ros1").generate_msgdef(kind, ros_version=1)
    package, _, name = kind.split("/")
    fields = {"__slots__": [], "_type": f"{package}/{name}", "_md5sum": md5, "_full_text": definition}
    return type(name, (rospy.AnyMsg,), fields)
