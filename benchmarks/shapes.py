"""Shapes made in code, of any number of triangles."""

import numpy as np
import trimesh

SIZE = 0.05
"""Mean radius of the bumpy shape [m]."""


def bumpy(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [m] and 20 · 4^subdivisions faces of a ball with smooth dents and no symmetry."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    u = np.asarray(ball.vertices)
    x, y, z = u.T
    length = (
        1 + 0.15 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.10 * np.sin(4 * z + 2 * x) + 0.2 * z * z + 0.12 * x
    )
    return SIZE * length[:, None] * u, np.asarray(ball.faces)


def can(radius: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns a closed cylinder about the origin and z, of triangles whose edges are below 4 mm."""
    mesh = trimesh.creation.cylinder(radius, height, sections=128).subdivide_to_size(0.004)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)
