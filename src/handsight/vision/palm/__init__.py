"""The robot's own hand in depth images: its mask, and the pose of its palm in the camera."""
