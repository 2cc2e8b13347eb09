"""Triangle meshes: repair, closest points, winding numbers, and the distance fields computed with these."""
