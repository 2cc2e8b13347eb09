"""Poses and Jacobians of bodies on chains of joints.

A chain is a product of exponentials: each joint's axis is given in the base frame with all joints at zero, and the
body's pose is then its `home`. Each joint moves the joints that come after it in the chain.
"""

from typing import Any

import numpy as np

from handsight._kernels.math.so3 import IDENTITY
from handsight._kernels.math.vec3 import (
    Mat33,
    Vec3,
    add,
    add33,
    cross,
    matmul,
    matrix,
    mul,
    outer,
    scale,
    scale33,
    skew,
    store,
    store33,
    sub,
    vector,
)
from handsight._kernels.records import CHAIN_JOINT
from handsight._kernels.runtime.compilation import entry, inner


@inner
def rotation(axis: Vec3, angle: float) -> Mat33:
    """Returns the rotation about a unit axis (Rodrigues)."""
    cosine = np.cos(angle)
    along, across = scale33(outer(axis, axis), 1 - cosine), scale33(skew(axis), np.sin(angle))
    return add33(add33(scale33(IDENTITY, cosine), across), along)


@entry
def poses(values: Any, starts: Any, joints: Any, homes: Any, Ts: Any, axes: Any) -> bool:
    """Writes the poses `Ts` (t, 4, 4) of the bodies, and `axes` (s, 2, 3): each joint's axis and a point on it.

    `values` (j,): positions of the joints. Body i has the chain `joints[starts[i] : starts[i + 1]]`, records
    CHAIN_JOINT, and the pose `homes[i]` (4, 4) with all joints at zero. Returns False where a value is not finite.
    """
    for v in values:
        if not np.isfinite(v):
            return False
    for i in range(len(homes)):
        R, p = IDENTITY, (0.0, 0.0, 0.0)
        for k in range(starts[i], starts[i + 1]):
            joint = joints[k]
            axis, point = mul(R, vector(joint.axis)), add(p, mul(R, vector(joint.point)))
            store(axis, axes[k, 0])
            store(point, axes[k, 1])
            travel = values[joint.value] - joint.zero
            if joint.slides:
                p = add(p, scale(axis, travel))
            else:
                R = matmul(rotation(axis, travel), R)
                p = sub(point, mul(R, vector(joint.point)))
        T, home = Ts[i], homes[i]
        store33(matmul(R, matrix(home)), T)
        T[0, 3], T[1, 3], T[2, 3] = add(p, mul(R, (home[0, 3], home[1, 3], home[2, 3])))
        T[3, 0] = T[3, 1] = T[3, 2] = 0.0
        T[3, 3] = 1.0
    return True


@entry
def jacobians(points: Any, bodies: Any, starts: Any, joints: Any, axes: Any, out: Any) -> None:
    """Writes the Jacobians `out` (k, 6, j), zeros before, by each joint.

    `points` (k, 3) are each fixed on one of the `bodies` (k,), and in the base; `axes` as `poses` writes them.
    """
    for i in range(len(points)):
        for k in range(starts[bodies[i]], starts[bodies[i] + 1]):
            c, axis = joints[k].value, vector(axes[k, 0])
            shift, turn = axis, (0.0, 0.0, 0.0)
            if not joints[k].slides:
                shift, turn = cross(axis, sub(vector(points[i]), vector(axes[k, 1]))), axis
            for n in range(3):
                out[i, n, c], out[i, 3 + n, c] = shift[n], turn[n]


@entry
def transform_points(points: Any, bodies: Any, Ts: Any, out: Any) -> None:
    """Writes `out` (m, 3): points (m, 3) transformed by the poses `Ts[bodies[i]]`."""
    for i in range(len(points)):
        T = Ts[bodies[i]]
        store(add(mul(matrix(T), vector(points[i])), (T[0, 3], T[1, 3], T[2, 3])), out[i])


def warm() -> None:
    """Compiles every kernel, or loads its machine code."""
    starts, bodies, joints = np.array([0, 1]), np.zeros(1, np.int64), np.zeros(1, dtype=CHAIN_JOINT)
    Ts, axes = np.empty((1, 4, 4)), np.empty((1, 2, 3))
    poses(np.zeros(1), starts, joints, np.eye(4)[None], Ts, axes)
    jacobians(np.zeros((1, 3)), bodies, starts, joints, axes, np.zeros((1, 6, 1)))
    transform_points(np.zeros((1, 3)), bodies, Ts, np.empty((1, 3)))
