"""Points spread over a surface: what an object's samples are drawn from."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.objects.fields.field import Field

Faces = NDArray[np.int64]
LLOYD_STEPS = 12
CROWD = 20


class Surface(Protocol):
    """Something with an area from which points can be drawn."""

    @property
    def area(self) -> float:
        """Total [m²]."""
        ...

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """n points (n, 3) [m], uniform over the area, and their unit outward normals (n, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class Triangles:
    """The surface of a triangle mesh."""

    vertices: Array
    """(k, 3) [m]."""
    faces: Faces
    """(m, 3) vertex indices, counterclockwise from outside."""

    @property
    def area(self) -> float:
        """Sum of the triangles' areas [m²]."""
        return float(self.areas.sum())

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
        points, face = self.draw_on_faces(n, rng)
        normals = self.doubled_normals[face]
        return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def draw_on_faces(self, n: int, rng: np.random.Generator) -> tuple[Array, Faces]:
        """n points (n, 3) [m], uniform over the area, and the triangle (n,) of each."""
        # One draw per n-th of the area spreads better than n free draws, and is as uniform.
        at = (np.arange(n) + rng.random(n)) / max(n, 1)
        face = np.searchsorted(np.cumsum(self.areas) / self.area, at).clip(max=len(self.faces) - 1)
        u, v = rng.random((2, n))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        a, b, c = (self.vertices[self.faces[face, k]] for k in range(3))
        return a + u[:, None] * (b - a) + v[:, None] * (c - a), face


@dataclass(frozen=True, slots=True, eq=False)
class Rounded:
    """The curved surface that a mesh of facets stands for, where its distance field is exact."""

    facets: Triangles
    field: Field
    area: float
    """Exact [m²]."""

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """n points (n, 3) [m] and normals (n, 3) on the exact surface."""
        points, _ = self.facets.draw(n, rng)
        values = self.field.evaluate(points)
        return points - values.distance[:, None] * values.gradient, values.gradient


def spread(surface: Surface, n: int, seed: int = 0) -> tuple[Array, Array]:
    """n points (n, 3) [m] with normals (n, 3), evenly apart and each for about the same area.

    The farthest of many draws, one after another, then Lloyd's steps, in which each point moves to the middle
    of those it stands for. Normals count too, so that the two sides of a thin wall are kept apart.
    """
    points, normals = surface.draw(CROWD * n, np.random.default_rng(seed))
    spacing = np.sqrt(surface.area / n)
    features = np.hstack([points, spacing * normals])
    from handsight._kernels.spreading import snapped, spread_out  # numba's import is long

    # Back to draws, each once: a middle lies off a curved surface.
    index = snapped(features, spread_out(features, n, LLOYD_STEPS))
    return points[index], normals[index]
