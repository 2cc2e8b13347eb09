"""The geometry of a point cloud: its normals and its distance fields.

Near the points the distance is the smooth average of the planes through them (implicit moving least squares,
Kolluri 2008), or, where they are noisy, of the quadrics fitted to them (`handsight.objects.scans`); far away it is the
distance to the nearest point, negative where the cloud's winding number is that of the inside. An open cloud has two
sides and no inside. Outliers are not removed.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices
from handsight.errors import InvalidObject
from handsight.objects.fields import grid_fields, grids
from handsight.objects.geometry import Geometry, geometry_of, roughened, with_error
from handsight.objects.meshes.box_tree import Winding
from handsight.objects.scans.normals import PLANE_NEIGHBOURS, outwards, planes
from handsight.objects.scans.scan import scanned, unseen_variances
from handsight.objects.surface import MAX_HOLE, Cloud, check_extent, diameter, distinct

MIN_POINTS = 20  # of a cloud
AREA_NEIGHBOURS = 8  # nearest points from which a point's share of the area is measured
NEAR = 2.0  # distance to a point below which the smooth surface counts alone [spacings]
FAR = 4  # distance to a point beyond which the point counts alone [spacings]

Heights = Callable[[Array, Indices], Array]
"""A function of nodes (n, 3) near the smooth surface, and of the indices (n,) of the points nearest to them, that
returns the nodes' heights (n,) [m] above that surface."""


def cloud_geometry(points: Array, normals: Array | None) -> Geometry:
    """Returns the geometry of finite points (n, 3) [m] with unit outward normals or None; raises InvalidObject.

    Equal points are merged, missing normals are estimated, and noisy points are replaced by the surface fitted to them.
    """
    points, normals, remarks = _checked(points, normals)
    scan = scanned(points, normals, diameter(points))
    if scan is not None:
        points, normals = scan.surface.converged()
    tree = cKDTree(points)
    if normals is None:
        normals = outwards(points, planes(points, points, PLANE_NEIGHBOURS), tree)
    reach = tree.query(points, k=AREA_NEIGHBOURS + 1)[0][:, -1]
    # A disc holds its neighbours and half the one on its rim.
    cloud = Cloud(points, normals, np.pi * reach**2 / (AREA_NEIGHBOURS + 0.5))
    heights = partial(plane_heights, cloud, tree) if scan is None else scan.surface.heights
    size = diameter(points)
    coarse, fine, coarser = grids(points, size)
    winding = Winding(points, cloud.areas[:, None] * normals)
    nodes = coarse.nodes()
    # The largest hole is twice as wide as the points are far from where inside meets outside.
    gap = tree.query(nodes)[0].reshape(coarse.shape)
    inside = winding.inside(nodes).reshape(coarse.shape)
    hole = 0.0
    for axis, n in enumerate(coarse.shape):
        nearer = np.minimum(gap.take(range(n - 1), axis), gap.take(range(1, n), axis))
        hole = max(hole, float(2 * nearer[np.diff(inside, axis=axis)].max(initial=0.0)))
    # Is the winding number 1 behind nearly all points, and 0 in front? Within two spacings, single points change it.
    index = np.random.default_rng(3).permutation(len(points))[:400]
    step = 2 * cloud.spacing * normals[index]
    behind = winding.at(points[index] - step)
    front = winding.at(points[index] + step)
    closed = hole < MAX_HOLE * size and bool(((behind > 0.5) & (front < 0.5)).mean() > 0.9)
    distances: Callable[[Array], Array]
    if closed:
        distances = partial(closed_distances, cloud, tree, heights, winding)
        blur = 0.0
    else:
        distances = open_distances(cloud, tree, heights)
        blur = cloud.spacing

    def exact(index: Indices, _: float) -> tuple[Indices, Array]:
        return index, distances(fine.nodes_at(index))

    fields = grid_fields(coarse, distances(nodes), fine, exact, sheet=not closed, blur=blur)
    geometry = geometry_of(cloud, *fields, diameter=size, closed=closed, remarks=(*remarks, *coarser))
    if scan is None:
        return geometry
    geometry = roughened(geometry, scan.roughness)
    if closed:
        return geometry
    return with_error(geometry, lambda at: unseen_variances(tree.query(at)[0], winding.at(at), cloud.spacing))


def _checked(points: Array, normals: Array | None) -> tuple[Array, Array | None, tuple[str, ...]]:
    """Returns the points and normals without repeats, and a remark where there were any; raises InvalidObject."""
    expected = f"points: expected at least {MIN_POINTS}"
    if len(points) < MIN_POINTS:
        raise InvalidObject(f"{expected} points, got {len(points)}")
    extent = check_extent(points, "points")
    first, _ = distinct(points, extent)
    if len(first) < MIN_POINTS:
        raise InvalidObject(f"{expected} different points, got {len(first)}")
    repeated = len(points) - len(first)
    points = points[first]
    normals = None if normals is None else normals[first]
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * extent) < 2:
        raise InvalidObject("points: expected a surface, got points on one line")
    return points, normals, (f"{repeated} repeated points were dropped",) if repeated else ()


