"""Touch: from wrenches on fingertips, and joint positions, to contacts in the palm."""
