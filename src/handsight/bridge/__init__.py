"""ROS 2 without ROS: its messages over DDS, for machines whose ROS has another Python, or none.

`Network` joins the domain that ROS 2's environment variables name, `Bridge` carries a `LiveTracker`'s messages. There
are no services, no parameters and no node's name: users make requests by topics.
"""

from handsight.errors import MissingExtra

try:
    import cyclonedds as _  # noqa: F401
except ImportError:
    raise MissingExtra("the bridge to ROS 2 needs cyclonedds: pip install 'handsight[ros2]'") from None

from handsight.bridge.bridge import Bridge
from handsight.bridge.network import Network

__all__ = ["Bridge", "Network"]
