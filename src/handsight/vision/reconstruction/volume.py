"""A volume into which depth images of an object are fused, and the surface in it."""

from typing import NamedTuple

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask
from handsight.objects.fields import Grid, GridField
from handsight.vision.kernels import volume as kernel
from handsight.vision.kernels.vision_records import VOXEL

BOUND = 3.0  # distances to the surface are kept up to this [cells]
MIN_VIEWS = 2  # views that must agree on a node: one alone may be noise


class SurfacePoints(NamedTuple):
    """Points of a surface, about a cell apart."""

    points: Array  # (n, 3) [m]
    normals: Array  # (n, 3) unit, outward


class Volume:
    """Distances to a surface on a grid in the object's frame, as far as depth images give them."""

    def __init__(self, bounds_object: Array, cell: float) -> None:
        """`bounds_object` (2, 3): its least and largest coordinates [m]; `cell`: side of a cell [m]."""
        shape = np.ceil((bounds_object[1] - bounds_object[0]) / cell).astype(int) + 1
        self.grid = Grid(bounds_object[0], cell, (int(shape[0]), int(shape[1]), int(shape[2])))
        self.voxels = np.zeros(self.grid.shape, dtype=VOXEL)
        self.views = 0

    @property
    def bound(self) -> float:
        """The largest distance that is kept [m]."""
        return BOUND * self.grid.cell

    @property
    def bounds_object(self) -> Array:
        """(2, 3) [m]."""
        low = self.grid.origin
        return np.stack([low, low + self.grid.cell * (np.array(self.grid.shape) - 1)])

    def fuse(self, camera: Camera, depth: Depth, T_camera_object: Array) -> None:
        """Adds a depth image (h, w) [m], 0 where it has no depth."""
        R = T_camera_object[:3, :3]
        p = T_camera_object[:3, 3]
        to_camera = np.column_stack([R * self.grid.cell, R @ self.grid.origin + p])
        kernel.fuse(camera.record, depth, to_camera, self.bound, self.voxels)
        self.views += 1

    def known(self, least: int = MIN_VIEWS) -> Mask:
        """Returns (nx, ny, nz) whether so many views had the surface near a node, and no more of them saw past it."""
        views = self.voxels["views"]
        return np.asarray((views >= least) & (self.voxels["passed"] <= views))

    def distances(self, least: int = MIN_VIEWS) -> Array:
        """Returns (nx, ny, nz) [m]; NaN where it is not known."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self.voxels["sum"] / self.voxels["weight"]
        return np.where(self.known(least), mean, np.nan).astype(np.float64)

    def field(self) -> GridField:
        """Returns the distances of any views as a smooth field, with the largest distance where there is none."""
        return self.grid.field(np.nan_to_num(self.distances(1), nan=self.bound).reshape(-1))

    def surface(self) -> SurfacePoints:
        """Returns the surface: where distances change their sign between neighbours."""
        f = self.distances()
        slopes = []
        for axis in range(3):
            # The mean change to the known neighbours, 0 where there is none: a surface seen aslant is a few nodes
            # thick, and often has a neighbour on one side only.
            change = np.diff(f, axis=axis, prepend=np.nan, append=np.nan)
            both = np.lib.stride_tricks.sliding_window_view(change, 2, axis)
            known = np.isfinite(both)
            slopes.append(np.where(known, both, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1))
        slope = np.stack(slopes, axis=-1)
        points = []
        normals = []
        for axis, step in enumerate(np.eye(3, dtype=np.int64)):
            at = np.argwhere(np.abs(np.diff(np.sign(f), axis=axis)) == 2)
            here = tuple(at.T)
            there = tuple((at + step).T)
            rise = f[there] - f[here]
            share = (-f[here] / rise)[:, None]
            way = (1 - share) * slope[here] + share * slope[there]
            length = np.linalg.norm(way, axis=1)
            # Where the slope contradicts the change of sign, or is not known, there is no surface.
            good = (length > 0) & (way[:, axis] * rise > 0)
            points.append((at + share * step)[good])
            normals.append(way[good] / length[good, None])
        cells, facing = thinned(np.concatenate(points), np.concatenate(normals))
        return SurfacePoints(self.grid.origin + self.grid.cell * cells, facing)

    def among(self, nodes: Mask, points_object: Array) -> Mask:
        """Returns (n,) whether the nodes nearest to points (n, 3) [m] are among `nodes` (nx, ny, nz)."""
        place = self.places(points_object)
        inside = np.asarray(((place >= 0) & (place < self.grid.shape)).all(axis=1))
        inside[inside] = nodes[tuple(place[inside].T)]
        return inside

    def places(self, points_object: Array) -> Indices:
        """Returns (n, 3) the indices of the nodes nearest to points (n, 3) [m]; they may be outside."""
        return np.asarray(np.rint((points_object - self.grid.origin) / self.grid.cell).astype(np.int64))

    def observed(self) -> Mask:
        """Returns (nx, ny, nz) whether any view measured each node, as surface or as free space."""
        return np.asarray((self.voxels["views"] > 0) | (self.voxels["passed"] > 0))

    def clear(self) -> Mask:
        """Returns (nx, ny, nz) whether a node is free space: more views saw past it than had a surface near."""
        views = self.voxels["views"]
        passed = self.voxels["passed"]
        return np.asarray((passed > views) & (passed >= min(MIN_VIEWS, self.views)))


def thinned(points: Array, normals: Array) -> SurfacePoints:
    """Returns the means of the points (n, 3) [cells] with normals (n, 3) in each cell that face the same way."""
    facing = np.abs(normals).argmax(axis=1)
    side = 2 * facing + (normals[np.arange(len(normals)), facing] > 0)
    _, means = means_by_cell(np.column_stack([np.rint(points), side]), np.hstack([points, normals]))
    normal = means[:, 3:]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return SurfacePoints(means[:, :3], normal / np.maximum(length, 1e-12))


def means_by_cell(cells: Array, rows: Array) -> tuple[Indices, Array]:
    """Returns the number (n,) of each row's cell, by `cells` (n, k), and the means (c, m) of rows (n, m) in each."""
    _, which, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    return which, np.stack([np.bincount(which, column) / count for column in rows.T], axis=1)
