"""The node of ROS 2."""
