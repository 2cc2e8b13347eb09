"""What a robot says, as messages of ROS, to `Observation`s: from a file or live alike."""
