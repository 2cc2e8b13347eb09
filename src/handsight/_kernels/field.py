"""Distance, gradient and Hessian of an object's field at a point.

Twins: `evaluate` of `handsight.objects.field.GridField` and of the fields in `handsight.objects.exact`. Every
function answers ten numbers: distance, gradient (x, y, z), Hessian (xx, xy, xz, yy, yz, zz), object's frame.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.layout import (
    BOX,
    CELL,
    CYLINDER,
    GRID,
    INVERSE_CELL,
    KIND,
    LEAST,
    NODES,
    ORIGIN,
    SHAPE,
)  # fmt: skip
from handsight._kernels.vectors import spline

Ten = tuple[float, float, float, float, float, float, float, float, float, float]


@inner
def look(model: Any, singles: Any, at: int, x: float, y: float, z: float) -> Ten:
    """The field whose numbers begin at `model[at]`."""
    kind = int(model[at + KIND])
    if kind == GRID:
        return _grid(model, singles, at, x, y, z)
    if kind == BOX:
        return _box(model, at, x, y, z)
    if kind == CYLINDER:
        return _cylinder(model, at, x, y, z)
    return _sphere(model, at, x, y, z)


@inner
def _grid(model: Any, singles: Any, at: int, x: float, y: float, z: float) -> Ten:
    inverse = model[at + INVERSE_CELL]
    u = (x - model[at + ORIGIN]) * inverse
    v = (y - model[at + ORIGIN + 1]) * inverse
    w = (z - model[at + ORIGIN + 2]) * inverse
    nx, ny, nz = int(model[at + SHAPE]), int(model[at + SHAPE + 1]), int(model[at + SHAPE + 2])
    cu, cv, cw = _clamped(u, nx - 2.0), _clamped(v, ny - 2.0), _clamped(w, nz - 2.0)
    i, j, k = int(min(cu, nx - 3.0)), int(min(cv, ny - 3.0)), int(min(cw, nz - 3.0))
    first = int(model[at + NODES]) + ((i - 1) * ny + j - 1) * nz + k - 1
    d, gx, gy, gz, xx, xy, xz, yy, yz, zz = spline(singles, first, ny * nz, nz, cu - i, cv - j, cw - k)
    s, t = inverse, inverse * inverse
    edge = (d, gx * s, gy * s, gz * s, xx * t, xy * t, xz * t, yy * t, yz * t, zz * t)
    if u == cu and v == cv and w == cw:
        return edge
    cell = model[at + CELL]
    return _beyond(edge, (u - cu) * cell, (v - cv) * cell, (w - cw) * cell)


@inner
def _clamped(u: float, most: float) -> float:
    """Between 1 and `most`; a NaN reads no memory beyond the grid either, and `_beyond` passes it on."""
    low = u if u > 1.0 else 1.0
    return low if low < most else most


@inner
def _beyond(edge: Ten, x: float, y: float, z: float) -> Ten:
    """The field a way (x, y, z) outside the grid, from its values at the edge."""
    m, gx, gy, gz, xx, xy, xz, yy, yz, zz = edge
    slope = gx * x + gy * y + gz * z
    still = x == 0 and y == 0 and z == 0
    # Along what is free of the grid's edge the gradient there counts; across it, the way itself.
    ax = xx * x + xy * y + xz * z if x == 0 else 0.0
    ay = xy * x + yy * y + yz * z if y == 0 else 0.0
    az = xz * x + yz * y + zz * z if z == 0 else 0.0
    px, py, pz = gx + ax, gy + ay, gz + az
    if still:
        return edge
    if not m > 0:
        return (m + slope, px, py, pz, xx, xy, xz, yy, yz, zz)
    f = np.sqrt(max(m * m + 2 * m * slope + (x * x + y * y + z * z), 1e-300))
    sx = gx * slope if x == 0 else 0.0
    sy = gy * slope if y == 0 else 0.0
    sz = gz * slope if z == 0 else 0.0
    hx, hy, hz = (m * px + sx + x) / f, (m * py + sy + y) / f, (m * pz + sz + z) / f
    size = max(hx * hx + hy * hy + hz * hz, 1e-12)
    return (
        f, hx, hy, hz,
        (1 - hx * hx / size) / f, -hx * hy / size / f, -hx * hz / size / f,
        (1 - hy * hy / size) / f, -hy * hz / size / f, (1 - hz * hz / size) / f,
    )  # fmt: skip


@inner
def _sphere(model: Any, at: int, x: float, y: float, z: float) -> Ten:
    r = np.sqrt(x * x + y * y + z * z)
    gx, gy, gz = 0.0, 0.0, 1.0
    if r > 0 or r != r:
        gx, gy, gz = x / r, y / r, z / r
    bend = 1 / max(r, model[at + LEAST])
    return (
        r - model[at + ORIGIN], gx, gy, gz,
        (1 - gx * gx) * bend, -gx * gy * bend, -gx * gz * bend,
        (1 - gy * gy) * bend, -gy * gz * bend, (1 - gz * gz) * bend,
    )  # fmt: skip


@inner
def _box(model: Any, at: int, x: float, y: float, z: float) -> Ten:
    qx, qy, qz = abs(x) - model[at + ORIGIN], abs(y) - model[at + ORIGIN + 1], abs(z) - model[at + ORIGIN + 2]
    sx, sy, sz = -1.0 if x < 0 else 1.0, -1.0 if y < 0 else 1.0, -1.0 if z < 0 else 1.0
    largest = max(qx, max(qy, qz))
    if not largest > 0:
        fx = 1.0 if qx == largest else 0.0
        fy = 1.0 if qy == largest and fx == 0 else 0.0
        fz = 1.0 - fx - fy
        return (largest, fx * sx, fy * sy, fz * sz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    # Scaled by the largest, so that the direction survives a distance of 1e-170.
    ex, ey, ez = max(qx, 0.0) / largest, max(qy, 0.0) / largest, max(qz, 0.0) / largest
    size = np.sqrt(ex * ex + ey * ey + ez * ez)
    gx, gy, gz = ex / size * sx, ey / size * sy, ez / size * sz
    outside = size * largest
    bend = 1 / max(outside, model[at + LEAST])
    dx, dy, dz = 1.0 if qx > 0 else 0.0, 1.0 if qy > 0 else 0.0, 1.0 if qz > 0 else 0.0
    return (
        outside, gx, gy, gz,
        (dx - gx * gx) * bend, -gx * gy * bend, -gx * gz * bend,
        (dy - gy * gy) * bend, -gy * gz * bend, (dz - gz * gz) * bend,
    )  # fmt: skip


@inner
def _cylinder(model: Any, at: int, x: float, y: float, z: float) -> Ten:
    r = np.sqrt(x * x + y * y)
    qr, qz = r - model[at + ORIGIN], abs(z) - model[at + ORIGIN + 1]
    up = -1.0 if z < 0 else 1.0
    cosine, sine = 1.0, 0.0
    if r > 0 or r != r:
        cosine, sine = x / r, y / r
    er, ez = max(qr, 0.0), max(qz, 0.0)
    outside = np.sqrt(er * er + ez * ez)
    distance, gr, gz = max(qr, qz), 1.0 if qr >= qz else 0.0, 0.0 if qr >= qz else 1.0
    if outside > 0:
        distance, gr, gz = outside, er / outside, ez / outside
    gz = gz * up
    least = model[at + LEAST]
    around = gr / max(r, least)
    over = 1 / max(outside, least) if qr > 0 and qz > 0 else 0.0
    # The rim's direction across its edge.
    rx, ry, rz = -gz * cosine, -gz * sine, gr
    return (
        distance, gr * cosine, gr * sine, gz,
        around * sine * sine + over * rx * rx, -around * sine * cosine + over * rx * ry, over * rx * rz,
        around * cosine * cosine + over * ry * ry, over * ry * rz, over * rz * rz,
    )  # fmt: skip


@inner
def _one(model: Any, singles: Any, at: int, points: Any, k: int, values: Any) -> None:
    d, gx, gy, gz, xx, xy, xz, yy, yz, zz = look(model, singles, at, points[k, 0], points[k, 1], points[k, 2])
    row = values[k]
    row[0], row[1], row[2], row[3] = d, gx, gy, gz
    row[4], row[5], row[6] = xx, xy, xz
    row[7], row[8], row[9] = xy, yy, yz
    row[10], row[11], row[12] = xz, yz, zz


@entry
def evaluate(model: Any, singles: Any, at: int, points: Any, values: Any, start: int, stop: int) -> None:
    """`values` (n, 13): distance, gradient and full Hessian at some of the points (n, 3)."""
    for k in range(start, stop):
        _one(model, singles, at, points, k, values)
