"""Pixels of a depth image that lie near an object's surface where it is thought to be, in a window around it."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.field import field_at
from handsight._kernels.look_score import OUT
from handsight._kernels.symmetry import pose_of
from handsight._kernels.vec3 import Vec3, add, dot, mul, sub, tmul, vector

FARTHEST = 1.2
"""No point of an object is farther from its centre [radii]."""


@inner
def _point(rays: Any, depth: Any, v: int, u: int) -> Vec3:
    z = depth[v, u]
    return rays[v, u, 0] * z, rays[v, u, 1] * z, z


@entry
def leave_out_plane(image: Any, window: Any) -> None:
    """Labels the window's pixels on or behind its plane as `OUT`; image: rays, depth and labels, (h, w)."""
    rays, depth, labels = image
    here = window[0]
    normal, offset, within = vector(here.plane), here.plane[3], here.plane_within
    for v in range(here.rows[0], here.rows[1]):
        for u in range(here.columns[0], here.columns[1]):
            z = depth[v, u]
            height = dot(normal, _point(rays, depth, v, u)) + offset
            if height <= within * max(z * z, 1.0):
                labels[v, u] = OUT


@entry
def near_points(surface: Any, image: Any, window: Any, look: Any, out: Any) -> int:
    """Fills in the points of SEEN with what lies near LOOK (1,), evenly over all such; how many it filled in.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m], labels (h, w), of which the negative are
    left out. window: WINDOW (1,). out: SEEN (n,), n the most.
    """
    model, nodes = surface
    rays, depth, labels = image
    here, coarse, radius = window[0], model[0].coarse, model[0].radius
    R, p = pose_of(look[0].pose)
    center, reach2 = add(mul(R, vector(model[0].center)), p), (FARTHEST * radius + here.within) ** 2
    across = (here.columns[1] - here.columns[0]) // here.step + 1
    found = np.empty(((here.rows[1] - here.rows[0]) // here.step + 1) * across, np.int64)
    count = 0
    for v in range(here.rows[0], here.rows[1], here.step):
        for u in range(here.columns[0], here.columns[1], here.step):
            if labels[v, u] < 0 or not depth[v, u] > 0:
                continue
            P = _point(rays, depth, v, u)
            way = sub(P, center)
            if dot(way, way) < reach2 and abs(field_at(nodes, coarse, tmul(R, sub(P, p)))[0]) < here.within:
                found[count] = v * depth.shape[1] + u
                count += 1
    kept = min(count, len(out))
    for n in range(kept):
        place = found[n * count // kept]
        P = _point(rays, depth, place // depth.shape[1], place % depth.shape[1])
        out[n].point[0], out[n].point[1], out[n].point[2] = P
    return kept
