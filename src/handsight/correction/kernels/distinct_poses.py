"""Non-maximum suppression: which of many poses are not near a better one, modulo the object's symmetries."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.symmetry import pose_of, transform_of
from handsight._compiled.vec3 import Pose, Vec3, apply, dot, matmul, mul, sub, transpose, vector


@inner
def _cosine(symmetries: Any, R: Any) -> float:
    """Returns the cosine of the least angle of a rotation followed by any spin about the continuous axes."""
    axes = symmetries[1]
    if len(axes) > 1:
        return 1.0
    trace = R[0][0] + R[1][1] + R[2][2]
    if len(axes) == 1:
        a = vector(axes[0])
        along = dot(a, mul(R, a))
        s = dot(a, (R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]))
        trace = along + np.sqrt((trace - along) ** 2 + s * s)
    return (trace - 1) / 2


@inner
def _alike(symmetries: Any, about: Vec3, radius: float, limit: float, poses: tuple[Pose, Pose]) -> bool:
    """Returns whether a symmetry brings the second pose to within a limit [m] of the first, by shift and turn."""
    pose, other = poses
    place = apply(pose, about)
    for k in range(len(symmetries[0])):
        S = transform_of(symmetries[0][k])
        off = sub(apply(other, apply(S, about)), place)
        left = limit * limit - dot(off, off)
        if left > 0:
            angle = np.sqrt(left) / radius
            turn = matmul(transpose(pose[0]), matmul(other[0], S[0]))
            if angle >= np.pi or _cosine(symmetries, turn) > np.cos(angle):
                return True
    return False


@entry
def distinct_candidates(symmetries: Any, limits: Any, candidates: Any, order: Any, kept: Any) -> int:
    """Returns how many CANDIDATE, in an order (k,), are not near an earlier one; fills `kept` (most,) with indices.

    symmetries: discrete ones (r, 4, 4), directions of continuous axes (a, 3). limits (5,): a point on these axes, or
    any where there are none; the object's radius [m]; the distance [m] of two poses that are not near each other, by
    that point's shift and radius times the turn.
    """
    about = (limits[0], limits[1], limits[2])
    count = 0
    for n in order:
        new = True
        pose = pose_of(candidates[n].pose)
        for k in range(count):
            if _alike(symmetries, about, limits[3], limits[4], (pose_of(candidates[kept[k]].pose), pose)):
                new = False
                break
        if new:
            kept[count] = n
            count += 1
            if count == len(kept):
                break
    return count
