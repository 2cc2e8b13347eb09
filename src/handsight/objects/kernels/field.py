"""Distance [m], gradient and Hessian [1/m] of an object's distance field at a point of the object's frame.

A grid is interpolated by cubic B-splines and continued beyond its edge; boxes, cylinders and spheres are exact. A sheet
is a grid around a surface that has two sides and no inside. Its distances are negative behind it, so that beyond its
rim, where both sides meet without a surface between them, the sign jumps and the distance is not zero.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.records import BOX, CYLINDER, GRID, NODES, SHEET
from handsight._compiled.stack import local
from handsight._compiled.vec3 import (
    Mat33,
    Vec3,
    add,
    add33,
    dot,
    mul,
    norm,
    outer,
    scale,
    scale33,
    sub,
    sub33,
    vector,
)
from handsight.objects.kernels.spline import spline

Values = tuple[float, Vec3, Mat33]
Ten = tuple[float, float, float, float, float, float, float, float, float, float]
FLAT: Mat33 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
RIM_MARGIN = 1.02
"""Two nodes are on one side of a sheet if their distances to it add up to more than their gap times this, plus its
`blur`: then no surface is between them."""


@inner
def field_at(nodes: Any, field: Any, place: Vec3) -> Values:
    """Returns distance, gradient and Hessian of one field; `nodes` are those of all grids of the object."""
    if field.kind == GRID:
        (first, past, beyond), nz = _cell(field, place), field.shape[2]
        return _in_metres(field, spline(nodes, first, field.shape[1] * nz, nz, past), beyond)
    if field.kind == BOX:
        return _box(field, place)
    if field.kind == CYLINDER:
        return _cylinder(field, place)
    if field.kind == SHEET:
        return _sheet(nodes, field, place)
    r = norm(place)
    g = scale(place, 1 / r) if r > 0 or r != r else (0.0, 0.0, 1.0)
    return r - field.origin[0], g, _around(g, 1 / max(r, field.least_radius))


@inner
def _sheet(nodes: Any, field: Any, place: Vec3) -> Values:
    """Returns what a grid does, after nodes with no surface between them and the nearest one got that one's sign. For
    every grid this would take a fifth more time."""
    first, past, beyond = _cell(field, place)
    step_x = field.shape[1] * field.shape[2]
    step_y = field.shape[2]
    own = local(NODES)
    x, y, z = 2 if past[0] > 0.5 else 1, 2 if past[1] > 0.5 else 1, 2 if past[2] > 0.5 else 1
    nearest = nodes[first + x * step_x + y * step_y + z]
    for i in range(4):
        for j in range(4):
            for k in range(4):
                value = nodes[first + i * step_x + j * step_y + k]
                gap2 = (RIM_MARGIN * field.cell) ** 2 * ((i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2)
                over = abs(value - nearest) - field.blur
                if value * nearest < 0 and over > 0 and over * over > gap2:
                    value = -value
                own.values[16 * i + 4 * j + k] = value
    return _in_metres(field, spline(own.values, 0, 16, 4, past), beyond)


@inner
def _cell(field: Any, place: Vec3) -> tuple[int, Vec3, Vec3]:
    """Returns the index of the first of the 4 x 4 x 4 nodes around a place, and how far the place is past the second
    node and beyond the grid [cells]."""
    u = scale(sub(place, vector(field.origin)), field.inverse_cell)
    nx, ny, nz = field.shape[0], field.shape[1], field.shape[2]
    inside = clamped(u[0], 1.0, nx - 2.0), clamped(u[1], 1.0, ny - 2.0), clamped(u[2], 1.0, nz - 2.0)
    i, j, k = int(min(inside[0], nx - 3.0)), int(min(inside[1], ny - 3.0)), int(min(inside[2], nz - 3.0))
    first = field.nodes + ((i - 1) * ny + j - 1) * nz + k - 1
    return first, (inside[0] - i, inside[1] - j, inside[2] - k), sub(u, inside)


@inner
def _in_metres(field: Any, ten: Ten, beyond: Vec3) -> Values:
    """Returns distance, gradient and Hessian from the ten numbers of `spline`, `beyond` the grid's edge [cells]."""
    d, gx, gy, gz, xx, xy, xz, yy, yz, zz = ten
    inverse = field.inverse_cell
    hessian = scale33(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), inverse * inverse)
    edge = d, scale((gx, gy, gz), inverse), hessian
    if beyond[0] == 0 and beyond[1] == 0 and beyond[2] == 0:
        return edge
    return _beyond(edge, scale(beyond, field.cell))


