"""What is measured on a point cloud: its normals and its distance fields.

Near the points the distance is the smooth average of the planes through them (implicit moving least squares,
Kolluri 2008), or, where they are noisy, of the quadrics fitted to them (`handsight.objects.scans`); far away it is that
to the nearest point, negative where the cloud winds around. A cloud that is open has sides and no inside. Outliers are
not removed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidObject
from handsight.objects.cloud_distances import ClosedDistances, OpenDistances
from handsight.objects.fields import Grid, GridField, grids, sharpened
from handsight.objects.geometry import Geometry, measured, roughened, with_error
from handsight.objects.meshes.box_tree import Winding
from handsight.objects.scans.holes import unseen_variances
from handsight.objects.scans.normals import estimated_normals
from handsight.objects.scans.scan import scanned
from handsight.objects.surface import SURFACE, Cloud, check_extent, diameter, distinct


class CloudOptions(NamedTuple):
    """`CloudOptions` say how a surface is read off points."""

    min_points: int = 20  # of a cloud
    planes: int = 10  # points whose planes are averaged
    area_neighbours: int = 8  # points by which a point's share of the area is measured


CLOUD = CloudOptions()


def cloud_geometry(points: Array, normals: Array | None) -> Geometry:
    """Returns what is to be known of finite points (n, 3) [m] with unit outward normals or none; raises InvalidObject.

    Equal points are merged. Normals that were not given are estimated and made to point outwards. Of noisy points the
    object is the surface that was fitted to them.
    """
    points, normals, remarks = _distinct(points, normals)
    scan = scanned(points, normals, diameter(points))
    if scan is not None:
        points, normals = scan.surface.converged()
    tree = cKDTree(points)
    if normals is None:
        normals = estimated_normals(points, tree)
    reach = tree.query(points, k=CLOUD.area_neighbours + 1)[0][:, -1]
    # A disc holds its neighbours and half the one on its rim.
    cloud = Cloud(points, normals, np.pi * reach**2 / (CLOUD.area_neighbours + 0.5))
    heights = _Planes(cloud, tree).heights if scan is None else scan.surface.heights
    size = diameter(points)
    coarse, fine, coarser = grids(points, size)
    winding = Winding(points, cloud.areas[:, None] * normals)
    nodes = coarse.nodes()
    hole = _largest_hole(coarse, tree.query(nodes)[0], winding.inside(nodes))
    closed = hole < SURFACE.max_hole * size and _winds(cloud, winding)
    if closed:
        fields = _fields(coarse, fine, ClosedDistances(cloud, tree, heights, winding).at)
    else:
        distances = OpenDistances(cloud, tree, heights)
        fields = _fields(coarse, fine, distances.at, sheet=True, blur=cloud.spacing)
    remarks = (*remarks, *coarser)
    geometry = measured(cloud, *fields, diameter=size, closed=closed, remarks=remarks)
    if scan is None:
        return geometry
    geometry = roughened(geometry, scan.roughness)

    def unseen(places: Array) -> Array:
        return unseen_variances(tree.query(places)[0], winding.at(places), cloud.spacing)

    return geometry if closed else with_error(geometry, unseen)


def _fields(
    coarse: Grid, fine: Grid, at: Callable[[Array], Array], *, sheet: bool = False, blur: float = 0.0
) -> tuple[GridField, GridField]:
    """Returns the fields on both grids of the distances (n,) [m] `at` nodes (n, 3); `sheet`, `blur`: as of
    GridField."""
    values = at(coarse.nodes())
    sharp = sharpened(coarse, values, fine, lambda index, _: (index, at(fine.nodes_at(index))), sheet=sheet)
    return coarse.field(values, sheet=sheet, blur=blur), fine.field(sharp, sheet=sheet, blur=blur)


def _distinct(points: Array, normals: Array | None) -> tuple[Array, Array | None, tuple[str, ...]]:
    """Returns the points and normals without repeats, and a remark where there were; raises InvalidObject."""
    if len(points) < CLOUD.min_points:
        raise InvalidObject(f"points: expected at least {CLOUD.min_points} points, got {len(points)}")
    extent = check_extent(points, "points")
    first, _ = distinct(points, extent)
    if len(first) < CLOUD.min_points:
        raise InvalidObject(
            f"points: expected at least {CLOUD.min_points} different points, got {len(first)}"
        )
    repeated = len(points) - len(first)
    points, normals = points[first], None if normals is None else normals[first]
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * extent) < 2:
        raise InvalidObject("points: expected a surface, got points on one line")
    return points, normals, (f"{repeated} repeated points were dropped",) if repeated else ()


def _winds(cloud: Cloud, winding: Winding) -> bool:
    """Returns whether the cloud winds once around what is behind its points, and not around what is in front."""
    index = np.random.default_rng(3).permutation(len(cloud.vertices))[:400]
    # Nearer than two spacings single points are felt.
    step = 2 * cloud.spacing * cloud.normals[index]
    behind, front = winding.at(cloud.vertices[index] - step), winding.at(cloud.vertices[index] + step)
    return bool(((behind > 0.5) & (front < 0.5)).mean() > 0.9)


def _largest_hole(grid: Grid, gap: Array, inside: Mask) -> float:
    """Returns the width [m] of the largest hole: where inside meets outside, twice the distance to the points."""
    largest = 0.0
    cube, sign = gap.reshape(grid.shape), inside.reshape(grid.shape)
    for axis, n in enumerate(grid.shape):
        nearer = np.minimum(cube.take(range(n - 1), axis), cube.take(range(1, n), axis))
        largest = max(largest, float(2 * nearer[np.diff(sign, axis=axis)].max(initial=0.0)))
    return largest


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """`_Planes` are the smooth average of the planes through the points of a cloud."""

    cloud: Cloud
    tree: cKDTree

    def heights(self, nodes: Array, _: Indices) -> Array:
        """Returns signed distances (n,) [m] of nodes (n, 3) near the cloud."""
        cloud = self.cloud
        k = min(CLOUD.planes, len(cloud.vertices))
        gap, index = self.tree.query(nodes, k=k)
        near = gap[:, 0]
        # Wide enough for a few points, wherever they are.
        width2 = (near + cloud.spacing) ** 2
        weight = np.exp(-((gap**2 - near[:, None] ** 2) / width2[:, None]))
        # The far side of a thin wall has no say.
        agreement = np.einsum("nki,ni->nk", cloud.normals[index], cloud.normals[index[:, 0]])
        weight *= np.maximum(agreement, 0.0) + 1e-9
        height = np.einsum("nki,nki->nk", nodes[:, None] - cloud.vertices[index], cloud.normals[index])
        return np.asarray((weight * height).sum(axis=1) / weight.sum(axis=1))
