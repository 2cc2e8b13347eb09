"""How often a surface winds around a point: 1 inside, 0 outside, in between near holes.

Barill, Dickson, Schmidt, Levin and Jacobson 2018, "Fast winding numbers for soups and clouds": far away a
patch acts as one dipole, its area vector at its centre; near by every triangle counts with its solid angle.
"""

import numpy as np

from handsight.checks import Array, Mask
from handsight.objects.meshes.box_tree import BoxTree, box_tree
from handsight.objects.surface import Triangles

MOST_PATCHES = 4000


class Winding:
    """The winding number of a triangle mesh or of an oriented cloud, at any points."""

    def __init__(
        self, centers: Array, area_vectors: Array, corners: Array | None = None, tree: BoxTree | None = None
    ) -> None:
        """`centers` (m, 3) [m], `area_vectors` (m, 3) outward [m²]; `corners` (m, 3, 3) of triangles.

        `tree`: its leaves are the patches; where it is known already.
        """
        tree = tree or box_tree(centers)
        starts = tree.merged(MOST_PATCHES)
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
        """The winding number of a mesh."""
        return cls(mesh.corners.mean(axis=1), mesh.doubled_normals / 2, mesh.corners, tree)

    def at(self, points: Array) -> Array:
        """Winding numbers (n,) at the points (n, 3) [m]."""
        from handsight._kernels.winding import winding_at  # numba's import is long

        return np.asarray(winding_at(np.require(points, np.float64, ["C", "W"]), self.patches, self.elements))

    def inside(self, points: Array) -> Mask:
        """(n,) whether the surface winds around the points (n, 3) [m] more than half a time."""
        return np.asarray(self.at(points) > 0.5)
