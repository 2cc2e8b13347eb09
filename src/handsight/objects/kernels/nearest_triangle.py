"""The closest point of many triangles, by a tree of boxes around them.

The tree (`handsight.objects.meshes.box_tree`) is complete and in an array: the children of box k are 2k + 1 and 2k + 2.
The boxes of the last row are the leaves, and leaf i has the triangles from `starts[i]` to `starts[i + 1]`. From a
closest point the surface is seen along its normal, in which direction boxes should be thin; a box along the object's
axes is thick there where the surface is oblique. So the boxes around a leaf's triangles are in a frame of the leaf's
own, along its normal.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.vec3 import Vec3, add, dot, matrix, mul, scale, store, sub, tmul, vector

RESULT = 8  # numbers for each closest point: distance, point (3), weights of the corners (3), triangle


@inner
def _gap2(boxes: Any, k: int, p: Vec3) -> float:
    """Returns the squared distance from p to box k, given by its least and its greatest corner."""
    x = max(max(boxes[k, 0] - p[0], p[0] - boxes[k, 3]), 0.0)
    y = max(max(boxes[k, 1] - p[1], p[1] - boxes[k, 4]), 0.0)
    z = max(max(boxes[k, 2] - p[2], p[2] - boxes[k, 5]), 0.0)
    return x * x + y * y + z * z


@inner
def _weights(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Vec3:
    """Returns the weights of the corners in the point of triangle abc that is closest to p. On an edge the weight of
    the corner opposite is exactly 0."""
    u, v, w = sub(b, a), sub(c, a), sub(p, a)
    uu = dot(u, u)
    uv = dot(u, v)
    vv = dot(v, v)
    wu = dot(w, u)
    wv = dot(w, v)
    # Corner, edge or inside, with one division at most: Ericson, Real-Time Collision Detection, 5.1.5.
    if wu <= 0 and wv <= 0:
        return 1.0, 0.0, 0.0
    bu, bv = wu - uu, wv - uv
    if bu >= 0 and bv <= bu:
        return 0.0, 1.0, 0.0
    cu, cv = wu - uv, wv - vv
    if cv >= 0 and cu <= cv:
        return 0.0, 0.0, 1.0
    # The weights, times the square of twice the area.
    area2, second, third = uu * vv - uv * uv, vv * wu - uv * wv, uu * wv - uv * wu
    first = area2 - second - third
    if third <= 0 and wu > 0 and bu <= 0:
        s = wu / uu
        return 1 - s, s, 0.0
    if second <= 0 and wv > 0 and cv <= 0:
        s = wv / vv
        return 1 - s, 0.0, s
    if first <= 0 and bv > bu and cu >= cv:
        s = (bv - bu) / ((bv - bu) + (cu - cv))
        return 0.0, 1 - s, s
    if not (area2 <= 1e-14 * uu * vv or min(first, min(second, third)) < 0):
        return scale((first, second, third), 1 / area2)
    # It is too flat to have an inside. Edges are compared by their squared distances from p, less that of corner a.
    s = min(wu / uu, 1.0) if wu > 0 else 0.0
    t = min(wv / vv, 1.0) if wv > 0 else 0.0
    along = wv - wu + uu - uv
    size = uu - 2 * uv + vv
    r = min(along / size, 1.0) if along > 0 and size > 0 else 0.0
    ab, ac = s * (s * uu - 2 * wu), t * (t * vv - 2 * wv)
    bc = (1 - r) * ((1 - r) * uu - 2 * wu) + r * (r * vv - 2 * wv) + 2 * r * (1 - r) * uv
    if ab <= ac and ab <= bc:
        return 1 - s, s, 0.0
    if ac <= bc:
        return 1 - t, 0.0, t
    return 0.0, 1 - r, r


@inner
def _try_leaf(tree: Any, leaf: int, point: Vec3, found: Any) -> None:
    """Writes the closest point on a leaf's triangles, in the leaf's frame, to `found` if it is closer than that.
    `found` is a RESULT with the squared distance in the place of the distance."""
    starts, _, frames, triangles, around = tree
    p = mul(matrix(frames[leaf]), point)
    for t in range(starts[leaf], starts[leaf + 1]):
        if _gap2(around, t, p) < found[0]:
            a, b, c = vector(triangles[t, 0]), vector(triangles[t, 1]), vector(triangles[t, 2])
            weights = _weights(a, b, c, p)
            closest = add(add(scale(a, weights[0]), scale(b, weights[1])), scale(c, weights[2]))
            gap = sub(p, closest)
            if dot(gap, gap) < found[0]:
                found[0] = dot(gap, gap)
                found[7] = t
                store(closest, found[1:4])
                store(weights, found[4:7])


@entry
def closest(points: Any, within: float, tree: Any, out: Any) -> None:
    """Writes the closest points of points (n, 3) to `out` (n, 8), see RESULT; a distance above `within` is infinite.

    `within` [m]. `tree`: `starts` (p + 1), `boxes` (2p - 1, 6) and `frames` (p, 3, 3) of p leaves; in their frames
    `triangles` (m, 3, 3) and the box `around` each (m, 6).
    """
    starts, boxes, frames, _, _ = tree
    leaves = len(starts) - 1
    waiting, gaps = np.empty(64, np.int64), np.empty(64)  # one box for each level of the tree waits at most
    last = 0
    for i in range(len(points)):
        p = vector(points[i])
        found = out[i]
        found[0] = within * within
        found[7] = -1.0
        # Points are in an order in which neighbours follow each other, so that the last leaf bounds the search well.
        _try_leaf(tree, last, p, found)
        waiting[0] = 0
        gaps[0] = _gap2(boxes, 0, p)
        count = 1
        while count:
            count -= 1
            k = waiting[count]
            if gaps[count] >= found[0]:
                continue
            leaf = k - leaves + 1
            if leaf >= 0:
                before = found[0]
                _try_leaf(tree, leaf, p, found)
                if found[0] < before:
                    last = leaf
                continue
            near, far = 2 * k + 1, 2 * k + 2
            near_gap, far_gap = _gap2(boxes, near, p), _gap2(boxes, far, p)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            waiting[count], gaps[count] = far, far_gap
            waiting[count + 1], gaps[count + 1] = near, near_gap
            count += 2
        if found[7] < 0:
            found[0] = np.inf
        else:
            found[0] = np.sqrt(found[0])
            store(tmul(matrix(frames[last]), vector(found[1:4])), found[1:4])
