"""Surfaces, of triangles or of points: their areas, random points on them, and their size."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices
from handsight.errors import InvalidObject

MIN_SIZE = 1e-6  # a smaller one is refused [m]
MAX_SIZE = 1e6  # a larger one is refused [m]
MAX_HOLE = 0.25
"""A surface with a hole wider than this share of the diameter is open. Nearer to a hole than its width, inside and
outside are a guess; with a wider hole that would be most of the object.
"""


class ObjectWarning(UserWarning):
    """The warning that something about an object was repaired, or is unusual."""


class Edges(NamedTuple):
    """Edges of a mesh, and the triangles that have them."""

    vertices: Indices  # (e, 2) the two vertices of each edge, the smaller index first
    of_face: Indices  # (m, 3) the edges of each triangle: from its corner 0 to 1, 1 to 2 and 2 to 0
    counts: Indices  # (e,) how many triangles have each edge


@dataclass(frozen=True, eq=False)
class Triangles:
    """Surface of a triangle mesh."""

    vertices: Array  # (k, 3) [m]
    faces: Indices  # (m, 3) vertex indices, counterclockwise from outside

    @property
    def area(self) -> float:
        """Sum of the triangles' areas [m²]."""
        return float(self.areas.sum())

    @property
    def corners(self) -> Array:
        """(m, 3, 3) the corners of each triangle [m]."""
        return self.vertices[self.faces]

    @cached_property
    def doubled_normals(self) -> Array:
        """(m, 3) outward normals as long as twice each triangle's area [m²]."""
        a, b, c = self.corners.swapaxes(0, 1)
        return np.cross(b - a, c - a)

    @property
    def normals(self) -> Array:
        """(m, 3) unit outward normals; zeros of a triangle without area."""
        return unit(self.doubled_normals)

    @cached_property
    def areas(self) -> Array:
        """(m,) the area of each triangle [m²]."""
        return np.asarray(np.linalg.norm(self.doubled_normals, axis=1) / 2)

    @cached_property
    def edges(self) -> Edges:
        """The edges of the triangles, each once."""
        ordered = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        keys = ordered[:, 0] * (int(self.faces.max()) + 1) + ordered[:, 1]
        _, first, which, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
        return Edges(ordered[first], which.reshape(-1, 3), count)

    @property
    def shared(self) -> tuple[Indices, Indices]:
        """(s,) each: the two triangles of each edge that two have, as 3 * triangle + the side of the triangle."""
        edges = self.edges
        order = np.argsort(edges.of_face, axis=None, kind="stable")
        first = (np.cumsum(edges.counts) - edges.counts)[edges.counts == 2]
        return order[first], order[first + 1]

    @property
    def volume_centroid(self) -> Array:
        """(3,) the centroid of the enclosed volume [m]; raises InvalidObject where that volume is zero."""
        a, b, c = self.corners.swapaxes(0, 1)
        sixfold = np.einsum("ij,ij->i", a, np.cross(b, c))
        total = sixfold.sum()
        if not abs(total) > 1e-15:
            raise InvalidObject("object: expected a volume, got a surface without an inside")
        return np.asarray((sixfold[:, None] * (a + b + c)).sum(axis=0) / (4 * total))

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Returns n random points (n, 3) [m], uniform over the area, and the normals (n, 3) of their triangles."""
        return self.draw_on_faces(n, rng)[:2]

    def draw_on_faces(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, Indices]:
        """Returns points and normals as `draw` does, and the index (n,) of each point's triangle."""
        face = drawn_by_area(self.areas, n, rng)
        shares = rng.random((2, n, 1))
        u, v = np.where(shares.sum(axis=0) > 1, 1 - shares, shares)
        a, b, c = self.corners[face].swapaxes(0, 1)
        return a + u * (b - a) + v * (c - a), unit(self.doubled_normals[face]), face


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Surface given by points on it, with their normals and areas."""

    vertices: Array  # (n, 3) [m]
    normals: Array  # (n, 3) unit, outward
    areas: Array  # (n,) each point's share of the surface [m²]

    @property
    def faces(self) -> Indices:
        """(0, 3): a cloud has no triangles."""
        return np.empty((0, 3), dtype=np.int64)

    @property
    def area(self) -> float:
        """Sum of the points' areas [m²]."""
        return float(self.areas.sum())

    @property
    def spacing(self) -> float:
        """Typical distance between neighbours [m]."""
        return float(np.sqrt(np.median(self.areas)))

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Returns n of the points (n, 3) [m], drawn in proportion to their areas, and their normals (n, 3)."""
        index = drawn_by_area(self.areas, n, rng)
        return self.vertices[index], self.normals[index]


Surface = Triangles | Cloud


def unit(vectors: Array) -> Array:
    """Returns vectors (n, 3) scaled to length 1; zeros stay zeros."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(min=1e-300))


def drawn_by_area(areas: Array, n: int, rng: np.random.Generator) -> Indices:
    """Returns n random indices (n,) of parts, drawn in proportion to the `areas` (m,) of the parts."""
    # Stratified: one draw in each n-th of the area is as uniform as n independent draws, and more even.
    at = (np.arange(n) + rng.random(n)) / max(n, 1)
    return np.searchsorted(np.cumsum(areas) / areas.sum(), at).clip(max=len(areas) - 1)


def check_extent(points: Array, name: str) -> float:
    """Returns the largest extent [m] of points (n, 3) along an axis; raises InvalidObject for an impossible size."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(points, axis=0).max())
    if extent == 0:
        raise InvalidObject(f"{name}: expected an object with a size, got all points in one place")
    far = float(np.abs(points).max())
    if far > MAX_SIZE and extent <= MAX_SIZE:
        hint = "map coordinates? `handsight objects add --recentre` moves it there"
        raise InvalidObject(
            f"{name}: expected an object near the origin, got one {far:.4g} m from it ({hint})"
        )
    if not MIN_SIZE <= extent <= MAX_SIZE:
        raise InvalidObject(f"{name}: expected a size of {MIN_SIZE:g} to {MAX_SIZE:g} m, got {extent:.4g}")
    return extent


def distinct(points: Array, extent: float) -> tuple[Indices, Indices]:
    """Returns the indices (k,) of the points (n, 3) that repeat no earlier one, and each point's place (n,) in them.
    Points closer than 1e-9 of the `extent` [m] are repeats."""
    keys = np.round((points - points.min(axis=0)) / (1e-9 * extent)).astype(np.int64)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.sort(first), rank[which.reshape(-1)]


def diameter(points: Array) -> float:
    """Returns the largest distance between two of the points (n, 3) [m]."""
    if len(points) <= 512:  # SciPy takes half a second to load, which a box should not wait for
        x, y, z = points.T[:, :, None] - points.T[:, None, :]
        return float(np.sqrt((x * x + y * y + z * z).max()))
    from scipy.spatial.distance import cdist, pdist

    most = 2000  # points all of whose distances are computed
    for ways in se3.directions(50), se3.directions(1000):
        if len(points) <= most:
            break
        along = (points @ way for way in ways)
        ends = points[np.unique([end for x in along for end in (x.argmin(), x.argmax())])]
        lengths = cdist(ends, ends)
        length = float(lengths.max())
        pair = np.unravel_index(lengths.argmax(), lengths.shape)
        # Of a longer pair, each end is at least as far from any place as the length less what the other end can be.
        off = np.linalg.norm(points - ends[list(pair)].mean(axis=0), axis=1)
        points = points[off >= (1 - 1e-9) * length - off.max()]
    # More are left of a ball: the extremes along a thousand directions miss by less than a thousandth.
    return float(pdist(points).max()) if len(points) <= most else length
