"""A known object in depth images: its first pose, which object it is, and its pose followed over time."""
