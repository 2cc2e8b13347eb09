"""Contact sensing: from wrenches and joint positions to contacts in the palm."""
