"""The nearest point of a triangle mesh, for many points at once."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.objects.meshes.box_tree import Halves, boxes, halves
from handsight.objects.meshes.triangles import Faces, Triangles


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
    """Finds the nearest points of a mesh, exactly, by a tree of boxes around its triangles."""

    def __init__(self, mesh: Triangles, parts: Halves | None = None) -> None:
        """Of a mesh with at least one triangle; `parts` of it, where they are known already, have a frame each."""
        corners = mesh.vertices[mesh.faces]
        parts = parts or halves(corners.mean(axis=1))
        self._order = parts.order
        corners, starts = corners[parts.order], parts.starts
        boxed = boxes(corners.min(axis=1), corners.max(axis=1), starts)
        frames = _frames(np.add.reduceat(mesh.doubled_normals[parts.order], starts[:-1]))
        turned = corners @ np.repeat(frames, np.diff(starts), axis=0).swapaxes(1, 2)
        around = np.hstack([turned.min(axis=1), turned.max(axis=1)])
        self._tree = starts, boxed, frames.reshape(-1, 9), turned, around

    def feet(self, points: Array, within: float = np.inf) -> tuple[Feet, Faces]:
        """The nearest surface points of those points (n, 3) nearer than `within` [m], and which these are.

        Of several triangles that are equally near, any. Quickest where neighbours in space follow each other.
        """
        from handsight._kernels.nearest_triangle import all_feet  # numba's import is long

        found = all_feet(np.require(points, np.float64, ["C", "W"]), within, self._tree)
        index = np.flatnonzero(np.isfinite(found[:, 0]))
        found = found[index]
        face = self._order[found[:, 7].astype(np.int64)]
        return Feet(found[:, 0], found[:, 1:4], face, found[:, 4:7]), index


def _frames(normals: Array) -> Array:
    """(p, 3, 3) rotations whose third row is along these (p, 3); any rotation where there is none."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    third = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    aside = np.eye(3)[np.abs(third).argmin(axis=1)]
    first = np.cross(aside, third)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=1)
