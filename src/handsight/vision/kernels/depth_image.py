"""Depth images as segments, as surface normals at chosen pixels, and as points near an object's surface.

On a plane `n·P = 1` one over the depth is linear in the rays, `n·(x, y, 1) = 1/z`, with noise that is about the same at
each pixel; so normals are of planes that are fitted to it.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.symmetry import pose_of
from handsight._compiled.vec3 import Vec3, apply, apply_inverse, dot, norm, scale, store, sub, vector
from handsight.objects.kernels.field import field_at
from handsight.vision.kernels.vision_records import HAND, OUT, TABLE

HALF_WINDOW = 4
MIN_NEIGHBOURS = 15
"""Half the side of the window for a normal [pixels], and how many of its pixels must be on the surface."""
OPEN = -4  # label of a pixel whose segment has no number yet


@inner
def step_at(z: float) -> float:
    """Returns the largest step in depth [m] between neighbouring pixels of one segment."""
    return 4e-3 + 6e-3 * z * z


@inner
def point_at(rays: Any, depth: Any, v: int, u: int) -> Vec3:
    """Returns the point of the pixel in row v and column u [m]."""
    z = depth[v, u]
    return rays[v, u, 0] * z, rays[v, u, 1] * z, z


@entry
def sort_pixels(rays: Any, image: Any, table: Any, known: Any, labels: Any) -> None:
    """Fills in the known depth (h, w), 0 where there is none, and labels (h, w): `OPEN`, `TABLE`, `HAND` or `OUT`.

    image: depth, whether a pixel is wanted, and whether it is of the hand, (h, w) each. table (5,): normal, offset, and
    the distance within which a point is the table's [m], which grows with the square of a depth above 1 m.
    """
    depth, wanted, hand = image
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            label = OUT
            if not 0 < z < np.inf:
                z = 0.0
            else:
                height = z * (rays[v, u, 0] * table[0] + rays[v, u, 1] * table[1] + table[2]) + table[3]
                within = table[4] * max(z * z, 1.0)
                if abs(height) <= within:
                    label = TABLE
                elif wanted[v, u] and height > within:
                    label = OPEN
            known[v, u] = z
            labels[v, u] = HAND if hand[v, u] else label


@entry
def label_parts(depth: Any, labels: Any, least: int, sizes: Any) -> int:
    """Numbers the segments of `OPEN` pixels in `labels` (h, w) from 0 on, fills in their sizes, and returns their
    number. Segments of less than `least` pixels become `OUT`."""
    height, width = depth.shape
    part = np.empty((height * width, 2), np.int64)
    count = 0
    for row in range(height):
        for column in range(width):
            if labels[row, column] != OPEN:
                continue
            labels[row, column] = count
            part[0, 0] = row
            part[0, 1] = column
            done = 0
            size = 1
            while done < size:
                v, u = part[done, 0], part[done, 1]
                z = depth[v, u]
                done += 1
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
    """Fills in the first of the pixels `order` (n,), by row and column in one, in each cube of space so wide [m], and
    returns how many there are. The cubes are found in a hash table with four slots for each that may be filled."""
    width = depth.shape[1]
    free = np.iinfo(np.int64).min
    size = 1
    while size < 4 * len(chosen):
        size *= 2
    taken = np.full(size, free)
    count = 0
    for pixel in order:
        v = pixel // width
        u = pixel % width
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
    """Returns the unit normal, towards the camera, of the surface at a pixel; zero where its window shows no
    surface."""
    z = depth[v, u]
    x0 = rays[v, u, 0]
    y0 = rays[v, u, 1]
    step = 2 * step_at(z)
    count = 0
    xx = xy = yy = sx = sy = xd = yd = sd = 0.0
    for row in range(max(v - HALF_WINDOW, 0), min(v + HALF_WINDOW + 1, depth.shape[0])):
        for column in range(max(u - HALF_WINDOW, 0), min(u + HALF_WINDOW + 1, depth.shape[1])):
            there = depth[row, column]
            if not abs(there - z) < step:
                continue
            x = rays[row, column, 0] - x0
            y = rays[row, column, 1] - y0
            d = 1 / there
            xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
            sx, sy, sd = sx + x, sy + y, sd + d
            xd, yd = xd + x * d, yd + y * d
            count += 1
    if count < MIN_NEIGHBOURS:
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
    """Fills in the DEPTH_POINT `out` (n,) of pixels (n,), given by row and column in one."""
    for n in range(len(pixels)):
        v = pixels[n] // depth.shape[1]
        u = pixels[n] % depth.shape[1]
        store(point_at(rays, depth, v, u), out[n].point)
        store(normal_at(rays, depth, v, u), out[n].normal)
        out[n].part = labels[v, u]


@entry
def leave_out_plane(image: Any, window: Any) -> None:
    """Labels the window's pixels on or behind its plane as `OUT`; image: rays (h, w, 2), depth [m] and labels (h,
    w)."""
    rays, depth, labels = image
    here = window[0]
    normal = vector(here.plane)
    offset = here.plane[3]
    within = here.plane_within
    for v in range(here.rows[0], here.rows[1]):
        for u in range(here.columns[0], here.columns[1]):
            z = depth[v, u]
            height = dot(normal, point_at(rays, depth, v, u)) + offset
            if height <= within * max(z * z, 1.0):
                labels[v, u] = OUT


@entry
def near_points(surface: Any, image: Any, window: Any, candidate: Any, out: Any) -> int:
    """Fills in DEPTH_POINT (n,) with points near the surface at CANDIDATE (1,), evenly over all such; returns how many.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m], labels (h, w), of which the negative are
    left out. window: WINDOW (1,), whose step is made smaller until there are n.
    """
    (rays, depth, labels), (model, nodes) = image, surface
    here = window[0]
    step = window[0].step
    pose = pose_of(candidate[0].pose)
    # No point of an object is farther from its centre than 1.2 radii.
    center = apply(pose, vector(model[0].center))
    reach2 = (1.2 * model[0].radius + here.within) ** 2
    while True:
        rows, columns = here.rows[1] - here.rows[0], here.columns[1] - here.columns[0]
        found = np.empty((rows // step + 1) * (columns // step + 1), np.int64)
        count = 0
        for v in range(here.rows[0], here.rows[1], step):
            for u in range(here.columns[0], here.columns[1], step):
                if labels[v, u] < 0 or not depth[v, u] > 0:
                    continue
                P = point_at(rays, depth, v, u)
                way = sub(P, center)
                if not dot(way, way) < reach2:
                    continue
                if abs(field_at(nodes, model[0].coarse, apply_inverse(pose, P))[0]) < here.within:
                    found[count] = v * depth.shape[1] + u
                    count += 1
        if step == 1 or count >= len(out):
            break
        # Where most of the object is hidden, the visible part still gives that many points.
        step = max(1, min(step - 1, int(step * np.sqrt(count / len(out)))))
    kept = min(count, len(out))
    for n in range(kept):
        place = found[n * count // kept]
        store(point_at(rays, depth, place // depth.shape[1], place % depth.shape[1]), out[n].point)
    return kept
