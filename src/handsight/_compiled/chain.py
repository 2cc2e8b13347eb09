"""Poses and Jacobians of bodies on chains of joints.

A chain is a product of exponentials: each joint's axis is given in the base frame with all joints at zero, and the
body's pose is then its `home`. Each joint moves the joints that come after it in the chain.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry
from handsight._compiled.so3 import IDENTITY, rotation_about
from handsight._compiled.symmetry import store_transform, transform_of
from handsight._compiled.vec3 import add, apply, cross, matmul, mul, scale, store, sub, vector


@entry
def poses(values: Any, starts: Any, joints: Any, homes: Any, Ts: Any, axes: Any) -> bool:
    """Writes the poses `Ts` (t, 4, 4) of the bodies, and `axes` (s, 2, 3), the axis of each joint and a point on it.

    `values` (j,) are the positions of the joints. Body i has the chain `joints[starts[i] : starts[i + 1]]`, records
    CHAIN_JOINT, and the pose `homes[i]` (4, 4) with all joints at zero. Returns False where a value is not finite.
    """
    for v in values:
        if not np.isfinite(v):
            return False
    for i in range(len(homes)):
        R = IDENTITY
        p = (0.0, 0.0, 0.0)
        for k in range(starts[i], starts[i + 1]):
            joint = joints[k]
            axis = mul(R, vector(joint.axis))
            point = apply((R, p), vector(joint.point))
            store(axis, axes[k, 0])
            store(point, axes[k, 1])
            travel = values[joint.value] - joint.zero
            if joint.slides:
                p = add(p, scale(axis, travel))
            else:
                R = matmul(rotation_about(axis, np.cos(travel), np.sin(travel)), R)
                p = sub(point, mul(R, vector(joint.point)))
        home, at = transform_of(homes[i])
        store_transform((matmul(R, home), apply((R, p), at)), Ts[i])
    return True


@entry
def jacobians(points: Any, bodies: Any, starts: Any, joints: Any, axes: Any, steps: Any, out: Any) -> None:
    """Writes the Jacobians (translation, rotation) of points by each joint, times `steps` (j, m), to `out` (k, 6, m).

    `points` (k, 3), along the base's axes, are each fixed to one of the `bodies` (k,); `axes` as `poses` writes them.
    """
    out[:] = 0.0
    for i in range(len(points)):
        for k in range(starts[bodies[i]], starts[bodies[i] + 1]):
            step = steps[joints[k].value]
            axis = vector(axes[k, 0])
            shift = axis
            turn = (0.0, 0.0, 0.0)
            if not joints[k].slides:
                shift = cross(axis, sub(vector(points[i]), vector(axes[k, 1])))
                turn = axis
            for n in range(3):
                for c in range(len(step)):
                    out[i, n, c] += shift[n] * step[c]
                    out[i, 3 + n, c] += turn[n] * step[c]


@entry
def transform_points(points: Any, bodies: Any, Ts: Any, out: Any) -> None:
    """Writes to `out` (m, 3) the points (m, 3), each transformed by the pose `Ts[bodies[i]]` of its body."""
    for i in range(len(points)):
        store(apply(transform_of(Ts[bodies[i]]), vector(points[i])), out[i])
