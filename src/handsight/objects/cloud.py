"""The surface and the distance fields of a point cloud.

Near the points the distance is the smooth average of the planes through them (implicit moving least squares,
Kolluri 2008); far away it is that to the nearest point, negative where the cloud winds around. Outliers are
not removed: each point given is taken for surface.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.objects.fields.grids import Fields, Grid, grids, interpolated
from handsight.objects.geometry import check_extent
from handsight.objects.meshes.winding import Winding
from handsight.objects.normals import LEAST_POINTS, estimated_normals

PLANES = 10
"""Points whose planes are averaged."""
AREA_NEIGHBOURS = 8
NEAR, FAR = 2.0, 4.0
"""Spacings from a point between which the average of planes gives way to the distance to it."""
BAND = 4
LARGEST_HOLE = 0.25
"""As for meshes: a cloud with a gap wider than this part of the diameter has no inside."""
_SAME_POINT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Oriented surface points."""

    points: Array
    """(n, 3) [m]."""
    normals: Array
    """(n, 3) unit, outward."""
    areas: Array
    """(n,) the surface each stands for [m²]."""

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
        at = (np.arange(n) + rng.random(n)) / max(n, 1)
        index = np.searchsorted(np.cumsum(self.areas) / self.area, at).clip(max=len(self.areas) - 1)
        return self.points[index], self.normals[index]


def cloud_from(points: Array, normals: Array | None) -> tuple[Cloud, tuple[str, ...]]:
    """The cloud of finite points (n, 3) [m] with unit normals or none, and remarks; raises InvalidObject.

    Equal points are merged. Normals that were not given are estimated and made to point outwards.
    """
    remarks: list[str] = []
    if len(points) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} points, got {len(points)}")
    extent = check_extent(points, "points")
    keys = np.round((points - points.min(axis=0)) / (_SAME_POINT * extent)).astype(np.int64)
    first = np.sort(np.unique(keys, axis=0, return_index=True)[1])
    if len(first) < len(points):
        remarks.append(f"{len(points) - len(first)} repeated points were dropped")
        points, normals = points[first], None if normals is None else normals[first]
    if len(points) < LEAST_POINTS:
        raise InvalidObject(f"points: expected at least {LEAST_POINTS} different points, got {len(points)}")
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * extent) < 2:
        raise InvalidObject("points: expected a surface, got points on one line")
    tree = cKDTree(points)
    if normals is None:
        normals = estimated_normals(points, tree)
    reach = tree.query(points, k=AREA_NEIGHBOURS + 1)[0][:, -1]
    # A disc holds its neighbours and half the one on its rim.
    return Cloud(points, normals, np.pi * reach**2 / (AREA_NEIGHBOURS + 0.5)), tuple(remarks)


def cloud_fields(cloud: Cloud, diameter: float) -> Fields:
    """The smooth and the sharp field of a cloud, and whether it has an inside."""
    coarse, fine, remarks = grids(cloud.points, diameter)
    tree = cKDTree(cloud.points)
    winding = Winding(cloud.points, cloud.areas[:, None] * cloud.normals)
    nodes = coarse.nodes()
    gap = tree.query(nodes)[0]
    inside = winding.at(nodes) > 0.5
    closed = _largest_gap(coarse, gap, inside) < LARGEST_HOLE * diameter and _winds(cloud, winding)
    values = _distances(cloud, tree, nodes, winding if closed else None)
    sharp = interpolated(coarse, values, fine)
    band = BAND * fine.cell
    index = np.flatnonzero(np.abs(sharp) < band + coarse.cell / 2)
    sharp[index] = _distances(cloud, tree, fine.nodes_at(index), winding if closed else None)
    return Fields(coarse.field(values), fine.field(sharp), closed, remarks)


def _winds(cloud: Cloud, winding: Winding) -> bool:
    """Whether the cloud winds once around what is behind its points, and not around what is in front."""
    index = np.random.default_rng(3).permutation(len(cloud.points))[:400]
    # Nearer than two spacings single points are felt.
    step = 2 * cloud.spacing * cloud.normals[index]
    behind, front = winding.at(cloud.points[index] - step), winding.at(cloud.points[index] + step)
    return bool(((behind > 0.5) & (front < 0.5)).mean() > 0.9)


def _largest_gap(grid: Grid, gap: Array, inside: NDArray[np.bool_]) -> float:
    """The width [m] of the largest hole: where inside meets outside, twice the distance to the points."""
    largest = 0.0
    cube, sign = gap.reshape(grid.shape), inside.reshape(grid.shape)
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        crossing = sign[tuple(low)] != sign[tuple(high)]
        width = np.minimum(cube[tuple(low)], cube[tuple(high)])[crossing]
        largest = max(largest, float(2 * width.max()) if len(width) else 0.0)
    return largest


def _distances(cloud: Cloud, tree: cKDTree, nodes: Array, winding: Winding | None) -> Array:
    """Signed distances (n,) [m] of the nodes; without a winding number, by the nearest point's normal."""
    k = min(PLANES, len(cloud.points))
    gap, index = tree.query(nodes, k=k)
    near = gap[:, 0]
    # Wide enough for a few points, wherever they are.
    width2 = (near + cloud.spacing) ** 2
    weight = np.exp(-((gap**2 - near[:, None] ** 2) / width2[:, None]))
    # The far side of a thin wall has no say.
    agreement = np.einsum("nki,ni->nk", cloud.normals[index], cloud.normals[index[:, 0]])
    weight *= np.maximum(agreement, 0.0) + 1e-9
    height = np.einsum("nki,nki->nk", nodes[:, None] - cloud.points[index], cloud.normals[index])
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
        far[away] *= np.where(winding.at(nodes[away]) > 0.5, -1.0, 1.0)
    return np.asarray((1 - share) * plane + share * far)
