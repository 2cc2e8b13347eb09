"""ROS 2 without ROS: its messages over DDS, for machines without ROS or with a ROS for another Python.

`Network` joins the DDS domain that ROS 2's environment variables specify; `Bridge` carries the messages of a
`LiveTracker`. There are no services, no parameters and no node name: users make requests on topics.
"""

from handsight.errors import needing

with needing("the bridge to ROS 2 needs cyclonedds", "ros2"):
    import cyclonedds as _  # noqa: F401

from handsight.bridge.bridge import Bridge, Network

__all__ = ["Bridge", "Network"]
