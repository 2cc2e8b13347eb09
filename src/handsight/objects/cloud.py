"""What is measured on a point cloud: its normals and its distance fields.

Near the points the distance is the smooth average of the planes through them (implicit moving least squares,
Kolluri 2008); far away it is that to the nearest point, negative where the cloud winds around. Outliers are
not removed: each point given is taken for surface.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

from handsight.checks import Array, Mask
from handsight.errors import InvalidObject
from handsight.objects.fields import Grid, grids, sharpened
from handsight.objects.geometry import Geometry, measured
from handsight.objects.meshes.box_tree import Winding
from handsight.objects.meshes.repair import agreeing, components
from handsight.objects.surface import LARGEST_HOLE, Cloud, check_extent, diameter, distinct

LEAST_POINTS = 20
NEIGHBOURS = 12
"""Points through which a plane is laid where normals are missing."""
PLANES = 10
"""Points whose planes are averaged."""
AREA_NEIGHBOURS = 8
NEAR, FAR = 2.0, 4.0
"""Spacings from a point between which the average of planes gives way to the distance to it."""


def cloud_geometry(points: Array, normals: Array | None) -> Geometry:
    """What is to be known of finite points (n, 3) [m] with unit outward normals or none; raises InvalidObject.

    Equal points are merged. Normals that were not given are estimated and made to point outwards.
    """
    points, normals, remarks = _distinct(points, normals)
    tree = cKDTree(points)
    if normals is None:
        normals = _estimated_normals(points, tree)
    reach = tree.query(points, k=AREA_NEIGHBOURS + 1)[0][:, -1]
    # A disc holds its neighbours and half the one on its rim.
    cloud = Cloud(points, normals, np.pi * reach**2 / (AREA_NEIGHBOURS + 0.5))
    size = diameter(points)
    coarse, fine, coarser = grids(points, size)
    winding = Winding(points, cloud.areas[:, None] * normals)
    nodes = coarse.nodes()
    hole = _largest_hole(coarse, tree.query(nodes)[0], winding.inside(nodes))
    closed = hole < LARGEST_HOLE * size and _winds(cloud, winding)
    side = winding if closed else None
    values = _distances(cloud, tree, nodes, side)
    sharp = sharpened(
        coarse, values, fine, lambda index, _: (index, _distances(cloud, tree, fine.nodes_at(index), side))
    )
    fields, remarks = (coarse.field(values), fine.field(sharp)), (*remarks, *coarser)
    return measured(cloud, *fields, diameter=size, closed=closed, remarks=remarks)


def _distinct(points: Array, normals: Array | None) -> tuple[Array, Array | None, tuple[str, ...]]:
    """The points and normals without repeats, and a remark where there were; raises InvalidObject."""
    if len(points) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} points, got {len(points)}")
    extent = check_extent(points, "points")
    first, _ = distinct(points, extent)
    if len(first) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} different points, got {len(first)}")
    repeated = len(points) - len(first)
    points, normals = points[first], None if normals is None else normals[first]
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * extent) < 2:
        raise InvalidObject("points: expected a surface, got points on one line")
    return points, normals, (f"{repeated} repeated points were dropped",) if repeated else ()


def _winds(cloud: Cloud, winding: Winding) -> bool:
    """Whether the cloud winds once around what is behind its points, and not around what is in front."""
    index = np.random.default_rng(3).permutation(len(cloud.vertices))[:400]
    # Nearer than two spacings single points are felt.
    step = 2 * cloud.spacing * cloud.normals[index]
    behind, front = winding.at(cloud.vertices[index] - step), winding.at(cloud.vertices[index] + step)
    return bool(((behind > 0.5) & (front < 0.5)).mean() > 0.9)


def _largest_hole(grid: Grid, gap: Array, inside: Mask) -> float:
    """The width [m] of the largest hole: where inside meets outside, twice the distance to the points."""
    largest = 0.0
    cube, sign = gap.reshape(grid.shape), inside.reshape(grid.shape)
    for axis, n in enumerate(grid.shape):
        nearer = np.minimum(cube.take(range(n - 1), axis), cube.take(range(1, n), axis))
        largest = max(largest, float(2 * nearer[np.diff(sign, axis=axis)].max(initial=0.0)))
    return largest


def _distances(cloud: Cloud, tree: cKDTree, nodes: Array, winding: Winding | None) -> Array:
    """Signed distances (n,) [m] of the nodes; without a winding number, by the nearest point's normal."""
    k = min(PLANES, len(cloud.vertices))
    gap, index = tree.query(nodes, k=k)
    near = gap[:, 0]
    # Wide enough for a few points, wherever they are.
    width2 = (near + cloud.spacing) ** 2
    weight = np.exp(-((gap**2 - near[:, None] ** 2) / width2[:, None]))
    # The far side of a thin wall has no say.
    agreement = np.einsum("nki,ni->nk", cloud.normals[index], cloud.normals[index[:, 0]])
    weight *= np.maximum(agreement, 0.0) + 1e-9
    height = np.einsum("nki,nki->nk", nodes[:, None] - cloud.vertices[index], cloud.normals[index])
    plane = (weight * height).sum(axis=1) / weight.sum(axis=1)
    share = np.clip((near / cloud.spacing - NEAR) / (FAR - NEAR), 0.0, 1.0)
    share = share * share * (3 - 2 * share)
    if winding is None:
        # From behind the negative distance meets the positive one around the rim without a jump.
        cosine = height[:, 0] / np.where(near > 0, near, 1.0)
        far = near * np.clip((cosine + 0.6) / 0.3, -1.0, 1.0)
    else:
        far = near.copy()
        away = np.flatnonzero(share > 0)
        far[away] *= np.where(winding.inside(nodes[away]), -1.0, 1.0)
    return np.asarray((1 - share) * plane + share * far)


def _estimated_normals(points: Array, tree: cKDTree) -> Array:
    """Unit outward normals (n, 3) of surface points (n, 3) [m].

    Of the plane through each point's neighbours; made to agree along the tree of neighbours whose planes
    differ least (Hoppe et al. 1992); then turned, each connected part, so that they point away from its
    middle on the whole.
    """
    neighbours = tree.query(points, k=min(NEIGHBOURS, len(points)))[1]
    patch = points[neighbours]
    patch = patch - patch.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch))[1][:, :, 0]
    row = np.repeat(np.arange(len(points)), neighbours.shape[1] - 1)
    column = neighbours[:, 1:].reshape(-1)
    cost = 1.0 - np.abs((normals[row] * normals[column]).sum(axis=1)) + 1e-6
    graph = coo_array((cost, (row, column)), shape=(len(points), len(points)))
    i, j = minimum_spanning_tree(graph.tocsr()).nonzero()
    turned, _ = agreeing(i, j, (normals[i] * normals[j]).sum(axis=1) >= 0, len(points))
    normals[turned] *= -1
    part = components(row, column, len(points))
    for k in range(part.max() + 1):
        own = part == k
        if ((points[own] - points[own].mean(axis=0)) * normals[own]).sum() < 0:
            normals[own] *= -1
    return normals
