"""The nearest point of a triangle mesh, for many points at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from handsight.checks import Array
from handsight.objects.surface import Faces, Triangles
from handsight.objects.topology import neighbours

LEAST_SAMPLES, MOST_SAMPLES = 4_000, 200_000
CANDIDATES = 3
WALK = 8
_CHUNK = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Where n points touch down on a mesh."""

    distance: Array
    """(n,) [m], not signed."""
    points: Array
    """(n, 3) nearest surface points [m]."""
    face: Faces
    """(n,)"""
    corners: Array
    """(n, 3) barycentric; an exact 0 where the foot is on the edge opposite that corner."""


class NearestPoint:
    """Finds nearest points by a tree of dense surface samples, then exactly on their triangles."""

    def __init__(self, mesh: Triangles, spacing: float) -> None:
        """Samples about `spacing` [m] apart, every triangle's middle among them."""
        n = int(np.clip(mesh.area / spacing**2, LEAST_SAMPLES, MOST_SAMPLES))
        drawn, face = mesh.draw_on_faces(n, np.random.default_rng(2))
        self._corners = mesh.vertices[mesh.faces]
        self._face = np.concatenate([face, np.arange(len(mesh.faces))])
        self._tree = cKDTree(np.vstack([drawn, self._corners.mean(axis=1)]))
        self._beside = neighbours(mesh.faces)

    def feet(self, points: Array, within: float = np.inf) -> tuple[Feet, Faces]:
        """The nearest surface points of those points (n, 3) within [m] of a sample, and which these are.

        From the triangles of the nearest samples over their neighbours, as long as that leads nearer. Where
        two sheets are closer to each other than the samples are, it may end on the wrong one: too far by a
        fraction of the spacing.
        """
        parts = [self._feet(points[k : k + _CHUNK], within) for k in range(0, max(len(points), 1), _CHUNK)]
        index = np.concatenate([_CHUNK * k + row for k, (_, row) in enumerate(parts)])
        columns = zip(*((p.distance, p.points, p.face, p.corners) for p, _ in parts), strict=True)
        return Feet(*(np.concatenate(c) for c in columns)), index

    def _feet(self, points: Array, within: float) -> tuple[Feet, Faces]:
        gap, sample = self._tree.query(points, k=CANDIDATES, distance_upper_bound=within)
        row = np.flatnonzero(np.isfinite(gap[:, 0]))
        points, gap, sample = points[row], gap[row], sample[row]
        n = len(row)
        best = Feet(np.full(n, np.inf), np.zeros((n, 3)), np.zeros(n, dtype=np.int64), np.zeros((n, 3)))
        faces = self._face[np.where(np.isfinite(gap), sample, sample[:, :1])]
        todo = np.arange(n)
        for _ in range(WALK):
            closer = self._improve(best, points, todo, faces)
            todo, faces = todo[closer], self._beside[best.face[todo[closer]]]
            if not len(todo):
                break
        return best, row

    def _improve(self, best: Feet, points: Array, rows: Faces, faces: Faces) -> NDArray[np.bool_]:
        """Replaces the feet of these rows where one of their triangles (r, c) is nearer; which it did."""
        improved = np.zeros(len(rows), dtype=bool)
        for k in range(faces.shape[1]):
            fresh = faces[:, k] != best.face[rows] if k else np.ones(len(rows), dtype=bool)
            at, row, face = np.flatnonzero(fresh), rows[fresh], faces[fresh, k]
            triangle = self._corners[face]
            corners = nearest_on_triangles(points[row], triangle)
            foot = (corners[:, None, :] @ triangle)[:, 0]
            distance = np.sqrt(_dot(points[row] - foot, points[row] - foot))
            closer = distance < best.distance[row]
            row = row[closer]
            best.distance[row], best.points[row] = distance[closer], foot[closer]
            best.face[row], best.corners[row] = face[closer], corners[closer]
            improved[at[closer]] = True
        return improved


def _dot(a: Array, b: Array) -> Array:
    """Row by row; three times as fast as a sum along the last axis."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def nearest_on_triangles(points: Array, triangles: Array) -> Array:
    """Barycentric coordinates (n, 3) of the point nearest to each point (n, 3) on its triangle (n, 3, 3).

    Exact zeros on edges and at vertices.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d1, d2, d3 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    e1, e2 = _dot(ap, ab), _dot(ap, ac)
    area2 = d1 * d3 - d2 * d2
    flat = area2 <= 1e-14 * d1 * d3
    safe = np.where(flat, 1.0, area2)
    v, w = (d3 * e1 - d2 * e2) / safe, (d1 * e2 - d2 * e1) / safe
    corners = np.stack([1 - v - w, v, w], axis=1)
    row = np.flatnonzero(flat | (corners.min(axis=1) <= 0))
    if len(row):
        corners[row] = _nearest_on_edges(points[row], triangles[row])
    return corners


def _nearest_on_edges(points: Array, triangles: Array) -> Array:
    """Barycentric coordinates (n, 3) of the nearest point on the triangles' edges."""
    n = len(points)
    least = np.full(n, np.inf)
    best = np.zeros((n, 3))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, along = triangles[:, i], triangles[:, j] - triangles[:, i]
        length2 = _dot(along, along)
        t = _dot(points - start, along) / np.where(length2 > 0, length2, 1.0)
        t = np.clip(t, 0.0, 1.0)
        gap = points - start - t[:, None] * along
        gap2 = _dot(gap, gap)
        closer = gap2 < least
        least[closer] = gap2[closer]
        best[closer] = 0.0
        best[closer, i], best[closer, j] = 1 - t[closer], t[closer]
    return best
