"""Files of shapes: meshes and clouds read in the file's own unit, and written as PLY."""

from handsight.objects.files.ply import ply_bytes, write_recentred
from handsight.objects.files.read import read_shape
from handsight.objects.files.shape import Shape

__all__ = ["Shape", "ply_bytes", "read_shape", "write_recentred"]
