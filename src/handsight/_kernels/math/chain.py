"""Poses and Jacobians of bodies on chains of joints.

A chain is a product of exponentials: each joint's axis is given in the base frame with all joints at zero, and the
body's pose is then its `home`. Each joint moves the joints that come after it in the chain.
"""

from typing import Any

import numpy as np

from handsight._kernels.math.so3 import IDENTITY, rotation_about
from handsight._kernels.math.symmetry import Pose, store_transform, transform_of
from handsight._kernels.math.vec3 import Vec3, add, apply, cross, matmul, mul, scale, store, sub, vector
from handsight._kernels.runtime.compilation import entry, inner


@inner
def _pose(values: Any, starts: Any, joints: Any, homes: Any, body: int, axes: Any) -> Pose:
    """Returns the pose of a body, and writes the axes of the joints on its chain; the arguments are those of `poses`."""
    R, p = IDENTITY, (0.0, 0.0, 0.0)
    for k in range(starts[body], starts[body + 1]):
        joint = joints[k]
        axis, point = mul(R, vector(joint.axis)), apply((R, p), vector(joint.point))
        store(axis, axes[k, 0])
        store(point, axes[k, 1])
        travel = values[joint.value] - joint.zero
        if joint.slides:
            p = add(p, scale(axis, travel))
        else:
            R = matmul(rotation_about(axis, np.cos(travel), np.sin(travel)), R)
            p = sub(point, mul(R, vector(joint.point)))
    home, at = transform_of(homes[body])
    return matmul(R, home), apply((R, p), at)


@inner
def _motion(joint: Any, axis: Any, point: Vec3) -> tuple[Vec3, Vec3]:
    """Returns the translation and the rotation of a point by a joint with an `axis` (2, 3), as `poses` writes them."""
    along = vector(axis[0])
    if joint.slides:
        return along, (0.0, 0.0, 0.0)
    return cross(along, sub(point, vector(axis[1]))), along


@entry
def poses(values: Any, starts: Any, joints: Any, homes: Any, Ts: Any, axes: Any) -> None:
    """Writes the poses `Ts` (t, 4, 4) of the bodies, and `axes` (s, 2, 3), the axis of each joint and a point on it.

    `values` (j,) are the positions of the joints. Body i has the chain `joints[starts[i] : starts[i + 1]]`, records
    CHAIN_JOINT, and the pose `homes[i]` (4, 4) with all joints at zero.
    """
    for i in range(len(homes)):
        store_transform(_pose(values, starts, joints, homes, i, axes), Ts[i])


@entry
def jacobians(points: Any, bodies: Any, starts: Any, joints: Any, axes: Any, out: Any) -> None:
    """Writes the Jacobians (translation, rotation) of points by each joint to `out` (k, 6, j), which holds zeros.

    `points` (k, 3), along the base's axes, are each fixed to one of the `bodies` (k,); `axes` as `poses` writes them.
    """
    for i in range(len(points)):
        for k in range(starts[bodies[i]], starts[bodies[i] + 1]):
            shift, turn = _motion(joints[k], axes[k], vector(points[i]))
            c = joints[k].value
            for n in range(3):
                out[i, n, c], out[i, 3 + n, c] = shift[n], turn[n]


@entry
def poses_and_motions(
    values: Any, steps: Any, bodies: Any, starts: Any, joints: Any, homes: Any, Ts: Any, out: Any
) -> None:
    """Writes the poses `Ts` (k, 4, 4) of some `bodies` (k,), and the motion of their origins to `out` (k, 6, m).

    That is along each column of `steps` (j, m), which are changes of the joints' positions: the Jacobian times `steps`.
    The other arguments are those of `poses`.
    """
    axes = np.empty((len(joints), 2, 3))
    for i in range(len(bodies)):
        body = bodies[i]
        pose = _pose(values, starts, joints, homes, body, axes)
        store_transform(pose, Ts[i])
        out[i] = 0.0
        for k in range(starts[body], starts[body + 1]):
            shift, turn = _motion(joints[k], axes[k], pose[1])
            step = steps[joints[k].value]
            for n in range(3):
                for c in range(len(step)):
                    out[i, n, c] += shift[n] * step[c]
                    out[i, 3 + n, c] += turn[n] * step[c]


@entry
def transform_points(points: Any, bodies: Any, Ts: Any, out: Any) -> None:
    """Writes to `out` (m, 3) the points (m, 3), each transformed by the pose `Ts[bodies[i]]` of its body."""
    for i in range(len(points)):
        store(apply(transform_of(Ts[bodies[i]]), vector(points[i])), out[i])
