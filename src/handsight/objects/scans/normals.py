"""Normals of surface points, estimated from their neighbours and turned outwards."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices
from handsight.objects.pieces import agreeing, components

PLANE_NEIGHBOURS = 12  # nearest points to which a plane is fitted, and whose normals are made to agree
SIGN_NEIGHBOURS = 7  # nearest points whose normals are compared, itself among them
RANDOM_SIGNS = (
    0.25  # share of opposite normals among neighbours from which on signs mean nothing; it is 0.5 for random
)
INWARD = (
    0.1  # how far normals point to the middle in the mean, in parts of the size, where they point inwards
)
PLANE_MAX_NEIGHBOURS = 60  # points to which a plane is fitted where the noise is large


def planes(points: Array, places: Array, count: int) -> Array:
    """Returns unit normals (k, 3), of either sign, of planes through about `count` points around the places (k, 3).

    `points` (n, 3) [m] are in a random order. Where `count` is large they are thinned: fewer points on the same area.
    """
    share = len(points) * PLANE_MAX_NEIGHBOURS // max(count, PLANE_MAX_NEIGHBOURS)
    thinned = points[: max(share, PLANE_NEIGHBOURS)]
    nearest = cKDTree(thinned).query(places, k=min(count, PLANE_MAX_NEIGHBOURS, len(thinned)))[1]
    around = thinned[nearest] - thinned[nearest].mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]


def enough_neighbours(sigma: float, spacing: float, least: int = PLANE_NEIGHBOURS) -> int:
    """Returns how many points a plane needs where these have errors of `sigma` [m] and are `spacing` [m] apart."""
    # For a normal a plane needs a radius of six standard deviations of the noise.
    return int(max(np.pi * (6 * sigma / spacing) ** 2, least))


def with_outward_signs(points: Array, normals: Array) -> tuple[Array, str]:
    """Returns normals (n, 3) of points (n, 3) as a file has them, with signs that agree and point outwards, and a
    remark where that changed any.

    The surface's volume is a third of the sum of point times normal: negative where normals point inwards.
    """
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    tree = cKDTree(points)
    neighbours = tree.query(points, k=min(SIGN_NEIGHBOURS, len(points)))[1][:, 1:]
    opposite = np.einsum("nki,ni->nk", unit[neighbours], unit) < -0.5
    if opposite.mean() > RANDOM_SIGNS:
        oriented = outwards(points, unit, tree, turning=True)
        return oriented, "normals of neighbours have opposite signs: they were oriented anew"
    away = points - points.mean(axis=0)
    size = np.linalg.norm(away, axis=1).mean()
    if (away * unit).sum(axis=1).mean() < -INWARD * size:
        return -unit, "normals point inwards: they were turned"
    return normals, ""


def outwards(points: Array, normals: Array, tree: cKDTree, *, turning: bool = False) -> Array:
    """Returns unit normals (n, 3) of points (n, 3), each of which may have the wrong sign, turned outwards.

    They are made to agree along the spanning tree of neighbours whose planes differ least (Hoppe et al. 1992); then
    each connected part is turned so that on average its normals point away from its middle. `tree`: over the points.
    `turning`: the points are so exact that the direction from one to the next shows how the surface turns between them,
    and normals are compared after that turn.
    """
    normals = normals.copy()

    def likeness(i: Indices, j: Indices) -> Array:
        """Returns how well the normals of pairs of points (m,) agree: 1 for the same plane, -1 for opposite signs."""
        cosine = (normals[i] * normals[j]).sum(axis=1)
        if not turning:
            return np.asarray(cosine)
        # The cosine of one normal and the mirror image of the other halfway between: 1 on a circle and across an edge.
        way = points[j] - points[i]
        product = (way * normals[i]).sum(axis=1) * (way * normals[j]).sum(axis=1)
        return np.asarray(cosine - 2 * product / np.maximum((way * way).sum(axis=1), 1e-300))

    neighbours = tree.query(points, k=min(PLANE_NEIGHBOURS, len(points)))[1]
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
