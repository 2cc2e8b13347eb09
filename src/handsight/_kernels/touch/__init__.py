"""Contact sensing: wrenches and joint positions to contacts in the palm."""
