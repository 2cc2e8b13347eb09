"""Winding numbers: how many times a surface winds around a point."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.vec3 import Vec3, cross, dot, norm, sub, vector

FAR_PATCH = 2.0
FAR_TRIANGLE = 4.0
"""At a distance of this many of its radii, a patch or a triangle is approximated by one dipole."""


@inner
def _near(elements: Any, first: int, last: int, p: Vec3) -> float:
    """Returns the sum of the signed solid angles of the elements from number `first` to `last`, exclusive, seen from p
    (Oosterom, Strackee 1983)."""
    centers, vectors, reach, corners = elements
    total = 0.0
    for t in range(first, last):
        way = sub(vector(centers[t]), p)
        gap = norm(way)
        if len(corners) and gap < FAR_TRIANGLE * reach[t]:
            a, b = sub(vector(corners[t, 0]), p), sub(vector(corners[t, 1]), p)
            c = sub(vector(corners[t, 2]), p)
            la, lb, lc = norm(a), norm(b), norm(c)
            size = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
            total += 2 * np.arctan2(dot(a, cross(b, c)), size)
        elif gap > 0:
            total += dot(vector(vectors[t]), way) / (gap * gap * gap)
    return total


@entry
def winding(points: Any, patches: Any, elements: Any, out: Any) -> None:
    """Writes to `out` (n) the winding numbers of a surface at points (n, 3).

    `elements`, triangles or the points of a cloud: `centers` (m, 3), area `vectors` (m, 3), `reach` (m) (radii), and
    `corners` (m, 3, 3), of points (0, 3, 3). `patches` of elements: `starts` (p + 1), `middles` (p, 3), area `vectors`
    (p, 3) and `radii` (p).
    """
    starts, middles, vectors, radii = patches
    for i in range(len(points)):
        p = vector(points[i])
        total = 0.0
        for k in range(len(middles)):
            way = sub(vector(middles[k]), p)
            gap2 = dot(way, way)
            if gap2 <= (FAR_PATCH * radii[k]) ** 2:
                total += _near(elements, starts[k], starts[k + 1], p)
            else:
                total += dot(vector(vectors[k]), way) / (gap2 * np.sqrt(gap2))
        out[i] = total / (4 * np.pi)
