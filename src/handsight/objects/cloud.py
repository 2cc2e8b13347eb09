"""The surface and the distance fields of a point cloud.

Near the points the distance is the smooth average of the planes through them (implicit moving least squares,
Kolluri 2008); far away it is that to the nearest point, negative where the cloud winds around. Outliers are
not removed: each point given is taken for surface.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidObject
from handsight.objects.fields.grids import Fields, Grid, grids, interpolated
from handsight.objects.meshes.winding import Winding
from handsight.objects.surface import check_extent, diameter, distinct, drawn_by_area

LEAST_POINTS = 20
NEIGHBOURS = 12
"""Points through which a plane is laid where normals are missing."""
PLANES = 10
"""Points whose planes are averaged."""
AREA_NEIGHBOURS = 8
NEAR, FAR = 2.0, 4.0
"""Spacings from a point between which the average of planes gives way to the distance to it."""
BAND = 4
LARGEST_HOLE = 0.25
"""As for meshes: a cloud with a gap wider than this part of the diameter has no inside."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Oriented surface points."""

    vertices: Array
    """(n, 3) [m]."""
    normals: Array
    """(n, 3) unit, outward."""
    areas: Array
    """(n,) the surface each stands for [m²]."""

    @property
    def faces(self) -> Indices:
        """(0, 3): a cloud has none."""
        return np.empty((0, 3), dtype=np.int64)

    @property
    def area(self) -> float:
        """Of all [m²]."""
        return float(self.areas.sum())

    @property
    def spacing(self) -> float:
        """About how far neighbours are apart [m]."""
        return float(np.sqrt(np.median(self.areas)))

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """n of the points (n, 3) [m] and their normals (n, 3), more often where they are sparse."""
        index = drawn_by_area(self.areas, n, rng)
        return self.vertices[index], self.normals[index]


def cloud_from(points: Array, normals: Array | None) -> tuple[Cloud, tuple[str, ...]]:
    """The cloud of finite points (n, 3) [m] with unit normals or none, and remarks; raises InvalidObject.

    Equal points are merged. Normals that were not given are estimated and made to point outwards.
    """
    remarks: list[str] = []
    if len(points) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} points, got {len(points)}")
    extent = check_extent(points, "points")
    first, _ = distinct(points, extent)
    if len(first) < len(points):
        remarks.append(f"{len(points) - len(first)} repeated points were dropped")
        points, normals = points[first], None if normals is None else normals[first]
    if len(points) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} different points, got {len(points)}")
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * extent) < 2:
        raise InvalidObject("points: expected a surface, got points on one line")
    tree = cKDTree(points)
    if normals is None:
        normals = _estimated_normals(points, tree)
    reach = tree.query(points, k=AREA_NEIGHBOURS + 1)[0][:, -1]
    # A disc holds its neighbours and half the one on its rim.
    return Cloud(points, normals, np.pi * reach**2 / (AREA_NEIGHBOURS + 0.5)), tuple(remarks)


def cloud_fields(cloud: Cloud) -> Fields:
    """The smooth and the sharp field of a cloud, and whether it has an inside."""
    size = diameter(cloud.vertices)
    coarse, fine, remarks = grids(cloud.vertices, size)
    tree = cKDTree(cloud.vertices)
    winding = Winding(cloud.vertices, cloud.areas[:, None] * cloud.normals)
    nodes = coarse.nodes()
    gap = tree.query(nodes)[0]
    inside = winding.inside(nodes)
    closed = _largest_gap(coarse, gap, inside) < LARGEST_HOLE * size and _winds(cloud, winding)
    values = _distances(cloud, tree, nodes, winding if closed else None)
    sharp = interpolated(coarse, values, fine)
    band = BAND * fine.cell
    index = np.flatnonzero(np.abs(sharp) < band + coarse.cell / 2)
    sharp[index] = _distances(cloud, tree, fine.nodes_at(index), winding if closed else None)
    return Fields(coarse.field(values), fine.field(sharp), size, closed, remarks)


def _winds(cloud: Cloud, winding: Winding) -> bool:
    """Whether the cloud winds once around what is behind its points, and not around what is in front."""
    index = np.random.default_rng(3).permutation(len(cloud.vertices))[:400]
    # Nearer than two spacings single points are felt.
    step = 2 * cloud.spacing * cloud.normals[index]
    behind, front = winding.at(cloud.vertices[index] - step), winding.at(cloud.vertices[index] + step)
    return bool(((behind > 0.5) & (front < 0.5)).mean() > 0.9)


def _largest_gap(grid: Grid, gap: Array, inside: Mask) -> float:
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


def _agreed(normals: Array, forest: object, part: Indices, count: int) -> Array:
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
