"""A cubic B-spline of a grid, with its derivatives by grid coordinates.

The 4 x 4 x 4 nodes in use are contracted along x and y, for all four places along z, and then along z.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.records import record
from handsight._compiled.stack import local

Four = tuple[float, float, float, float]
Ten = tuple[float, float, float, float, float, float, float, float, float, float]
SIXTH = 1 / 6.0
ALONG_Z = record(("value", "f8", (4,)), ("slope", "f8", (4,)), ("bend", "f8", (4,)))


@inner
def spline(values: Any, first: int, step_x: int, step_y: int, past: tuple[float, float, float]) -> Ten:
    """Returns value, gradient (x, y, z) and Hessian (xx, xy, xz, yy, yz, zz).

    `values`: nodes, float32, z fastest. `first`: index of the first of the 4 x 4 x 4 nodes in use. `step_x`, `step_y`:
    from an index to its neighbour along x and y. `past`: distance past the second node along x, y and z, 0 to 1.
    """
    x, y, z = _weights(past[0]), _weights(past[1]), _weights(past[2])
    along = local(ALONG_Z)
    _fill(along.value, z[0])
    _fill(along.slope, z[1])
    _fill(along.bend, z[2])
    d = dx = dy = dz = dxx = dxy = dxz = dyy = dyz = dzz = 0.0
    # Signed indices could be negative, which count from the end; of unsigned ones the compiler does four at once.
    start, far_x, far_y = np.uint64(first), np.uint64(step_x), np.uint64(step_y)
    for k in range(np.uint64(4)):
        at_a = start + k
        at_b = at_a + far_y
        at_c = at_b + far_y
        a = _line(values, at_a, far_x, x)
        b = _line(values, at_b, far_x, x)
        c = _line(values, at_c, far_x, x)
        e = _line(values, at_c + far_y, far_x, x)
        at = _mixed(y[0], a[0], b[0], c[0], e[0])
        by_x = _mixed(y[0], a[1], b[1], c[1], e[1])
        by_y = _mixed(y[1], a[0], b[0], c[0], e[0])
        value, slope = along.value[k], along.slope[k]
        d += value * at
        dx += value * by_x
        dy += value * by_y
        dz += slope * at
        dxx += value * _mixed(y[0], a[2], b[2], c[2], e[2])
        dxy += value * _mixed(y[1], a[1], b[1], c[1], e[1])
        dxz += slope * by_x
        dyy += value * _mixed(y[2], a[0], b[0], c[0], e[0])
        dyz += slope * by_y
        dzz += along.bend[k] * at
    return d, dx, dy, dz, dxx, dxy, dxz, dyy, dyz, dzz


@inner
def _weights(f: float) -> tuple[Four, Four, Four]:
    """Returns the weights of four nodes at a distance past the second one, and their first and second derivatives."""
    g = 1.0 - f
    value = (
        g * g * g * SIXTH,
        (4.0 - f * f * (6.0 - 3.0 * f)) * SIXTH,
        (4.0 - g * g * (6.0 - 3.0 * g)) * SIXTH,
        f * f * f * SIXTH,
    )
    slope = -0.5 * g * g, f * (1.5 * f - 2.0), g * (2.0 - 1.5 * g), 0.5 * f * f
    return value, slope, (g, 3.0 * f - 2.0, 3.0 * g - 2.0, f)


@inner
def _fill(out: Any, four: Four) -> None:
    out[0], out[1], out[2], out[3] = four


@inner
def _line(
    values: Any, first: np.uint64, step: np.uint64, x: tuple[Four, Four, Four]
) -> tuple[float, float, float]:
    """Returns, of four nodes in a line, the value and its first and second derivative."""
    third = first + step + step
    a = float(values[first])
    b = float(values[first + step])
    c = float(values[third])
    d = float(values[third + step])
    return _mixed(x[0], a, b, c, d), _mixed(x[1], a, b, c, d), _mixed(x[2], a, b, c, d)


@inner
def _mixed(weights: Four, a: float, b: float, c: float, d: float) -> float:
    return weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d
