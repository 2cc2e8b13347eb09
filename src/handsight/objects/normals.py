"""Normals of surface points that came without."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from handsight.checks import Array
from handsight.objects.meshes.triangles import Faces

LEAST_POINTS = 20
NEIGHBOURS = 12


def estimated_normals(points: Array, tree: cKDTree) -> Array:
    """Unit outward normals (n, 3) of surface points (n, 3) [m].

    Of the plane through each point's neighbours; made to agree along the tree of neighbours whose planes
    differ least (Hoppe et al. 1992); then turned, each connected part, so that they point away from it on
    the whole.
    """
    neighbours = tree.query(points, k=min(NEIGHBOURS, len(points)))[1]
    patch = points[neighbours]
    patch = patch - patch.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch))[1][:, :, 0]
    row = np.repeat(np.arange(len(points)), neighbours.shape[1] - 1)
    column = neighbours[:, 1:].reshape(-1)
    cost = 1.0 - np.abs((normals[row] * normals[column]).sum(axis=1)) + 1e-6
    graph = coo_array((cost, (row, column)), shape=(len(points), len(points)))
    count, part = connected_components(graph, directed=False)
    agreed = _agreed(normals, minimum_spanning_tree(graph.tocsr()), part, count)
    for k in range(count):
        own = part == k
        if _outward(points[own], agreed[own]) < 0:
            agreed[own] *= -1
    return agreed


def _agreed(normals: Array, forest: object, part: Faces, count: int) -> Array:
    """The normals, each turned to agree with the one before it along the forest."""
    normals = normals.copy()
    for k in range(count):
        start = int(np.argmax(part == k))
        order, before = breadth_first_order(forest, start, directed=False)
        sign = np.ones(len(normals))
        same = (normals[order[1:]] * normals[before[order[1:]]]).sum(axis=1) >= 0
        for i, j, agrees in zip(order[1:].tolist(), before[order[1:]].tolist(), same.tolist(), strict=True):
            sign[i] = sign[j] if agrees else -sign[j]
        normals[order] *= sign[order, None]
    return normals


def _outward(points: Array, normals: Array) -> float:
    """Above 0 where the normals point away from the points' middle more than towards it."""
    return float(((points - points.mean(axis=0)) * normals).sum())
