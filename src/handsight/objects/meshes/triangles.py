"""Triangle meshes as surfaces."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from handsight.checks import Array, Indices
from handsight.errors import InvalidObject
from handsight.objects.surface import drawn_by_area


@dataclass(frozen=True, eq=False)
class Triangles:
    """The surface of a triangle mesh."""

    vertices: Array
    """(k, 3) [m]."""
    faces: Indices
    """(m, 3) vertex indices, counterclockwise from outside."""

    @property
    def area(self) -> float:
        """Sum of the triangles' areas [m²]."""
        return float(self.areas.sum())

    @property
    def corners(self) -> Array:
        """(m, 3, 3) of each triangle [m]."""
        return np.asarray(self.vertices[self.faces])

    @cached_property
    def doubled_normals(self) -> Array:
        """(m, 3) outward normals as long as twice each triangle's area [m²]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))

    @cached_property
    def areas(self) -> Array:
        """(m,) of each triangle [m²]."""
        return np.asarray(np.linalg.norm(self.doubled_normals, axis=1) / 2)

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """n points (n, 3) [m], uniform over the area, and the normals (n, 3) of their triangles."""
        points, normals, _ = self.draw_on_faces(n, rng)
        return points, normals

    def draw_on_faces(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, Indices]:
        """As `draw`, and the triangle (n,) of each."""
        face = drawn_by_area(self.areas, n, rng)
        u, v = rng.random((2, n))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        a, b, c = (self.vertices[self.faces[face, k]] for k in range(3))
        normals = self.doubled_normals[face]
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), normals, face


def checked(vertices: ArrayLike, faces: ArrayLike) -> Triangles:
    """The mesh of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject where these are none."""
    try:
        points, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    except (TypeError, ValueError):
        raise InvalidObject("mesh: expected numbers for vertices (k, 3) and faces (m, 3)") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InvalidObject(f"vertices: expected shape (k, 3) with k ≥ 3, got {points.shape}")
    if triangles.size == 0:
        raise InvalidObject("faces: expected at least one triangle, got none")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InvalidObject(
            f"faces: expected whole numbers of shape (m, 3), got {triangles.dtype} {triangles.shape}"
        )
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InvalidObject(
            f"faces: expected indices 0 to {len(points) - 1}, got {triangles.min()} to {triangles.max()}"
        )
    return Triangles(points, triangles.astype(np.int64))
