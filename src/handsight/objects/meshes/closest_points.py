"""The closest point of a triangle mesh, for many points at once."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array, Indices
from handsight.objects.meshes.box_tree import BoxTree, box_tree
from handsight.objects.surface import Triangles


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints:
    """The points of a mesh closest to n points."""

    distance: Array
    """(n,) [m], not signed."""
    points: Array
    """(n, 3) on the surface [m]."""
    face: Indices
    """(n,)"""
    weights: Array
    """(n, 3) barycentric; an exact 0 where the closest point is on the edge opposite that corner."""


class ClosestPointSearch:
    """Finds the closest points of a mesh, exactly, by a tree of boxes around its triangles."""

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
        """The closest surface points of those points (n, 3) nearer than `within` [m], and which these are.

        Of several triangles that are equally near, any. Quickest where neighbours in space follow each other.
        """
        from handsight._kernels.nearest_triangle import closest_points  # numba's import is long

        found = closest_points(np.require(points, np.float64, ["C", "W"]), within, self._tree)
        index = np.flatnonzero(np.isfinite(found[:, 0]))
        found = found[index]
        face = self._order[found[:, 7].astype(np.int64)]
        return ClosestPoints(found[:, 0], found[:, 1:4], face, found[:, 4:7]), index


def _frames(normals: Array) -> Array:
    """(p, 3, 3) rotations whose third row is along these (p, 3); any rotation where there is none."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    third = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    aside = np.eye(3)[np.abs(third).argmin(axis=1)]
    first = np.cross(aside, third)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=1)
