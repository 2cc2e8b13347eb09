"""Messages of ROS 1 as bytes, in and out: handsight decodes and encodes them."""

from functools import lru_cache

import rospy

from handsight.messages import RawMessage
from handsight.messages.read import typestore


@lru_cache
def ros2_name(kind):
    """Returns `package/msg/Name` of a type as ROS 1 writes it, `package/Name`."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"


def heard(topic, message, now):
    """Returns the raw message of an AnyMsg that came `now` [s]."""
    header = message._connection_header
    kind, definition = ros2_name(header["type"]), header.get("message_definition", "")
    return RawMessage(topic, kind, "ros1", now, message._buff, definition)


def bytes_of(kind):
    """Returns a class of messages of that type, whose bytes are published as they are given."""
    definition, md5 = typestore("ros1").generate_msgdef(kind, ros_version=1)
    package, _, name = kind.split("/")
    fields = {"__slots__": [], "_type": f"{package}/{name}", "_md5sum": md5, "_full_text": definition}
    return type(name, (rospy.AnyMsg,), fields)
