"""ROS 2 without ROS: its messages over DDS, for machines whose ROS has another Python, or none.

`Network` joins the domain as ROS 2 would be told to by the environment, `Bridge` carries a `LiveTracker`'s messages.
No services, parameters or node's name: what is asked for are topics.
"""

from handsight.errors import MissingExtra

try:
    import cyclonedds as _  # noqa: F401
except ImportError:
    raise MissingExtra("the bridge to ROS 2 needs cyclonedds: pip install 'handsight[ros2]'") from None

from handsight.bridge.bridge import Bridge
from handsight.bridge.network import Network

__all__ = ["Bridge", "Network"]
