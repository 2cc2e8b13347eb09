"""Depth images of triangles, by a depth buffer.

Along a triangle one over the depth is linear in the image. Edges are drawn straight, so that through a lens triangles
must be small in the image.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.pinhole import project
from handsight._compiled.vec3 import Vec3, add, scale, sub, vector

NEAR = 0.01  # parts of triangles nearer to the camera than this are not drawn [m]


@inner
def _corner(camera: Any, point: Vec3) -> Vec3:
    """Returns column, row and one over the depth."""
    u, v = project(camera, point)
    return u, v, 1 / point[2]


@inner
def _span(v: float, a: Vec3, b: Vec3, left: float, right: float) -> tuple[float, float]:
    """Returns the first and the last column of a row, widened to where the edge from a to b crosses the row."""
    if not min(a[1], b[1]) <= v <= max(a[1], b[1]):
        return left, right
    if a[1] == b[1]:
        return min(left, min(a[0], b[0])), max(right, max(a[0], b[0]))
    u = a[0] + (v - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    return min(left, u), max(right, u)


@inner
def _fill(depth: Any, drawn: Any, label: int, a: Vec3, b: Vec3, c: Vec3) -> None:
    """Draws one triangle with corners (column, row, one over depth)."""
    height, width = depth.shape
    ab, ac = sub(b, a), sub(c, a)
    twice = ab[0] * ac[1] - ab[1] * ac[0]
    if not 0 < abs(twice) < np.inf:
        return
    by_u, by_v = (ab[2] * ac[1] - ac[2] * ab[1]) / twice, (ac[2] * ab[0] - ab[2] * ac[0]) / twice
    top = int(np.ceil(max(min(a[1], min(b[1], c[1])), 0.0)))
    below = int(np.floor(min(max(a[1], max(b[1], c[1])), height - 1.0)))
    for v in range(top, below + 1):
        left, right = _span(v, a, b, np.inf, -np.inf)
        left, right = _span(v, b, c, left, right)
        left, right = _span(v, c, a, left, right)
        if not left <= right:
            continue
        first = int(np.ceil(max(left, 0.0)))
        last = int(np.floor(min(right, width - 1.0)))
        inverse = a[2] + (first - a[0]) * by_u + (v - a[1]) * by_v
        for u in range(first, last + 1):
            if inverse > 0 and inverse * depth[v, u] > 1:
                depth[v, u] = 1 / inverse
                drawn[v, u] = label
            inverse += by_u


@inner
def _cut(inside: Vec3, outside: Vec3) -> Vec3:
    """Returns where an edge crosses the plane at depth `NEAR`."""
    t = (inside[2] - NEAR) / (inside[2] - outside[2])
    x, y, _ = add(inside, scale(sub(outside, inside), t))
    return x, y, NEAR


@entry
def draw(camera: Any, vertices: Any, faces: Any, labels: Any, depth: Any, drawn: Any) -> None:
    """Draws faces (m, 3) of vertices (k, 3) in the camera into `depth` (h, w) [m], which is infinite where nothing is,
    and the label (m,) of the nearest face into `drawn` (h, w). Of a face the part beyond `NEAR` is drawn."""
    for m in range(len(faces)):
        a, b, c = vector(vertices[faces[m, 0]]), vector(vertices[faces[m, 1]]), vector(vertices[faces[m, 2]])
        for _ in range(2):  # rotate until the first corner is beyond, if any is
            if not a[2] > NEAR:
                a, b, c = b, c, a
        if not a[2] > NEAR:
            continue
        if not b[2] > NEAR and c[2] > NEAR:
            a, b, c = c, a, b
        end = c
        has_end = False
        if not b[2] > NEAR:
            b, c = _cut(a, b), _cut(a, c)
        elif not c[2] > NEAR:
            c, end, has_end = _cut(b, c), _cut(a, c), True
        first, third = _corner(camera[0], a), _corner(camera[0], c)
        _fill(depth, drawn, labels[m], first, _corner(camera[0], b), third)
        if has_end:
            _fill(depth, drawn, labels[m], first, third, _corner(camera[0], end))
