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


def can(triangles: int, radius: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns a closed cylinder about the origin and z, of about so many triangles, none of them a sliver."""
    around = max(16, int(np.sqrt(triangles * np.pi * radius / (height + radius))))
    side = max(2, int(around * height / (2 * np.pi * radius)))
    rings = max(2, int(around / (2 * np.pi)))
    profile = [(radius * k / rings, -height / 2) for k in range(1, rings)]
    profile += [(radius, -height / 2 + height * k / side) for k in range(side + 1)]
    profile += [(radius * k / rings, height / 2) for k in range(rings - 1, 0, -1)]
    rows, angle = np.array(profile), 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    body = np.concatenate([np.column_stack([r * circle, np.full(around, z)]) for r, z in rows])
    vertices = np.concatenate([body, [[0, 0, -height / 2], [0, 0, height / 2]]])
    here, there = np.arange(around), np.roll(np.arange(around), -1)
    faces = [np.column_stack([there, here, np.full(around, len(body))])]
    for k in range(len(rows) - 1):
        a, b = k * around, (k + 1) * around
        faces += [
            np.column_stack([here + a, there + a, there + b]),
            np.column_stack([here + a, there + b, here + b]),
        ]
    last = (len(rows) - 1) * around
    faces.append(np.column_stack([here + last, there + last, np.full(around, len(body) + 1)]))
    return vertices, np.concatenate(faces)
