"""Phase 2: Levenberg-Marquardt on a distance field, one pose at a time; its step and retraction for other solvers."""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import factor, solve
from handsight._compiled.jit import inner
from handsight._compiled.records import WORKSPACE
from handsight._compiled.stack import local
from handsight._compiled.vec3 import Pose, Vec3, add, matmul, mul, norm, scale, sub
from handsight.correction.kernels.search_options import DESCENT
from handsight.correction.kernels.terms import ALL, REWHITENED, Evidence, add_evidence

LONGEST_STEP = 1e3, DESCENT.max_turn
"""The longest step: shift [m], in effect unlimited, and turn [rad], beyond which the linearisation does not hold."""
IMAGE_DAMPING = 1.7e-4
"""Damping of a step towards the points of an image: it keeps the pose along directions that they do not observe."""


@inner
def damped_step(
    equations: Any, radius: float, damping: float, longest: tuple[float, float], workspace: Any
) -> tuple[Vec3, Vec3]:
    """Returns a Levenberg-Marquardt step (τ, radius ω) of normal equations (7, 8), 0 in unobserved directions.

    damping: as a part of the trace of the information; longest: the most that a step shifts [m] and turns [rad]. Where
    the equations have no solution the step is NaN; then so is the cost after it, and the step is not taken.
    """
    trace = 0.0
    for k in range(6):
        trace += equations[k, k]
    if not factor(equations, 6, (damping + 1e-12) * trace, workspace.factor):
        nothing = (np.nan, np.nan, np.nan)
        return nothing, nothing
    s = workspace.step
    solve(workspace.factor, 6, equations[6], s)
    shift, turn = (s[0], s[1], s[2]), (s[3], s[4], s[5])
    by_shift = longest[0] / max(norm(shift), longest[0])
    by_turn = longest[1] / max(norm(turn) / radius, longest[1])
    shorter = -min(by_shift, by_turn)
    return scale(shift, shorter), scale(turn, shorter)


@inner
def retract(pose: Pose, step: tuple[Vec3, Vec3], center: Vec3, radius: float) -> Pose:
    """Returns the pose after a step (τ, radius ω) about `center`; the turn by Cayley's map, which needs no sine."""
    R, p = pose
    x, y, z = scale(step[1], 1 / (2 * radius))
    k = 2 / (1 + x * x + y * y + z * z)
    Q = (
        (1 - k * (y * y + z * z), k * (x * y - z), k * (x * z + y)),
        (k * (x * y + z), 1 - k * (x * x + z * z), k * (y * z - x)),
        (k * (x * z - y), k * (y * z + x), 1 - k * (x * x + y * y)),
    )
    return matmul(Q, R), add(add(mul(Q, sub(p, center)), center), step[0])


@inner
def step_size(equations: Any, step: tuple[Vec3, Vec3]) -> tuple[float, float]:
    """Returns the largest component of a step [m], and its squared length in standard deviations."""
    six = step[0] + step[1]
    longest = 0.0
    square = 0.0
    for i in range(6):
        longest = max(longest, abs(six[i]))
        square += equations[i, i] * six[i] * six[i]
        for j in range(i):
            square += 2 * equations[i, j] * six[i] * six[j]
    return longest, square


@inner
def descend(
    evidence: Evidence, field: Any, pose: Pose, limits: tuple[int, float], rewhiten: bool
) -> tuple[Pose, float, int, bool]:
    """Returns where a descent from a pose ends, the cost there, the number of steps tried, and whether it converged.

    `limits`: most steps, and the step [standard deviations] that is small. A step is taken only when it lowers the
    cost; only a step that was taken can end a descent as converged. `rewhiten`: whether the contacts are weighted by
    their covariance at the first pose; otherwise they keep their last weights.
    """
    workspace = local(WORKSPACE)
    radius = evidence.model.radius
    center = evidence.center
    now, new = workspace.now, workspace.next
    most, small = limits
    step = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    candidate = pose
    damping = 1e-6
    tried = -1
    converged = False
    while True:
        # Only this place evaluates, the first pose as well as every candidate: it takes most of the time to compile.
        new[:] = 0.0
        kinds = ALL | REWHITENED if rewhiten and tried < 0 else ALL
        add_evidence(evidence, kinds, field, candidate, (center, radius), new)
        tried += 1
        # A change of the cost within rounding is neither better nor worse; such a step is taken.
        if tried == 0 or new[6, 6] <= now[6, 6] + 1e-12 * (1 + now[6, 6]):
            if tried > 0:
                longest, square = step_size(now, step)
                # At an edge the cost has a kink: there steps get short long before the slope does.
                converged = square < small * small or longest < DESCENT.short_step * radius
                damping = max(damping * 0.1, 1e-9)
            pose = candidate
            for i in range(7):
                for j in range(7):
                    now[i, j] = new[i, j]
        else:
            damping = min(damping * 30, 1e3)
        if converged or tried == most:
            return pose, now[6, 6], tried, converged
        step = damped_step(now, radius, damping, LONGEST_STEP, workspace)
        candidate = retract(pose, step, center, radius)
