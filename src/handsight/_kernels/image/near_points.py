"""Pixels of a depth image that lie near an object's surface where it is thought to be, in a window around it."""

from typing import Any

import numpy as np

from handsight._kernels.image.pose_score import OUT
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import Vec3, add, dot, mul, sub, tmul, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import entry, inner

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


@inner
def _gathered(surface: Any, image: Any, window: Any, at: Any, found: Any) -> int:
    """Fills in places of pixels near the surface at a POSE, of every so manieth of the window's; how many they are."""
    model, nodes = surface
    rays, depth, labels = image
    here, step = window
    coarse, R, p = model[0].coarse, pose_of(at)[0], pose_of(at)[1]
    center, reach2 = add(mul(R, vector(model[0].center)), p), (FARTHEST * model[0].radius + here.within) ** 2
    count = 0
    for v in range(here.rows[0], here.rows[1], step):
        for u in range(here.columns[0], here.columns[1], step):
            if labels[v, u] < 0 or not depth[v, u] > 0:
                continue
            P = _point(rays, depth, v, u)
            way = sub(P, center)
            if dot(way, way) < reach2 and abs(field_at(nodes, coarse, tmul(R, sub(P, p)))[0]) < here.within:
                found[count] = v * depth.shape[1] + u
                count += 1
    return count


@entry
def near_points(surface: Any, image: Any, window: Any, candidate: Any, out: Any) -> int:
    """Fills in the points of DEPTH_POINT with what lies near CANDIDATE (1,), evenly over all such; how many it filled
    in.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m], labels (h, w), of which the negative are
    left out. window: WINDOW (1,), its step taken smaller until there are as many. out: DEPTH_POINT (n,), n the most.
    """
    here, step = window[0], window[0].step
    rays, depth, _ = image
    while True:
        rows, columns = here.rows[1] - here.rows[0], here.columns[1] - here.columns[0]
        found = np.empty((rows // step + 1) * (columns // step + 1), np.int64)
        count = _gathered(surface, image, (here, step), candidate[0].pose, found)
        if step == 1 or count >= len(out):
            break
        # Where most of it is hidden, as many points are in what is left.
        step = max(1, min(step - 1, int(step * np.sqrt(count / len(out)))))
    kept = min(count, len(out))
    for n in range(kept):
        place = found[n * count // kept]
        P = _point(rays, depth, place // depth.shape[1], place % depth.shape[1])
        out[n].point[0], out[n].point[1], out[n].point[2] = P
    return kept
