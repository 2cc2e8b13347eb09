"""How often a surface winds around points."""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import Vec3, cross, dot, norm, sub, vector
from handsight._kernels.runtime.compilation import entry, inner
from handsight._kernels.runtime.threads import in_parts

FAR_PATCH, FAR_TRIANGLE = 2.0, 4.0
"""A patch, a triangle is one dipole beyond this many of its radii."""
_LEAST = 200


@inner
def _solid_angle(a: Vec3, b: Vec3, c: Vec3) -> float:
    """Returns the solid angle of a triangle seen from the origin, signed (Oosterom, Strackee 1983)."""
    la, lb, lc = norm(a), norm(b), norm(c)
    volume = dot(a, cross(b, c))
    return 2 * np.arctan2(volume, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


@inner
def _near(elements: Any, first: int, last: int, p: Vec3) -> float:
    """Returns the sum of solid angles of the elements from first to last."""
    centers, vectors, reach, corners = elements
    total = 0.0
    for t in range(first, last):
        way = sub(vector(centers[t]), p)
        gap = norm(way)
        if len(corners) and gap < FAR_TRIANGLE * reach[t]:
            a, b, c = vector(corners[t, 0]), vector(corners[t, 1]), vector(corners[t, 2])
            total += _solid_angle(sub(a, p), sub(b, p), sub(c, p))
        elif gap > 0:
            total += dot(vector(vectors[t]), way) / (gap * gap * gap)
    return total


@entry
def winding(points: Any, patches: Any, elements: Any, out: Any) -> None:
    """Fills `out` (n) with winding numbers at the points (n, 3).

    `patches`: `starts` (p + 1), `middles` (p, 3), `vectors` (p, 3), `radii` (p); `elements`: `centers` (m, 3),
    `vectors` (m, 3), `reach` (m), `corners` (m, 3, 3) or of points (0, 3, 3).
    """
    starts, middles, vectors, radii = patches
    for i in range(len(points)):
        p, total = vector(points[i]), 0.0
        for k in range(len(middles)):
            way = sub(vector(middles[k]), p)
            gap2 = dot(way, way)
            if gap2 <= (FAR_PATCH * radii[k]) ** 2:
                total += _near(elements, starts[k], starts[k + 1], p)
            else:
                total += dot(vector(vectors[k]), way) / (gap2 * np.sqrt(gap2))
        out[i] = total / (4 * np.pi)


def winding_at(points: Any, patches: Any, elements: Any) -> Any:
    """Returns what `winding` writes (n,), on several threads."""
    out = np.zeros(len(points))
    in_parts(lambda some, there: winding(some, patches, elements, there), (points, out), _LEAST)
    return out


def warm() -> None:
    """Compiles every kernel, or loads it."""
    one, row = np.zeros(1), np.zeros((1, 3))
    patches = np.array([0, 1]), row, row, one
    winding(row, patches, (row, row, one, np.zeros((1, 3, 3))), one)
