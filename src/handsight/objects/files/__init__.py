"""Shapes read from files: meshes and clouds in the file's own unit."""

from handsight.objects.files.read import Shape, read_shape

__all__ = ["Shape", "read_shape"]
