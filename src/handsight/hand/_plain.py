"""What the kernels of `handsight._kernels.chain` mean, in NumPy."""

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices


def poses(
    values: Array, starts: Indices, columns: Indices, steps: Array, homes: Array
) -> tuple[Array, Array]:
    """Poses (t, 4, 4) of the bodies, and (s, 6) the joints' axes and points on them, as they lie now."""
    Ts, axes = homes.copy(), np.empty((len(steps), 6))
    for i in range(len(homes)):
        T = np.eye(4)
        for k in range(starts[i], starts[i + 1]):
            axis, point, zero, slides = np.split(steps[k], [3, 6, 7])
            axes[k] = [*T[:3, :3] @ axis, *se3.apply(T, point[None])[0]]
            speed = [*axis, 0, 0, 0] if slides[0] else [*np.cross(point, axis), *axis]
            T = T @ se3.exp(np.array(speed) * (values[columns[k]] - zero[0]))
        Ts[i] = T @ homes[i]
    return Ts, axes


def jacobians(
    points: Array, bodies: Indices, starts: Indices, columns: Indices, steps: Array, axes: Array, out: Array
) -> None:
    """`out` (k, 6, joints): how points (k, 3) as they lie now, each fixed on one of the bodies (k,), move and turn."""
    for i, body in enumerate(bodies):
        for k in range(starts[body], starts[body + 1]):
            axis, point = axes[k, :3], axes[k, 3:]
            turning = [*np.cross(axis, points[i] - point), *axis]
            out[i, :, columns[k]] = [*axis, 0, 0, 0] if steps[k, 7] else turning


def carried(points: Array, bodies: Indices, Ts: Array) -> Array:
    """Points (m, 3), each fixed in the body whose pose is `Ts[bodies[i]]`."""
    return np.array([T[:3, :3] @ p + T[:3, 3] for p, T in zip(points, Ts[bodies], strict=True)])
