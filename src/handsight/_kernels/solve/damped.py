"""A damped Gauss-Newton step of a pose, by (τ, ω) about a centre that moves with it."""

from typing import Any

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.prior_term import rotation_exp
from handsight._kernels.math.dense6 import factor, in_metres, solve
from handsight._kernels.math.vec3 import Vec3, add, matmul, mul, norm, scale, sub
from handsight._kernels.runtime.compilation import inner

DAMPING = 1e-3
"""Of a step, by the mean information: what points do not see stays."""


@inner
def damped_step(u: Any, radius: float, longest: tuple[float, float], center: Vec3, pose: Pose) -> Pose:
    """Returns the pose after a step of the normal equations `u.matrix`, `u.values`, which are used up; itself if
    there is none.

    radius [m]: what a turn counts by; longest: of a step [m, rad]; center: in the frame that is moved.
    """
    R, p = pose
    in_metres(u.matrix, radius, u.matrix)
    trace = 0.0
    for i in range(6):
        u.values[i] *= 1.0 if i < 3 else 1 / radius
        trace += u.matrix[i, i]
    if not factor(u.matrix, 6, DAMPING / 6 * trace, u.factor):
        return pose
    solve(u.factor, 6, u.values, u.column)
    shift = (u.column[0], u.column[1], u.column[2])
    turn = scale((u.column[3], u.column[4], u.column[5]), 1 / radius)
    shift = scale(shift, min(1.0, longest[0] / max(norm(shift), 1e-12)))
    turn = scale(turn, min(1.0, longest[1] / max(norm(turn), 1e-12)))
    about = add(add(mul(R, center), p), shift)
    R = matmul(rotation_exp(turn), R)
    return R, sub(about, mul(R, center))
