"""What a depth image holds: connected parts, and surface normals at chosen pixels.

A plane's one over depth is linear in the rays, `n·(x, y, 1) = 1/z` for the plane `n·P = 1`, and so is its noise nearly
the same at each pixel: planes are fitted there.
"""

from typing import Any

import numpy as np

from handsight._kernels.image.pose_score import HAND, OUT, TABLE
from handsight._kernels.math.vec3 import Vec3, norm, scale
from handsight._kernels.runtime.compilation import entry, inner

HALF_WINDOW, LEAST_NEIGHBOURS = 4, 15
"""Of the window for a normal [pixels], and how many of its pixels must be on the surface."""
STEP, STEP_BY_SQUARE = 4e-3, 6e-3
"""Neighbouring pixels nearer than this [m], and this times the square of the depth, are of one part."""
OPEN = -4
"""Label of a pixel of a part that has no number yet."""
SLOTS = 4
"""Of a table of cells, for each that may be taken."""


@inner
def step_at(z: float) -> float:
    """Returns the largest step in depth between neighbours of one part [m]."""
    return STEP + STEP_BY_SQUARE * z * z


@entry
def sort_pixels(rays: Any, image: Any, table: Any, known: Any, labels: Any) -> None:
    """Fills in what is known of the depth (h, w), 0 elsewhere, and labels (h, w): `OPEN`, `TABLE`, `HAND` or `OUT`.

    image: depth, and whether a pixel is wanted and of the hand (h, w) each. table: (5,) normal and offset, and how near
    it is the table's [m], which grows with the square of a depth above 1 m.
    """
    depth, wanted, hand = image
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z, label = depth[v, u], OUT
            if not 0 < z < np.inf:
                z = 0.0
            else:
                height = z * (rays[v, u, 0] * table[0] + rays[v, u, 1] * table[1] + table[2]) + table[3]
                within = table[4] * max(z * z, 1.0)
                if abs(height) <= within:
                    label = TABLE
                elif wanted[v, u] and height > within:
                    label = OPEN
            known[v, u], labels[v, u] = z, HAND if hand[v, u] else label


@entry
def label_parts(depth: Any, labels: Any, least: int, sizes: Any) -> int:
    """Numbers the connected parts of `OPEN` pixels in `labels` (h, w) from 0 on, and fills in their sizes;
    how many.

    Parts of less than `least` pixels are `OUT`.
    """
    height, width = depth.shape
    part, count = np.empty((height * width, 2), np.int64), 0
    for row in range(height):
        for column in range(width):
            if labels[row, column] != OPEN:
                continue
            labels[row, column], part[0, 0], part[0, 1], done, size = count, row, column, 0, 1
            while done < size:
                v, u = part[done, 0], part[done, 1]
                z, done = depth[v, u], done + 1
                for v1, u1 in ((v + 1, u), (v - 1, u), (v, u + 1), (v, u - 1)):
                    if v1 < 0 or v1 >= height or u1 < 0 or u1 >= width:
                        continue
                    if labels[v1, u1] == OPEN and abs(depth[v1, u1] - z) < step_at(z):
                        labels[v1, u1], part[size, 0], part[size, 1] = count, v1, u1
                        size += 1
            if size < least:
                for k in range(size):
                    labels[part[k, 0], part[k, 1]] = OUT
            else:
                sizes[count] = size
                count += 1
    return count


@entry
def spread(rays: Any, depth: Any, order: Any, spacing: float, chosen: Any) -> int:
    """Fills in the first of pixels (n,), by row and column in one, in each cube of space so wide [m]; how many."""
    width, free = depth.shape[1], np.iinfo(np.int64).min
    size = 1
    while size < SLOTS * len(chosen):
        size *= 2
    taken, count = np.full(size, free), 0
    for pixel in order:
        v, u = pixel // width, pixel % width
        z = depth[v, u] / spacing
        x, y = int(np.floor(rays[v, u, 0] * z)), int(np.floor(rays[v, u, 1] * z))
        cell = (x * 1_000_003 + y) * 1_000_003 + int(z)
        slot = (cell ^ (cell >> 21)) & (size - 1)
        while taken[slot] != free and taken[slot] != cell:
            slot = (slot + 1) & (size - 1)
        if taken[slot] == cell:
            continue
        taken[slot], chosen[count] = cell, pixel
        count += 1
        if count == len(chosen):
            break
    return count


@inner
def normal_at(rays: Any, depth: Any, v: int, u: int) -> Vec3:
    """Returns the unit normal, towards the camera, of what is seen at a pixel; zero where its surroundings are no
    surface."""
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
def normals_at(rays: Any, depth: Any, labels: Any, pixels: Any, out: Any) -> None:
    """Fills in the DEPTH_POINT (n,) of pixels (n,), by row and column in one."""
    for n in range(len(pixels)):
        v, u = pixels[n] // depth.shape[1], pixels[n] % depth.shape[1]
        z, point = depth[v, u], out[n]
        point.point[0], point.point[1], point.point[2] = rays[v, u, 0] * z, rays[v, u, 1] * z, z
        point.normal[0], point.normal[1], point.normal[2] = normal_at(rays, depth, v, u)
        point.part = labels[v, u]
