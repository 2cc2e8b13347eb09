"""A tree of boxes around triangles or points, and closest points and winding numbers computed with it.

The tree is complete and binary, with one level of boxes after another: the children of box k are 2k + 1 and 2k + 2. The
items of a box are halved across its longest side, so the numbers of items in the leaves differ by one at most.
"""

from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices, Mask
from handsight.objects.surface import Triangles, unit


@dataclass(frozen=True, slots=True, eq=False)
class BoxTree:
    """Order of items in which neighbours in space follow each other, divided into leaves."""

    order: Indices
    """(n,) indices of the items in that order."""
    starts: Indices
    """(leaves + 1,) the place in the order where each leaf begins, and n; the number of leaves is a power of two."""

    def boxes(self, low: Array, high: Array) -> Array:
        """Returns (2 leaves - 1, 6): the least and the greatest corner of every box, the root first.

        `low`, `high` (n, 3): corners of the items' boxes, in the tree's order; no leaf may be empty.
        """
        first = self.starts[:-1]
        level = np.hstack([np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)])
        levels = [level]
        while len(level) > 1:
            pair = level.reshape(-1, 2, 6)
            level = np.hstack([pair[:, :, :3].min(axis=1), pair[:, :, 3:].max(axis=1)])
            levels.append(level)
        return np.concatenate(levels[::-1])


def box_tree(centers: Array) -> BoxTree:
    """Returns a tree over items at `centers` (n, 3), halved until no leaf has more than 16 items."""
    n = len(centers)
    order = np.arange(n)
    starts = np.array([0, n])
    while np.diff(starts).max() > 16:
        x = centers[order]
        low = np.minimum.reduceat(x, starts[:-1])
        high = np.maximum.reduceat(x, starts[:-1])
        leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        axis = (high - low).argmax(axis=1)
        span = (high - low).max(axis=1)
        along = x[np.arange(n), axis[leaf]] - low[np.arange(len(low)), axis][leaf]
        # The integer part is the leaf, the fraction the place within it: one sort for all leaves.
        key = leaf + 0.999 * along / np.where(span > 0, span, 1.0)[leaf]
        order = order[np.argsort(key)]
        middles = (starts[:-1] + starts[1:]) // 2
        starts = np.append(np.stack([starts[:-1], middles], axis=1).reshape(-1), n)
    return BoxTree(order, starts)


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """Points of a mesh closest to n given points."""

    distance: Array
    """(n,) distances from the given points [m], not signed."""
    points: Array
    """(n, 3) on the surface [m]."""
    face: Indices
    """(n,) index of the triangle that each is on."""
    weights: Array
    """(n, 3) barycentric; an exact 0 where the closest point is on the edge opposite that corner."""


class ClosestPointSearch:
    """Finds the closest points of a mesh, exactly, by a tree of boxes around its triangles."""

    def __init__(self, mesh: Triangles, tree: BoxTree | None = None) -> None:
        """Builds the search for a mesh of at least one triangle; `tree`: over its triangles, if it was built before."""
        tree = tree or box_tree(mesh.corners.mean(axis=1))
        self._order = tree.order
        corners = mesh.corners[tree.order]
        boxes = tree.boxes(corners.min(axis=1), corners.max(axis=1))
        # Each leaf has a second box, whose z axis is along the mean of the leaf's normals.
        normals = np.add.reduceat(mesh.doubled_normals[tree.order], tree.starts[:-1])
        normals[~normals.any(axis=1), 2] = 1.0  # of a closed leaf
        third = unit(normals)
        first = se3.perpendicular(third)
        frames = np.stack([first, np.cross(third, first), third], axis=1)
        turned = corners @ np.repeat(frames, np.diff(tree.starts), axis=0).swapaxes(1, 2)
        around = np.hstack([turned.min(axis=1), turned.max(axis=1)])
        self._tree = tree.starts, boxes, frames, turned, around

    def closest(self, points: Array, within: float = np.inf) -> tuple[ClosestPoints, Indices]:
        """Returns the closest surface points of those points (n, 3) that are nearer than `within` [m], and the indices
        of these.

        Of equally near triangles any one is returned. The search is fastest if neighbours in space follow each other.
        """
        from handsight._compiled.threads import in_parts
        from handsight.objects.kernels.nearest_triangle import RESULT, closest  # numba's import is long

        places = np.require(points, np.float64, ["C", "W"])
        found = np.zeros((len(points), RESULT))
        in_parts(lambda some, there: closest(some, within, self._tree, there), (places, found), 1000)
        index = np.flatnonzero(np.isfinite(found[:, 0]))
        found = found[index]
        face = self._order[found[:, 7].astype(np.int64)]
        return ClosestPoints(found[:, 0], found[:, 1:4], face, found[:, 4:7]), index


class Winding:
    """Winding number of a triangle mesh or an oriented cloud around a point.

    It is 1 inside, 0 outside, and in between near holes. The method is that of Barill, Dickson, Schmidt, Levin and
    Jacobson 2018, "Fast winding numbers for soups and clouds": a patch that is far away counts as one dipole, its area
    vector at its centre; in a patch that is near, every triangle counts with its solid angle.
    """

    def __init__(
        self, centers: Array, area_vectors: Array, corners: Array | None = None, tree: BoxTree | None = None
    ) -> None:
        """Builds the patches of a surface from `centers` (m, 3) [m] and outward `area_vectors` (m, 3) [m²].

        `corners` (m, 3, 3): of the triangles [m]; None for points. `tree`: over the centers, if it was built before;
        its leaves are the patches.
        """
        tree = tree or box_tree(centers)
        starts = tree.starts
        while len(starts) > 4001:  # leaves are joined until there are at most 4000 patches
            starts = starts[::2]
        first = starts[:-1]
        sizes = np.diff(starts)
        centers = centers[tree.order]
        vectors = area_vectors[tree.order]
        weight = np.linalg.norm(vectors, axis=1) + 1e-300
        total = np.add.reduceat(weight, first)
        middles = np.add.reduceat(centers * weight[:, None], first) / total[:, None]
        spread = np.linalg.norm(centers - np.repeat(middles, sizes, axis=0), axis=1)
        if corners is None:
            corners = np.empty((0, 3, 3))
            reach = np.zeros(len(centers))
        else:
            corners = corners[tree.order]
            reach = np.max([np.linalg.norm(corners[:, k] - centers, axis=1) for k in range(3)], axis=0)
        radii = np.maximum.reduceat(spread + reach, first)
        self.patches = starts, middles, np.add.reduceat(vectors, first), radii
        self.elements = centers, vectors, reach, corners

    @classmethod
    def of_mesh(cls, mesh: Triangles, tree: BoxTree | None = None) -> "Winding":
        """Returns the winding number of a mesh; `tree`: over its triangles, if it was built before."""
        return cls(mesh.corners.mean(axis=1), mesh.doubled_normals / 2, mesh.corners, tree)

    def at(self, points: Array) -> Array:
        """Returns winding numbers (n,) at the points (n, 3) [m]."""
        from handsight._compiled.threads import in_parts
        from handsight.objects.kernels.winding import winding  # numba's import is long

        places = np.require(points, np.float64, ["C", "W"])
        found = np.zeros(len(points))
        surface = self.patches, self.elements
        in_parts(lambda some, there: winding(some, *surface, there), (places, found), 200)
        return found

    def inside(self, points: Array) -> Mask:
        """Returns (n,) whether the winding numbers at the points (n, 3) [m] are above one half."""
        return self.at(points) > 0.5
