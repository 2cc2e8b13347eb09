"""Triangle meshes: repair, closest points, winding numbers, and the distance fields that follow."""
