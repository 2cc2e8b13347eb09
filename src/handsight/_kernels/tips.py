"""How far fingertips are from one another. Its meaning in NumPy: `handsight.tracking.gaps`."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner

STEPS = 12
"""Halved steps to the direction that separates two tips best; the gap is within 0.1 mm after them."""


@inner
def _support(T: Any, axes: Any, ux: float, uy: float, uz: float) -> Any:
    """The point of an ellipsoid that is farthest along u."""
    a = axes[0] * axes[0] * (T[0, 0] * ux + T[1, 0] * uy + T[2, 0] * uz)
    b = axes[1] * axes[1] * (T[0, 1] * ux + T[1, 1] * uy + T[2, 1] * uz)
    c = axes[2] * axes[2] * (T[0, 2] * ux + T[1, 2] * uy + T[2, 2] * uz)
    length = np.sqrt((a / axes[0]) ** 2 + (b / axes[1]) ** 2 + (c / axes[2]) ** 2)
    a, b, c = a / length, b / length, c / length
    return (
        T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3],
        T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3],
        T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3],
    )


@inner
def _gap(T: Any, axes: Any, T_other: Any, axes_other: Any) -> Any:
    """The widest slab between two ellipsoids: their distance, or minus how far they must be moved apart."""
    ux, uy, uz = T_other[0, 3] - T[0, 3], T_other[1, 3] - T[1, 3], T_other[2, 3] - T[2, 3]
    length = max(np.sqrt(ux * ux + uy * uy + uz * uz), 1e-12)
    ux, uy, uz = ux / length, uy / length, uz / length
    best = -np.inf
    for _ in range(STEPS):
        px, py, pz = _support(T, axes, ux, uy, uz)
        qx, qy, qz = _support(T_other, axes_other, -ux, -uy, -uz)
        vx, vy, vz = qx - px, qy - py, qz - pz
        best = max(best, ux * vx + uy * vy + uz * vz)
        length = np.sqrt(vx * vx + vy * vy + vz * vz)
        if best <= 0.0 or length < 1e-12:
            break
        ux, uy, uz = ux + vx / length, uy + vy / length, uz + vz / length
        length = max(np.sqrt(ux * ux + uy * uy + uz * uz), 1e-12)
        ux, uy, uz = ux / length, uy / length, uz / length
    return best


@entry
def gaps(Ts: Any, semi_axes: Any) -> Any:
    """(n,) distance of each ellipsoid (pose (n, 4, 4), semi-axes (n, 3) [m]) to the nearest other one [m]."""
    n = len(Ts)
    out = np.full(n, np.inf)
    for i in range(n):
        for j in range(i):
            gap = _gap(Ts[i], semi_axes[i], Ts[j], semi_axes[j])
            out[i], out[j] = min(out[i], gap), min(out[j], gap)
    return out


def warm() -> None:
    """Compiles the kernel, or loads it."""
    gaps(np.eye(4)[None], np.ones((1, 3)))
