"""Signed distances to a point cloud, of one that has an inside and of one that has not.

Near the points they are to its smooth surface, far from them to the nearest point.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices
from handsight.objects.meshes.box_tree import Winding
from handsight.objects.surface import Cloud


class CloudDistanceOptions(NamedTuple):
    """`CloudDistanceOptions` say how the distance to a cloud's surface is blended from that to its planes and to its
    points."""

    near: float = 2.0  # spacings from a point below which the smooth surface counts alone
    far: float = 4.0  # spacings beyond which the point counts alone
    neighbours: int = 25  # points whose middle tells whether a place is above them or beside them
    opposite_cosine: float = -0.5  # points whose normals have a cosine below this are of two sides of a wall
    rim: float = 0.4  # spacings past the last points up to which the distance to their surface counts alone
    beside: float = 1.2  # spacings past the last points beyond which the distance to a point counts alone
    behind: float = -0.5  # height in parts of the distance below which a place is behind an open cloud


CLOUD_DISTANCES = CloudDistanceOptions()


Heights = Callable[[Array, Indices], Array]
"""Of nodes (n, 3) near the smooth surface and the points nearest to them (n,): how far above it they are (n,) [m]."""


@dataclass(frozen=True, eq=False)
class ClosedDistances:
    """`ClosedDistances` are distances to a cloud that has an inside: negative where the cloud winds around."""

    cloud: Cloud
    tree: cKDTree
    heights: Heights
    winding: Winding

    def at(self, nodes: Array) -> Array:
        """Returns signed distances (n,) [m] of nodes (n, 3)."""
        near, nearest = self.tree.query(nodes)
        share = _faded(near / self.cloud.spacing, CLOUD_DISTANCES.near, CLOUD_DISTANCES.far)
        far = near.copy()
        away = np.flatnonzero(share > 0)
        far[away] *= np.where(self.winding.inside(nodes[away]), -1.0, 1.0)
        close = np.flatnonzero(share < 1)
        smooth = np.zeros(len(nodes))
        smooth[close] = self.heights(nodes[close], nearest[close])
        return np.asarray((1 - share) * smooth + share * far)


@dataclass(frozen=True, eq=False)
class OpenDistances:
    """`OpenDistances` are distances to a cloud without an inside: negative behind it, and nowhere zero beyond its
    last points.

    Above its points a place is as far as it is high; beside them, past a rim or an edge, as the nearest of them. Where
    front gives way to back with no surface between them, the sign jumps (`handsight.objects.fields.GridField`).
    """

    cloud: Cloud
    tree: cKDTree
    heights: Heights

    def at(self, nodes: Array) -> Array:
        """Returns signed distances (n,) [m] of nodes (n, 3)."""
        near, nearest = self.tree.query(nodes)
        normals = self.cloud.normals[nearest]
        height = np.einsum("ni,ni->n", nodes - self.cloud.vertices[nearest], normals)
        share = _faded(near / self.cloud.spacing, CLOUD_DISTANCES.near, CLOUD_DISTANCES.far)
        close = np.flatnonzero(share < 1)
        smooth = self.heights(nodes[close], nearest[close])
        height[close] = (1 - share[close]) * smooth + share[close] * height[close]
        beside = self._beside(nodes, nearest)
        size = (1 - beside) * np.abs(height) + beside * near
        return np.asarray(np.where(height < CLOUD_DISTANCES.behind * size, -size, size))

    def _beside(self, nodes: Array, nearest: Indices) -> Array:
        """Returns (n,) 0 where the nearest points have neighbours all around below a node, 1 where it is past the
        last."""
        middles, to_rim, spacing = self._middles
        away, normals = nodes - middles[nearest], self.cloud.normals[nearest]
        height = np.einsum("ni,ni->n", away, normals)
        lateral = np.linalg.norm(away - height[:, None] * normals, axis=1)
        return _faded(
            (lateral - to_rim[nearest]) / spacing[nearest], CLOUD_DISTANCES.rim, CLOUD_DISTANCES.beside
        )

    @cached_property
    def _middles(self) -> tuple[Array, Array, Array]:
        """Of each point's neighbours the middle (m, 3), how far it would be from a rim (m,), their spacing (m,) [m]."""
        points, normals = self.cloud.vertices, self.cloud.normals
        around = self.tree.query(points, k=min(CLOUD_DISTANCES.neighbours, len(points)))[1]
        alike = np.einsum("nki,ni->nk", normals[around], normals) > CLOUD_DISTANCES.opposite_cosine
        count = alike.sum(axis=1)
        middles = np.einsum("nk,nki->ni", alike, points[around]) / count[:, None]
        spacing = np.sqrt(self.cloud.areas[around].mean(axis=1))
        # At a rim they fill half a disc, whose middle is 4/3π of its radius away.
        return middles, 4 / (3 * np.pi) * np.sqrt(2 * count / np.pi) * spacing, spacing


def _faded(x: Array, low: float, high: float) -> Array:
    """Returns 0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(share * share * (3 - 2 * share))
