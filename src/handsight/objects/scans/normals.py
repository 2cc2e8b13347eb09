"""Normals of points that have none."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices
from handsight.objects.meshes.repair import agreeing, components


class NormalOptions(NamedTuple):
    """`NormalOptions` say how normals are computed from a scan's points."""

    neighbours: int = 12  # points through which a plane is laid, and among which normals are made to agree
    max_neighbours: int = 60  # the same where noise is large
    min_width: float = 6.0  # deviations of noise that a plane must be wide to have a direction


NORMALS = NormalOptions()


def estimated_normals(points: Array, tree: cKDTree) -> Array:
    """Returns unit outward normals (n, 3) of surface points (n, 3) [m]: of the plane through each one's neighbours."""
    nearest = tree.query(points, k=min(NORMALS.neighbours, len(points)))[1]
    return outwards(points, _plane_normals(points[nearest]), tree)


def planes(points: Array, places: Array, count: int) -> Array:
    """Returns unit normals (k, 3) of either sign: of the planes through about `count` points around the places (k, 3).

    `points` (n, 3) [m] are in a random order. Where `count` is large, so many fewer of them are used, in an area as
    large.
    """
    share = len(points) * NORMALS.max_neighbours // max(count, NORMALS.max_neighbours)
    thinned = points[: max(share, NORMALS.neighbours)]
    nearest = cKDTree(thinned).query(places, k=min(count, NORMALS.max_neighbours, len(thinned)))[1]
    return _plane_normals(thinned[nearest])


def enough_neighbours(sigma: float, spacing: float, least: int = NORMALS.neighbours) -> int:
    """Returns how many points a plane needs where these are off by `sigma` and `spacing` apart [m]."""
    return int(max(np.pi * (NORMALS.min_width * sigma / spacing) ** 2, least))


def _plane_normals(points: Array) -> Array:
    """Returns (n, 3) unit normals of the planes through points (n, k, 3)."""
    points = points - points.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("nki,nkj->nij", points, points))[1][:, :, 0])


def outwards(points: Array, normals: Array, tree: cKDTree, *, turning: bool = False) -> Array:
    """Returns unit normals (n, 3), each of which may have the wrong sign, with the signs that point outwards.

    They are made to agree along the tree of neighbours whose planes differ least (Hoppe et al. 1992); then each
    connected part is turned so that its normals point away from its middle on the whole. `turning`: the points are so
    exact that the way from one to the next shows how the surface turns between them, and normals are compared but for
    that turn.
    """
    normals = normals.copy()

    def likeness(i: Indices, j: Indices) -> Array:
        """Returns how well the normals of pairs of points (m,) agree: 1 for the same plane, -1 for opposite signs."""
        cosine = (normals[i] * normals[j]).sum(axis=1)
        if not turning:
            return np.asarray(cosine)
        # Of one normal and the other's mirror image halfway between them: 1 on any circle, and across an edge.
        way = points[j] - points[i]
        product = (way * normals[i]).sum(axis=1) * (way * normals[j]).sum(axis=1)
        return np.asarray(cosine - 2 * product / np.maximum((way * way).sum(axis=1), 1e-300))

    neighbours = tree.query(points, k=min(NORMALS.neighbours, len(points)))[1]
    row = np.repeat(np.arange(len(points)), neighbours.shape[1] - 1)
    column = neighbours[:, 1:].reshape(-1)
    cost = 1.0 - np.abs(likeness(row, column)) + 1e-6
    # SciPy before 1.17 does not convert indices to the type that the tree's compiled code needs.
    places = row.astype(np.int32), column.astype(np.int32)
    graph = coo_array((cost, places), shape=(len(points), len(points)))
    i, j = minimum_spanning_tree(graph.tocsr()).nonzero()
    turned, _ = agreeing(i, j, likeness(i, j) >= 0, len(points))
    normals[turned] *= -1
    part = components(row, column, len(points))
    for k in range(part.max() + 1):
        own = part == k
        if ((points[own] - points[own].mean(axis=0)) * normals[own]).sum() < 0:
            normals[own] *= -1
    return normals
