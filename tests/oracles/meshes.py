"""What the kernels that build objects compute, in plain NumPy and SciPy: brute force, and the definitions."""

import itertools

import numpy as np

from handsight.checks import Array, Indices
from handsight.objects.kernels.winding import FAR_PATCH, FAR_TRIANGLE

_PAIRS = 2_000_000


def dot(a: Array, b: Array) -> Array:
    """Row by row; three times as fast as a sum along the last axis."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def closest_points(points: Array, triangles: Array) -> tuple[Array, Array, Indices, Array]:
    """Distances (n,) [m] of points (n, 3) to triangles (m, 3, 3), closest points (n, 3), triangle (n,), weights (n, 3).

    Of every point with every triangle.
    """
    n, m = len(points), len(triangles)
    weights = nearest_on_triangles(np.repeat(points, m, axis=0), np.tile(triangles, (n, 1, 1)))
    weights = weights.reshape(n, m, 3)
    closest = np.einsum("nmk,mki->nmi", weights, triangles)
    distance = np.linalg.norm(points[:, None] - closest, axis=2)
    best, row = distance.argmin(axis=1), np.arange(n)
    return distance[row, best], closest[row, best], best, weights[row, best]


def nearest_on_triangles(points: Array, triangles: Array) -> Array:
    """Barycentric coordinates (n, 3) of the point nearest to each point (n, 3) on its triangle (n, 3, 3).

    Exact zeros on edges and at vertices.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d1, d2, d3 = dot(ab, ab), dot(ab, ac), dot(ac, ac)
    e1, e2 = dot(ap, ab), dot(ap, ac)
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
        length2 = dot(along, along)
        t = dot(points - start, along) / np.where(length2 > 0, length2, 1.0)
        t = np.clip(t, 0.0, 1.0)
        gap = points - start - t[:, None] * along
        gap2 = dot(gap, gap)
        closer = gap2 < least
        least[closer] = gap2[closer]
        best[closer] = 0.0
        best[closer, i], best[closer, j] = 1 - t[closer], t[closer]
    return best


def winding(
    points: Array, patches: tuple[Indices, Array, Array, Array], elements: tuple[Array, Array, Array, Array]
) -> Array:
    """Winding numbers (n,) at the points (n, 3); patches and elements as the kernel takes them."""
    starts, middles, vectors, radii = patches
    sizes = np.diff(starts)
    way = middles - points[:, None]
    gap2 = (way * way).sum(axis=2)
    near = gap2 <= (FAR_PATCH * radii) ** 2
    far = np.where(near, np.inf, gap2)
    total = ((way * vectors).sum(axis=2) / (far * np.sqrt(far))).sum(axis=1)
    row, patch = np.nonzero(near)
    cuts = np.flatnonzero(np.diff(np.cumsum(sizes[patch]) // _PAIRS)) + 1
    for a, b in itertools.pairwise([0, *cuts.tolist(), len(row)]):
        if b > a:
            total += _near(points, row[a:b], patch[a:b], starts, elements)
    return np.asarray(total / (4 * np.pi))


def _near(
    points: Array, row: Indices, patch: Indices, starts: Indices, elements: tuple[Array, Array, Array, Array]
) -> Array:
    """Solid angles (n,) of the elements of near patches."""
    centers, vectors, reach, corners = elements
    sizes = np.diff(starts)[patch]
    first = np.cumsum(sizes) - sizes
    element = np.arange(sizes.sum()) - np.repeat(first - starts[patch], sizes)
    point = np.repeat(row, sizes)
    way = centers[element] - points[point]
    gap = np.sqrt(dot(way, way))
    angle = np.where(gap > 0, dot(vectors[element], way) / np.where(gap > 0, gap, 1.0) ** 3, 0.0)
    if len(corners):
        close = np.flatnonzero(gap < FAR_TRIANGLE * reach[element])
        angle[close] = solid_angles(corners[element[close]] - points[point[close], None])
    return np.asarray(np.bincount(point, angle, minlength=len(points)), dtype=np.float64)


def solid_angles(corners: Array) -> Array:
    """Signed solid angles (m,) of triangles (m, 3, 3) seen from the origin (Oosterom, Strackee 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.sqrt(dot(v, v)) for v in (a, b, c))
    volume = dot(a, np.cross(b, c))
    ab, bc, ca = (dot(u, v) for u, v in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb))
