"""What objects compute: distance fields, triangles, quadrics."""
