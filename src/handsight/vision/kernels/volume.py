"""Depth images fused into a volume: at each node the mean distance to the surface along the rays (Curless and Levoy
1996).

A pixel counts by the inverse variance of its depth, which grows with the fourth power of the depth. Nothing is known
between pixels of which one is on a nearer surface than the other.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.pinhole import project
from handsight._compiled.symmetry import transform_of
from handsight._compiled.vec3 import apply, norm
from handsight.vision.kernels.depth_image import step_at

CLEAR = 3.0
"""A ray has passed a node that lies so many bounds before its surface; nearer, the surface may be seen aslant."""


@inner
def _depth_between(depth: Any, u: float, v: float) -> float:
    """Returns the depth [m] at a place between four pixels; 0 where they are not of one surface, or one has no depth.
    One over the depth is interpolated: on a plane it is linear in the image."""
    column, row = int(u), int(v)
    if u < 0 or v < 0 or column + 1 >= depth.shape[1] or row + 1 >= depth.shape[0]:
        return 0.0
    a = float(depth[row, column])
    b = float(depth[row, column + 1])
    c = float(depth[row + 1, column])
    d = float(depth[row + 1, column + 1])
    near, far = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if not (near > 0 and far - near < 2 * step_at(near)):
        return 0.0
    x, y = u - column, v - row
    return 1 / ((1 - y) * ((1 - x) / a + x / b) + y * ((1 - x) / c + x / d))


@entry
def fuse(camera: Any, depth: Any, to_camera: Any, bound: float, voxels: Any) -> None:
    """Adds a depth image (h, w) [m], 0 where there is none, to VOXEL (nx, ny, nz). `to_camera` (3, 4): from a node's
    index in the grid to the camera [m]; `bound`: the largest distance to the surface that is kept [m]."""
    (height, width), pose = depth.shape, transform_of(to_camera)
    for i in range(voxels.shape[0]):
        for j in range(voxels.shape[1]):
            for k in range(voxels.shape[2]):
                node = apply(pose, (i, j, k))
                voxel = voxels[i, j, k]
                u, v = project(camera[0], node)
                if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
                    continue
                nearest = depth[int(v + 0.5), int(u + 0.5)]
                gap = nearest - node[2]
                if not nearest > 0 or gap < -2 * bound:
                    continue
                if gap > CLEAR * bound:
                    voxel.passed += np.float32(1)
                    continue
                observed = _depth_between(depth, u, v)
                gap = (observed - node[2]) * norm(node) / node[2]  # along the ray
                if observed > 0 and abs(gap) <= bound:
                    weight = np.float32(1 / (observed * observed * observed * observed))
                    voxel.sum += weight * np.float32(gap)
                    voxel.weight += weight
                    voxel.views += np.float32(1)
