"""Where bodies on chains of joints are, and how they move.

A chain is a product of exponentials: each joint's axis stands in the base's frame as it lies when all joints are at
their zero, and the body's pose then is its `home`. What comes first in the chain moves what comes after.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner

STEP = 8
"""Numbers for each joint of a chain: unit axis (3), a point on it (3), its position at zero, 1 where it slides."""


@inner
def _turned(x: float, y: float, z: float, a: Any, sine: float, cosine: float) -> Any:
    """The vector (x, y, z) turned about the unit axis `a` (Rodrigues)."""
    along = (1 - cosine) * (a[0] * x + a[1] * y + a[2] * z)
    return (
        cosine * x + sine * (a[1] * z - a[2] * y) + along * a[0],
        cosine * y + sine * (a[2] * x - a[0] * z) + along * a[1],
        cosine * z + sine * (a[0] * y - a[1] * x) + along * a[2],
    )


@inner
def _placed(X: Any, Y: Any, Z: Any, x: float, y: float, z: float) -> Any:
    """The vector (x, y, z) of a frame whose axes are X, Y and Z."""
    return (
        X[0] * x + Y[0] * y + Z[0] * z,
        X[1] * x + Y[1] * y + Z[1] * z,
        X[2] * x + Y[2] * y + Z[2] * z,
    )


@inner
def _last(T: Any, home: Any, X: Any, Y: Any, Z: Any, p: Any) -> None:
    """Puts the pose (X, Y, Z, p) times `home` into T."""
    for c in range(4):
        x, y, z = _placed(X, Y, Z, home[0, c], home[1, c], home[2, c])
        T[0, c], T[1, c], T[2, c] = x, y, z
        T[3, c] = 0.0
    T[0, 3] += p[0]
    T[1, 3] += p[1]
    T[2, 3] += p[2]
    T[3, 3] = 1.0


@entry
def poses(values: Any, starts: Any, columns: Any, steps: Any, homes: Any, Ts: Any, axes: Any) -> bool:
    """`Ts` (t, 4, 4) of the bodies, and `axes` (s, 6): each joint's axis and a point on it, as they lie now.

    `values` (j,): positions of the joints. Body i hangs on the joints `columns` (s,) from `starts[i]` to
    `starts[i + 1]`, which `steps` (s, 8) describes; `homes` (t, 4, 4): its pose at zero. False where a value is not
    finite.
    """
    for v in values:
        if not np.isfinite(v):
            return False
    for i in range(len(homes)):
        X, Y, Z, p = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
        for k in range(starts[i], starts[i + 1]):
            step = steps[k]
            a = _placed(X, Y, Z, step[0], step[1], step[2])
            x, y, z = _placed(X, Y, Z, step[3], step[4], step[5])
            point = (x + p[0], y + p[1], z + p[2])
            for n in range(3):
                axes[k, n], axes[k, 3 + n] = a[n], point[n]
            travel = values[columns[k]] - step[6]
            if step[7]:
                p = (p[0] + travel * a[0], p[1] + travel * a[1], p[2] + travel * a[2])
                continue
            sine, cosine = np.sin(travel), np.cos(travel)
            X = _turned(X[0], X[1], X[2], a, sine, cosine)
            Y = _turned(Y[0], Y[1], Y[2], a, sine, cosine)
            Z = _turned(Z[0], Z[1], Z[2], a, sine, cosine)
            x, y, z = _placed(X, Y, Z, step[3], step[4], step[5])
            p = (point[0] - x, point[1] - y, point[2] - z)
        _last(Ts[i], homes[i], X, Y, Z, p)
    return True


@entry
def jacobians(points: Any, bodies: Any, starts: Any, columns: Any, steps: Any, axes: Any, out: Any) -> None:
    """`out` (k, 6, j), zeros before: how `points` (k, 3) as they lie now, each fixed on one of the `bodies` (k,), move
    and turn by each joint; `axes` as `poses` gives them."""
    for i in range(len(points)):
        for k in range(starts[bodies[i]], starts[bodies[i] + 1]):
            c, a = columns[k], axes[k]
            if steps[k, 7]:
                out[i, 0, c], out[i, 1, c], out[i, 2, c] = a[0], a[1], a[2]
                continue
            x, y, z = points[i, 0] - a[3], points[i, 1] - a[4], points[i, 2] - a[5]
            out[i, 0, c] = a[1] * z - a[2] * y
            out[i, 1, c] = a[2] * x - a[0] * z
            out[i, 2, c] = a[0] * y - a[1] * x
            out[i, 3, c], out[i, 4, c], out[i, 5, c] = a[0], a[1], a[2]


@entry
def carried(points: Any, bodies: Any, Ts: Any, out: Any) -> None:
    """`out` (m, 3): points (m, 3), each fixed in the body whose pose is `Ts[bodies[i]]`."""
    for i in range(len(points)):
        T = Ts[bodies[i]]
        for n in range(3):
            out[i, n] = T[n, 0] * points[i, 0] + T[n, 1] * points[i, 1] + T[n, 2] * points[i, 2] + T[n, 3]


def warm() -> None:
    """Compiles every kernel, or loads it."""
    starts, columns, steps = np.array([0, 1]), np.zeros(1, np.int64), np.zeros((1, STEP))
    Ts, axes = np.empty((1, 4, 4)), np.empty((1, 6))
    poses(np.zeros(1), starts, columns, steps, np.eye(4)[None], Ts, axes)
    jacobians(np.zeros((1, 3)), columns, starts, columns, steps, axes, np.zeros((1, 6, 1)))
    carried(np.zeros((1, 3)), columns, Ts, np.empty((1, 3)))
