"""Surfaces: distance fields, closest triangles, winding numbers, and quadrics through points."""
