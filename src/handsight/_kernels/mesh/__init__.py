"""Surfaces: distance fields, closest points of meshes, winding numbers, and quadrics fitted to points."""
