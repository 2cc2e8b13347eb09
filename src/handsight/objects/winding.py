"""How often a surface winds around a point: 1 inside, 0 outside, in between near holes.

Barill, Dickson, Schmidt, Levin and Jacobson 2018, "Fast winding numbers for soups and clouds": far away a
patch acts as one dipole, its area vector at its centre; near by every triangle counts with its solid angle.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.objects.surface import Triangles

PATCH = 16
MOST_PATCHES = 2000
FAR_PATCH = 2.0
"""A patch is one dipole beyond this many of its radii."""
FAR_TRIANGLE = 4.0
_PAIRS = 2_000_000
_POINTS = 2048


class Winding:
    """The winding number of a triangle mesh or of an oriented cloud, at any points."""

    def __init__(self, centers: Array, area_vectors: Array, corners: Array | None = None) -> None:
        """`centers` (m, 3) [m], `area_vectors` (m, 3) outward [m²]; `corners` (m, 3, 3) of triangles."""
        order, self._starts = _patches(centers)
        self._centers, self._vectors = centers[order], area_vectors[order]
        self._corners = None if corners is None else corners[order]
        self._sizes = np.diff(np.append(self._starts, len(centers)))
        weight = np.linalg.norm(self._vectors, axis=1) + 1e-300
        total = np.add.reduceat(weight, self._starts)
        middle = np.add.reduceat(self._centers * weight[:, None], self._starts) / total[:, None]
        self._patch_vectors = np.add.reduceat(self._vectors, self._starts)
        self._middle = middle
        spread = self._centers - np.repeat(middle, self._sizes, axis=0)
        if self._corners is None:
            self._reach = np.zeros(len(centers))
        else:
            self._reach = np.linalg.norm(self._corners - self._centers[:, None], axis=2).max(axis=1)
        self._radius = np.maximum.reduceat(np.linalg.norm(spread, axis=1) + self._reach, self._starts)

    @classmethod
    def of_mesh(cls, mesh: Triangles) -> "Winding":
        """The winding number of a mesh."""
        corners = mesh.vertices[mesh.faces]
        return cls(corners.mean(axis=1), mesh.doubled_normals() / 2, corners)

    def at(self, points: Array) -> Array:
        """Winding numbers (n,) at the points (n, 3) [m]."""
        step = max(1, min(_POINTS, _PAIRS // len(self._starts)))
        parts = [self._at(points[k : k + step]) for k in range(0, len(points), step)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _at(self, points: Array) -> Array:
        # |c - q|² and a·(c - q) for all pairs by matrix products, about the middle so that little cancels.
        origin = self._middle.mean(axis=0)
        q, c = points - origin, self._middle - origin
        gap2 = (q * q).sum(axis=1)[:, None] - 2 * (q @ c.T) + (c * c).sum(axis=1)
        near = gap2 <= (FAR_PATCH * self._radius) ** 2 + 1e-12 * gap2.max()
        along = _dot(self._patch_vectors, c) - q @ self._patch_vectors.T
        far = np.where(near, np.inf, gap2)
        total = (along / (far * np.sqrt(far))).sum(axis=1)
        row, patch = np.nonzero(near)
        sizes = self._sizes[patch]
        for k in _slices(sizes):
            total += self._near(points, row[k], patch[k])
        return np.asarray(total / (4 * np.pi))

    def _near(self, points: Array, row: NDArray[np.int64], patch: NDArray[np.int64]) -> Array:
        """Solid angles (n,) of the elements of near patches."""
        sizes = self._sizes[patch]
        first = np.cumsum(sizes) - sizes
        element = np.arange(sizes.sum()) - np.repeat(first - self._starts[patch], sizes)
        point = np.repeat(row, sizes)
        way = self._centers[element] - points[point]
        gap = np.sqrt(_dot(way, way))
        angle = _dot(self._vectors[element], way) / np.maximum(gap, 1e-300) ** 3
        angle[gap == 0] = 0.0
        if self._corners is not None:
            close = np.flatnonzero(gap < FAR_TRIANGLE * self._reach[element])
            angle[close] = _solid_angles(self._corners[element[close]] - points[point[close], None])
        return np.asarray(np.bincount(point, angle, minlength=len(points)), dtype=np.float64)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _slices(sizes: NDArray[np.int64]) -> list[slice]:
    """Runs of patches with about as many elements as fit in memory at once."""
    cuts = np.flatnonzero(np.diff(np.cumsum(sizes) // _PAIRS)) + 1
    edges = [0, *cuts.tolist(), len(sizes)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]


def _solid_angles(corners: Array) -> Array:
    """Signed solid angles (m,) of triangles (m, 3, 3) seen from the origin (Oosterom, Strackee 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.sqrt(_dot(v, v)) for v in (a, b, c))
    volume = _dot(a, np.cross(b, c))
    ab, bc, ca = (_dot(u, v) for u, v in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb))


def _patches(centers: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """An order of the elements in which neighbours follow each other, and where each patch starts in it."""
    most = max(PATCH, len(centers) // MOST_PATCHES)
    todo, done = [np.arange(len(centers))], []
    while todo:
        part = todo.pop()
        if len(part) <= most:
            done.append(part)
            continue
        x = centers[part]
        axis = np.ptp(x, axis=0).argmax()
        half = len(part) // 2
        split = np.argpartition(x[:, axis], half)
        todo += [part[split[:half]], part[split[half:]]]
    sizes = np.array([len(part) for part in done])
    return np.concatenate(done), np.cumsum(sizes) - sizes