@inner
def clamped(u: float, least: float, most: float) -> float:
    """Returns u limited to a range; of a NaN, the least, so that nothing beyond a grid is read."""
    low = u if u > least else least
    return low if low < most else most


@inner
def _where_zero(way: Vec3, v: Vec3) -> Vec3:
    """Returns `v` with zeros along the axes along which `way` is not zero."""
    x, y, z = way
    return v[0] if x == 0 else 0.0, v[1] if y == 0 else 0.0, v[2] if z == 0 else 0.0


@inner
def _beyond(edge: Values, way: Vec3) -> Values:
    """Returns the field outside the grid, `way` [m] from the edge, where its values are `edge`."""
    # Behind a sheet all of it is negated.
    side = -1.0 if edge[0] < 0 else 1.0
    m = side * edge[0]
    g = scale(edge[1], side)
    H = scale33(edge[2], side)
    slope = dot(g, way)
    # Along the grid's edge the gradient changes by the Hessian; across it, the way is added below.
    p = add(g, _where_zero(way, mul(H, way)))
    if not m > 0:
        return m + slope, p, H  # NaN in, NaN out
    f = np.sqrt(max(m * m + 2 * m * slope + dot(way, way), 1e-300))
    h = scale(add(add(scale(p, m), _where_zero(way, scale(g, slope))), way), 1 / f)
    bend = _around(scale(h, 1 / np.sqrt(max(dot(h, h), 1e-12))), side / f)
    return side * f, scale(h, side), bend


@inner
def _around(n: Vec3, curvature: float) -> Mat33:
    """Returns the Hessian of the distance to a ball, (1 - n nᵀ) times its curvature."""
    return scale33(sub33(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), outer(n, n)), curvature)


@inner
def _box(field: Any, place: Vec3) -> Values:
    x, y, z = place
    qx, qy, qz = abs(x) - field.origin[0], abs(y) - field.origin[1], abs(z) - field.origin[2]
    sx, sy, sz = -1.0 if x < 0 else 1.0, -1.0 if y < 0 else 1.0, -1.0 if z < 0 else 1.0
    largest = max(qx, max(qy, qz))
    if not largest > 0:
        fx = 1.0 if qx == largest else 0.0
        fy = 1.0 if qy == largest and fx == 0 else 0.0
        return largest, (fx * sx, fy * sy, (1.0 - fx - fy) * sz), FLAT
    # Divided by the largest, so that a distance of 1e-170 m still has a direction.
    e = max(qx, 0.0) / largest, max(qy, 0.0) / largest, max(qz, 0.0) / largest
    size = norm(e)
    g = e[0] / size * sx, e[1] / size * sy, e[2] / size * sz
    outside = size * largest
    dx, dy, dz = 1.0 if qx > 0 else 0.0, 1.0 if qy > 0 else 0.0, 1.0 if qz > 0 else 0.0
    free = (dx, 0.0, 0.0), (0.0, dy, 0.0), (0.0, 0.0, dz)
    return outside, g, scale33(sub33(free, outer(g, g)), 1 / max(outside, field.least_radius))


@inner
def _cylinder(field: Any, place: Vec3) -> Values:
    x, y, z = place
    r = np.sqrt(x * x + y * y)
    qr = r - field.origin[0]
    qz = abs(z) - field.origin[1]
    up = -1.0 if z < 0 else 1.0
    cosine, sine = (x / r, y / r) if r > 0 or r != r else (1.0, 0.0)
    er, ez = max(qr, 0.0), max(qz, 0.0)
    outside = np.sqrt(er * er + ez * ez)
    distance = max(qr, qz)
    gr = 1.0 if qr >= qz else 0.0
    gz = 0.0 if qr >= qz else 1.0
    if outside > 0:
        distance = outside
        gr = er / outside
        gz = ez / outside
    gz = gz * up
    over = 1 / max(outside, field.least_radius) if qr > 0 and qz > 0 else 0.0
    side = (-sine, cosine, 0.0)
    rim = (-gz * cosine, -gz * sine, gr)  # across the edge
    around = scale33(outer(side, side), gr / max(r, field.least_radius))
    return distance, (gr * cosine, gr * sine, gz), add33(around, scale33(outer(rim, rim), over))


@entry
def evaluate(nodes: Any, field: Any, points: Any, values: Any) -> None:
    """Writes to `values` (n, 13) distance, gradient and Hessian of `field` (1,) FIELD at points (n, 3)."""
    for k in range(len(points)):
        d, g, H = field_at(nodes, field[0], vector(points[k]))
        row = values[k]
        row[0] = d
        for i in range(3):
            row[1 + i] = g[i]
            for j in range(3):
                row[4 + 3 * i + j] = H[i][j]
