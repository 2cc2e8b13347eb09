"""A tree of boxes around things in space, and what it answers of a mesh: closest points and winding numbers.

The tree is complete and binary, each level's boxes one after another: the children of box k are 2k + 1 and 2k + 2. Each
box's things are halved across its longest side, so the last row's boxes, the leaves, differ by one thing at most.
"""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array, Indices, Mask
from handsight.objects.surface import Triangles

LEAF = 16
"""Things in a leaf, at most."""
MOST_PATCHES = 4000
"""Of a winding number: leaves are taken together until there are no more."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxTree:
    """A `BoxTree` is things in an order in which neighbours follow each other, cut into leaves."""

    order: Indices
    """(n,) index of each thing."""
    starts: Indices
    """(leaves + 1,) where each leaf begins, and the end; a power of two of leaves."""

    def boxes(self, low: Array, high: Array) -> Array:
        """(2 leaves - 1, 6) every box's least and greatest corner, the whole first.

        `low`, `high` (n, 3): of the things, in the tree's order; no leaf may be empty.
        """
        first = self.starts[:-1]
        level = np.hstack([np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)])
        levels = [level]
        while len(level) > 1:
            pair = level.reshape(-1, 2, 6)
            level = np.hstack([pair[:, :, :3].min(axis=1), pair[:, :, 3:].max(axis=1)])
            levels.append(level)
        return np.concatenate(levels[::-1])


def box_tree(centers: Array, most: int = LEAF) -> BoxTree:
    """Returns things at `centers` (n, 3) halved again and again until no leaf has more than `most`."""
    n = len(centers)
    order = np.arange(n)
    starts = np.array([0, n])
    while np.diff(starts).max() > most:
        x = centers[order]
        low, high = np.minimum.reduceat(x, starts[:-1]), np.maximum.reduceat(x, starts[:-1])
        leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        axis, span = (high - low).argmax(axis=1), (high - low).max(axis=1)
        along = x[np.arange(n), axis[leaf]] - low[np.arange(len(low)), axis][leaf]
        # The leaf before the point, place within it behind: one sort for all leaves.
        key = leaf + 0.999 * along / np.where(span > 0, span, 1.0)[leaf]
        order = order[np.argsort(key)]
        middles = (starts[:-1] + starts[1:]) // 2
        starts = np.append(np.stack([starts[:-1], middles], axis=1).reshape(-1), n)
    return BoxTree(order, starts)


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """`ClosestPoints` are the points of a mesh closest to n points."""

    distance: Array
    """(n,) [m], not signed."""
    points: Array
    """(n, 3) on the surface [m]."""
    face: Indices
    """(n,)"""
    weights: Array
    """(n, 3) barycentric; an exact 0 where the closest point is on the edge opposite that corner."""


class ClosestPointSearch:
    """A `ClosestPointSearch` finds the closest points of a mesh, exactly, by a tree of boxes around its triangles."""

    def __init__(self, mesh: Triangles, tree: BoxTree | None = None) -> None:
        """Of a mesh with at least one triangle; `tree` over it, where it is known already."""
        tree = tree or box_tree(mesh.corners.mean(axis=1))
        self._order = tree.order
        corners = mesh.corners[tree.order]
        boxes = tree.boxes(corners.min(axis=1), corners.max(axis=1))
        frames = _frames(np.add.reduceat(mesh.doubled_normals[tree.order], tree.starts[:-1]))
        turned = corners @ np.repeat(frames, np.diff(tree.starts), axis=0).swapaxes(1, 2)
        around = np.hstack([turned.min(axis=1), turned.max(axis=1)])
        self._tree = tree.starts, boxes, frames, turned, around

    def closest(self, points: Array, within: float = np.inf) -> tuple[ClosestPoints, Indices]:
        """Returns the closest surface points of those points (n, 3) nearer than `within` [m], and which these are.

        Of several triangles that are equally near, any. Quickest where neighbours in space follow each other.
        """
        from handsight._kernels.mesh.nearest_triangle import closest_points  # numba's import is long

        found = closest_points(np.require(points, np.float64, ["C", "W"]), within, self._tree)
        index = np.flatnonzero(np.isfinite(found[:, 0]))
        found = found[index]
        face = self._order[found[:, 7].astype(np.int64)]
        return ClosestPoints(found[:, 0], found[:, 1:4], face, found[:, 4:7]), index


def _frames(normals: Array) -> Array:
    """Returns (p, 3, 3) rotations whose third row is along these (p, 3); any rotation where there is none."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    third = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    lateral = np.eye(3)[np.abs(third).argmin(axis=1)]
    first = np.cross(lateral, third)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=1)


class Winding:
    """A `Winding` says how often a triangle mesh or an oriented cloud winds around a point: 1 inside, 0 outside,
    between near holes.

    Barill, Dickson, Schmidt, Levin and Jacobson 2018, "Fast winding numbers for soups and clouds": far away a
    patch acts as one dipole, its area vector at its centre; near by every triangle counts with its solid angle.
    """

    def __init__(
        self, centers: Array, area_vectors: Array, corners: Array | None = None, tree: BoxTree | None = None
    ) -> None:
        """`centers` (m, 3) [m], `area_vectors` (m, 3) outward [m²]; `corners` (m, 3, 3) of triangles.

        `tree`: its leaves are the patches; where it is known already.
        """
        tree = tree or box_tree(centers)
        starts = tree.starts
        while len(starts) > MOST_PATCHES + 1:
            starts = starts[::2]
        first, sizes = starts[:-1], np.diff(starts)
        centers, vectors = centers[tree.order], area_vectors[tree.order]
        weight = np.linalg.norm(vectors, axis=1) + 1e-300
        total = np.add.reduceat(weight, first)
        middles = np.add.reduceat(centers * weight[:, None], first) / total[:, None]
        spread = np.linalg.norm(centers - np.repeat(middles, sizes, axis=0), axis=1)
        if corners is None:
            corners, reach = np.empty((0, 3, 3)), np.zeros(len(centers))
        else:
            corners = corners[tree.order]
            reach = np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
        radii = np.maximum.reduceat(spread + reach, first)
        self.patches = starts, middles, np.add.reduceat(vectors, first), radii
        self.elements = centers, vectors, reach, corners

    @classmethod
    def of_mesh(cls, mesh: Triangles, tree: BoxTree | None = None) -> "Winding":
        """Returns the winding number of a mesh."""
        return cls(mesh.corners.mean(axis=1), mesh.doubled_normals / 2, mesh.corners, tree)

    def at(self, points: Array) -> Array:
        """Returns winding numbers (n,) at the points (n, 3) [m]."""
        from handsight._kernels.mesh.winding import winding_at  # numba's import is long

        return np.asarray(winding_at(np.require(points, np.float64, ["C", "W"]), self.patches, self.elements))

    def inside(self, points: Array) -> Mask:
        """Returns (n,) whether the surface winds around the points (n, 3) [m] more than half a time."""
        return np.asarray(self.at(points) > 0.5)
