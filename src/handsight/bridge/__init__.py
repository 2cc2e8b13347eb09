"""ROS 2 without ROS: its messages over DDS, for machines without ROS or with a ROS for another Python.

`Network` joins the DDS domain that ROS 2's environment variables specify; `Bridge` carries the messages of a
`LiveTracker`. There are no services, no parameters and no node name: users make requests on topics.
"""

from handsight.errors import MissingExtra

try:
    import cyclonedds as _  # noqa: F401
except ImportError:
    raise MissingExtra("the bridge to ROS 2 needs cyclonedds: pip install 'handsight[ros2]'") from None

from handsight.bridge.bridge import Bridge, Network

__all__ = ["Bridge", "Network"]
