"""Depth images fused into a volume: at each node the mean distance to the surface, along the rays of those that see it.

Curless and Levoy (1996). A pixel counts by its depth's inverse variance, which grows with the fourth power of the
depth. Between pixels at a jump nothing is told: half of what they see is before it, half behind.
"""

from typing import Any

import numpy as np

from handsight._kernels.image.depth_image import step_at
from handsight._kernels.image.pinhole import project
from handsight._kernels.math.vec3 import Vec3, norm
from handsight._kernels.runtime.compilation import entry, inner

CLEAR = 3.0
"""What a ray has left behind by so many bounds it has passed; less may be a surface seen aslant."""


@inner
def _depth_between(depth: Any, u: float, v: float) -> float:
    """Returns the depth at a place between four pixels of one surface; 0 where they are not, or one has none.

    One over the depth is interpolated: on a plane it is linear in the image.
    """
    column, row = int(u), int(v)
    if u < 0 or v < 0 or column + 1 >= depth.shape[1] or row + 1 >= depth.shape[0]:
        return 0.0
    a, b = float(depth[row, column]), float(depth[row, column + 1])
    c, d = float(depth[row + 1, column]), float(depth[row + 1, column + 1])
    near, far = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if not (near > 0 and far - near < 2 * step_at(near)):
        return 0.0
    x, y = u - column, v - row
    return 1 / ((1 - y) * ((1 - x) / a + x / b) + y * ((1 - x) / c + x / d))


@inner
def _see(voxel: Any, depth: Any, pixel: tuple[float, float], node: Vec3, bound: float) -> None:
    """Adds what a depth image says of a node in the camera that falls on a place (column, row) of it."""
    u, v = pixel
    nearest = depth[int(v + 0.5), int(u + 0.5)]
    gap = nearest - node[2]
    if not nearest > 0 or gap < -2 * bound:
        return
    if gap > CLEAR * bound:
        voxel.passed += np.float32(1)
        return
    observed = _depth_between(depth, u, v)
    gap = (observed - node[2]) * norm(node) / node[2]  # along the ray
    if observed > 0 and abs(gap) <= bound:
        weight = np.float32(1 / (observed * observed * observed * observed))
        voxel.sum += weight * np.float32(gap)
        voxel.weight += weight
        voxel.views += np.float32(1)


@entry
def fuse(camera: Any, depth: Any, to_camera: Any, bound: float, voxels: Any) -> None:
    """Adds a depth image (h, w) [m], 0 where there is none, to VOXEL (nx, ny, nz).

    `to_camera` (3, 4): from a node's place in the grid to the camera [m]; `bound` [m]: what is farther from the surface
    is not told how far.
    """
    height, width = depth.shape
    M = to_camera
    for i in range(voxels.shape[0]):
        for j in range(voxels.shape[1]):
            for k in range(voxels.shape[2]):
                x = M[0, 0] * i + M[0, 1] * j + M[0, 2] * k + M[0, 3]
                y = M[1, 0] * i + M[1, 1] * j + M[1, 2] * k + M[1, 3]
                z = M[2, 0] * i + M[2, 1] * j + M[2, 2] * k + M[2, 3]
                u, v = project(camera[0], (x, y, z))
                if u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
                    _see(voxels[i, j, k], depth, (u, v), (x, y, z), bound)