def plane_heights(cloud: Cloud, tree: cKDTree, nodes: Array, _: Indices) -> Array:
    """Returns the heights (n,) [m] of nodes (n, 3) above the smooth average of the planes through the nearest points of
    a cloud, by Gaussian weights of their distance."""
    gap, index = tree.query(nodes, k=min(10, len(cloud.vertices)))
    near = gap[:, 0]
    # The Gaussian is wide enough for a few points, near the cloud and far from it.
    width2 = (near + cloud.spacing) ** 2
    weight = np.exp(-((gap**2 - near[:, None] ** 2) / width2[:, None]))
    # Points on the far side of a thin wall get next to no weight.
    agreement = np.einsum("nki,ni->nk", cloud.normals[index], cloud.normals[index[:, 0]])
    weight *= np.maximum(agreement, 0.0) + 1e-9
    height = np.einsum("nki,nki->nk", nodes[:, None] - cloud.vertices[index], cloud.normals[index])
    return np.asarray((weight * height).sum(axis=1) / weight.sum(axis=1))


def closed_distances(cloud: Cloud, tree: cKDTree, heights: Heights, winding: Winding, nodes: Array) -> Array:
    """Returns the signed distances (n,) [m] of nodes (n, 3) to a cloud with an inside, where they are negative: the
    height near the surface, blended into the distance to the nearest point far from it."""
    near, nearest = tree.query(nodes)
    share = _smooth_step(near / cloud.spacing, NEAR, FAR)
    smooth = np.zeros(len(nodes))
    away = np.flatnonzero(share > 0)
    close = np.flatnonzero(share < 1)
    near[away] *= np.where(winding.inside(nodes[away]), -1.0, 1.0)
    smooth[close] = heights(nodes[close], nearest[close])
    return np.asarray((1 - share) * smooth + share * near)


def open_distances(cloud: Cloud, tree: cKDTree, heights: Heights) -> Callable[[Array], Array]:
    """Returns the signed distances (n,) [m] of nodes (n, 3) to a cloud without an inside.

    Above the points, the distance is the height over them; beside them, past a rim or an edge, it is the distance to
    the nearest point, and never zero. It is negative behind the cloud. Where front borders on back with no surface
    between them, the sign jumps (`handsight.objects.fields.GridField`).
    """
    points = cloud.vertices
    normals = cloud.normals
    # Of each point's neighbours on the same side of a wall: their middle, and how far it would be from a rim.
    # The middle of the nearest points tells whether a place is above them or beside them.
    around = tree.query(points, k=min(25, len(points)))[1]
    # Points whose normals are more than 120° apart are on two sides of a wall.
    alike = np.einsum("nki,ni->nk", normals[around], normals) > -0.5
    count = alike.sum(axis=1)
    middles = np.einsum("nk,nki->ni", alike, points[around]) / count[:, None]
    spacing = np.sqrt(cloud.areas[around].mean(axis=1))
    # At a rim they fill half a disc, whose middle is 4/3π of its radius away.
    to_rim = 4 / (3 * np.pi) * np.sqrt(2 * count / np.pi) * spacing

    def distances(nodes: Array) -> Array:
        """Returns the height over the points, blended into the distance to the nearest point beside them."""
        near, nearest = tree.query(nodes)
        height = np.einsum("ni,ni->n", nodes - points[nearest], normals[nearest])
        share = _smooth_step(near / cloud.spacing, NEAR, FAR)
        close = np.flatnonzero(share < 1)
        smooth = heights(nodes[close], nearest[close])
        height[close] = (1 - share[close]) * smooth + share[close] * height[close]
        # 0 where the nearest points have neighbours all around below the node, 1 where it is past the last of them.
        away = nodes - middles[nearest]
        above = np.einsum("ni,ni->n", away, normals[nearest])
        lateral = np.linalg.norm(away - above[:, None] * normals[nearest], axis=1)
        # Up to 0.4 spacings past the last points their surface counts alone, and beyond 1.2 the point does.
        beside = _smooth_step((lateral - to_rim[nearest]) / spacing[nearest], 0.4, 1.2)
        size = (1 - beside) * np.abs(height) + beside * near
        # A place that is lower than half of its distance below the points is behind them.
        return np.asarray(np.where(height < -0.5 * size, -size, size))

    return distances


def _smooth_step(x: Array, low: float, high: float) -> Array:
    """Returns 0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    return share * share * (3 - 2 * share)
