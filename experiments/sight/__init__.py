"""What a camera sees of an object."""
