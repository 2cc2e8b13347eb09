"""What a depth image holds: connected parts, and surface normals at chosen pixels.

A plane's one over depth is linear in the rays, `n·(x, y, 1) = 1/z` for the plane `n·P = 1`, and so is its noise nearly
the same at each pixel: planes are fitted there.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.vec3 import Vec3, norm, scale

HALF_WINDOW, LEAST_NEIGHBOURS = 4, 15
"""Of the window for a normal [pixels], and how many of its pixels must be on the surface."""
STEP, STEP_BY_SQUARE = 4e-3, 6e-3
"""Neighbouring pixels nearer than this [m], and this times the square of the depth, are of one part."""


@inner
def step_at(z: float) -> float:
    """The largest step in depth between neighbours of one part [m]."""
    return STEP + STEP_BY_SQUARE * z * z


@entry
def label_parts(depth: Any, wanted: Any, labels: Any) -> int:
    """Numbers the connected parts of the wanted pixels (h, w) from 0 on in `labels` (h, w), -1 elsewhere; how many."""
    height, width = depth.shape
    labels[:] = -1
    waiting, count = np.empty(height * width, np.int64), 0
    for start in range(height * width):
        v, u = start // width, start % width
        if not wanted[v, u] or labels[v, u] >= 0:
            continue
        labels[v, u], waiting[0], left = count, start, 1
        while left > 0:
            left -= 1
            v, u = waiting[left] // width, waiting[left] % width
            z = depth[v, u]
            for side in range(4):
                v1 = v + (1 if side == 0 else (-1 if side == 1 else 0))
                u1 = u + (1 if side == 2 else (-1 if side == 3 else 0))
                if v1 < 0 or v1 >= height or u1 < 0 or u1 >= width:
                    continue
                if wanted[v1, u1] and labels[v1, u1] < 0 and abs(depth[v1, u1] - z) < step_at(z):
                    labels[v1, u1] = count
                    waiting[left] = v1 * width + u1
                    left += 1
        count += 1
    return count


@inner
def normal_at(rays: Any, depth: Any, v: int, u: int) -> Vec3:
    """The unit normal, towards the camera, of what is seen at a pixel; zero where its surroundings are no surface."""
    z, x0, y0 = depth[v, u], rays[v, u, 0], rays[v, u, 1]
    step, count = 2 * step_at(z), 0
    xx = xy = yy = sx = sy = xd = yd = sd = 0.0
    for row in range(max(v - HALF_WINDOW, 0), min(v + HALF_WINDOW + 1, depth.shape[0])):
        for column in range(max(u - HALF_WINDOW, 0), min(u + HALF_WINDOW + 1, depth.shape[1])):
            there = depth[row, column]
            if not abs(there - z) < step:
                continue
            x, y, d = rays[row, column, 0] - x0, rays[row, column, 1] - y0, 1 / there
            xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
            sx, sy, sd = sx + x, sy + y, sd + d
            xd, yd = xd + x * d, yd + y * d
            count += 1
    if count < LEAST_NEIGHBOURS:
        return 0.0, 0.0, 0.0
    xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
    xd, yd = xd - sx * sd / count, yd - sy * sd / count
    determinant = xx * yy - xy * xy
    if not determinant > 1e-6 * (xx + yy) ** 2:
        return 0.0, 0.0, 0.0
    a, b = (yy * xd - xy * yd) / determinant, (xx * yd - xy * xd) / determinant
    plane = (a, b, (sd - a * sx - b * sy) / count - a * x0 - b * y0)
    return scale(plane, -1 / norm(plane))


@entry
def look_at(rays: Any, depth: Any, labels: Any, pixels: Any, out: Any) -> None:
    """Fills in the SEEN (n,) of pixels (n, 2), row and column."""
    for n in range(len(pixels)):
        v, u = pixels[n, 0], pixels[n, 1]
        z, seen = depth[v, u], out[n]
        seen.point[0], seen.point[1], seen.point[2] = rays[v, u, 0] * z, rays[v, u, 1] * z, z
        seen.normal[0], seen.normal[1], seen.normal[2] = normal_at(rays, depth, v, u)
        seen.part = labels[v, u]
