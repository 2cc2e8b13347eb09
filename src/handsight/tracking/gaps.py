"""How far fingertips are from one another, in NumPy: what `handsight._kernels.tips` computes."""

import numpy as np

from handsight.checks import Array


def gaps(Ts: Array, semi_axes: Array) -> Array:
    """(n,) distance [m] of each ellipsoid (pose (n, 4, 4), semi-axes (n, 3) [m]) to the nearest other one.

    The distance of convex bodies is the widest slab that separates them; each step turns the slab halfway towards the
    line between the points that touch it. A negative gap says that the tips overlap, not how far.
    """
    n = len(Ts)
    between = np.full((n, n), np.inf)
    for i in range(n):
        for j in range(i):
            between[i, j] = between[j, i] = _gap(Ts[i], semi_axes[i], Ts[j], semi_axes[j])
    return np.asarray(between.min(axis=1, initial=np.inf))


def _gap(T: Array, axes: Array, T_other: Array, axes_other: Array) -> float:
    from handsight._kernels.tips import STEPS

    line = T_other[:3, 3] - T[:3, 3]
    u, best = line / max(float(np.linalg.norm(line)), 1e-12), -np.inf
    for _ in range(STEPS):
        v = _support(T_other, axes_other, -u) - _support(T, axes, u)
        best = max(best, float(u @ v))
        length = float(np.linalg.norm(v))
        if best <= 0 or length < 1e-12:
            break
        u = u + v / length
        u = u / max(float(np.linalg.norm(u)), 1e-12)
    return best


def _support(T: Array, axes: Array, u: Array) -> Array:
    """The point of an ellipsoid that is farthest along u."""
    local = T[:3, :3].T @ u
    point = axes * axes * local / np.linalg.norm(axes * local)
    return np.asarray(T[:3, :3] @ point + T[:3, 3])
