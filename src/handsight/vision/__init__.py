"""Sight: where an object is, from depth images."""
