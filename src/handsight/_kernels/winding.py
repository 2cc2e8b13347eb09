"""How often a surface winds around points. Twin: `handsight.objects._plain.winding`."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.threads import in_parts

FAR_PATCH, FAR_TRIANGLE = 2.0, 4.0
"""A patch, a triangle is one dipole beyond this many of its radii."""
_LEAST = 200


@inner
def _solid_angle(T: Any, t: int, x: float, y: float, z: float) -> float:
    """Of triangle t seen from (x, y, z), signed (Oosterom, Strackee 1983)."""
    ax, ay, az = T[t, 0, 0] - x, T[t, 0, 1] - y, T[t, 0, 2] - z
    bx, by, bz = T[t, 1, 0] - x, T[t, 1, 1] - y, T[t, 1, 2] - z
    cx, cy, cz = T[t, 2, 0] - x, T[t, 2, 1] - y, T[t, 2, 2] - z
    a = np.sqrt(ax * ax + ay * ay + az * az)
    b = np.sqrt(bx * bx + by * by + bz * bz)
    c = np.sqrt(cx * cx + cy * cy + cz * cz)
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
    return 2 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)


@inner
def _near(elements: Any, first: int, last: int, x: float, y: float, z: float) -> float:
    """Solid angles of the elements from first to last."""
    centers, vectors, reach, corners = elements
    total = 0.0
    for t in range(first, last):
        dx, dy, dz = centers[t, 0] - x, centers[t, 1] - y, centers[t, 2] - z
        gap = np.sqrt(dx * dx + dy * dy + dz * dz)
        if len(corners) and gap < FAR_TRIANGLE * reach[t]:
            total += _solid_angle(corners, t, x, y, z)
        elif gap > 0:
            total += (vectors[t, 0] * dx + vectors[t, 1] * dy + vectors[t, 2] * dz) / (gap * gap * gap)
    return total


@entry
def winding(points: Any, patches: Any, elements: Any, out: Any) -> None:
    """`out` (n): winding numbers at the points (n, 3).

    `patches`: `starts` (p + 1), `middles` (p, 3), `vectors` (p, 3), `radii` (p); `elements`: `centers` (m, 3),
    `vectors` (m, 3), `reach` (m), `corners` (m, 3, 3) or of points (0, 3, 3).
    """
    starts, middles, vectors, radii = patches
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total = 0.0
        for p in range(len(middles)):
            dx, dy, dz = middles[p, 0] - x, middles[p, 1] - y, middles[p, 2] - z
            gap2 = dx * dx + dy * dy + dz * dz
            if gap2 <= (FAR_PATCH * radii[p]) ** 2:
                total += _near(elements, starts[p], starts[p + 1], x, y, z)
            else:
                along = vectors[p, 0] * dx + vectors[p, 1] * dy + vectors[p, 2] * dz
                total += along / (gap2 * np.sqrt(gap2))
        out[i] = total / (4 * np.pi)


def winding_at(points: Any, patches: Any, elements: Any) -> Any:
    """As `winding` (n,), on several threads."""
    out = np.zeros(len(points))
    in_parts(lambda a, b: winding(points[a:b], patches, elements, out[a:b]), len(points), _LEAST)
    return out


def warm() -> None:
    """Compiles every kernel, or loads it."""
    one, row = np.zeros(1), np.zeros((1, 3))
    patches = np.array([0, 1]), row, row, one
    winding(row, patches, (row, row, one, np.zeros((1, 3, 3))), one)
