"""Depth points as evidence for a pose in the camera: each lies on the object's surface, or on something else.

Residual of a point P: `d(Rᵀ(P - p))`, with Tukey's weight, so that what is farther off than a bound counts nothing.
The object moves by (τ, ω), about its centre; the residual's derivative is `-(g, (P - c) × g)`, g the field's gradient
in the camera.
"""

from typing import Any

from handsight._kernels.compiled import entry, inner
from handsight._kernels.contact_term import Pose
from handsight._kernels.dense6 import factor, solve
from handsight._kernels.field import field_at
from handsight._kernels.records import UNCERTAINTY
from handsight._kernels.search import rotation_exp
from handsight._kernels.simd import local
from handsight._kernels.vec3 import (
    Vec3,
    add,
    cross,
    dot,
    matmul,
    matrix,
    mul,
    norm,
    scale,
    sub,
    tmul,
    vector,
)

AGREES = 0.3
"""The least cosine of a point's normal with the surface's."""
LONGEST_SHIFT, LONGEST_TURN = 0.15, 0.5
"""Of one step [diameters, rad]."""
DAMPING = 1e-3
"""Of a step, by the mean information: what points do not see stays."""


@inner
def _equations(surface: Any, seen: Any, pose: Pose, about: Vec3, bound: float, u: Any) -> float:
    """The sum of weights; `u.matrix`, `u.values`: weighted normal equations, by (τ, ω). surface: nodes, field."""
    nodes, field = surface
    R, p = pose
    total = 0.0
    u.matrix[:] = 0.0
    u.values[:] = 0.0
    for n in range(len(seen)):
        P = vector(seen[n].point)
        distance, gradient, _ = field_at(nodes, field, tmul(R, sub(P, p)))
        ratio = distance / bound
        if not ratio * ratio < 1:
            continue
        g = mul(R, gradient)
        normal = vector(seen[n].normal)
        if dot(normal, g) < AGREES and normal != (0.0, 0.0, 0.0):
            continue
        weight = (1 - ratio * ratio) ** 2
        row = g + cross(sub(P, about), g)
        for i in range(6):
            u.values[i] += weight * distance * row[i]
            for j in range(i + 1):
                u.matrix[i, j] += weight * row[i] * row[j]
        total += weight
    return total


@inner
def settle(model: Any, nodes: Any, seen: Any, rung: Any, look: Any) -> None:
    """Moves a LOOK by Gauss-Newton steps to where points lie on the surface; rung: as of `settle_all`."""
    field = model.fine if rung[0] else model.coarse
    u, radius, steps = local(UNCERTAINTY), model.radius, int(rung[3])
    R, p = matrix(look.rotation), vector(look.position)
    for step in range(steps):
        bound = rung[1] + (rung[2] - rung[1]) * (step / max(steps - 1, 1))
        about = add(mul(R, vector(model.center)), p)
        if not _equations((nodes, field), seen, (R, p), about, bound, u) > 0:
            break
        trace = 0.0
        for i in range(6):
            for j in range(i + 1):
                u.matrix[i, j] *= (1.0 if i < 3 else 1 / radius) * (1.0 if j < 3 else 1 / radius)
            u.values[i] *= 1.0 if i < 3 else 1 / radius
            trace += u.matrix[i, i]
        for i in range(6):
            u.matrix[i, i] += DAMPING / 6 * trace
        if not factor(u.matrix, 6, 1e-12 * trace, u.factor):
            break
        solve(u.factor, 6, u.values, u.column)
        shift = (u.column[0], u.column[1], u.column[2])
        turn = scale((u.column[3], u.column[4], u.column[5]), 1 / radius)
        shift = scale(shift, min(1.0, LONGEST_SHIFT * 2 * radius / max(norm(shift), 1e-12)))
        turn = scale(turn, min(1.0, LONGEST_TURN / max(norm(turn), 1e-12)))
        E = rotation_exp(turn)
        R, about = matmul(E, R), add(about, shift)
        p = sub(about, mul(R, vector(model.center)))
    for i in range(3):
        look.position[i] = p[i]
        for j in range(3):
            look.rotation[i, j] = R[i][j]


@entry
def settle_all(model: Any, nodes: Any, seen: Any, rung: Any, looks: Any) -> None:
    """Moves LOOK (k,) to where SEEN (n,) lie on the surface.

    rung: whether on the fine field, Tukey's bound at first and at last [m], steps.
    """
    for k in range(len(looks)):
        settle(model[0], nodes, seen, rung, looks[k])
