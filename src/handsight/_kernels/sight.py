"""Vision as evidence: its rows added to the normal equations.

Twins: `handsight.correction.sight` and `handsight.correction.two_phase.prior_root`.
"""

from typing import Any

import numpy as np

from handsight._kernels.algebra import eigen
from handsight._kernels.compiled import inner
from handsight._kernels.layout import (
    AXES,
    AXIS_COUNT,
    AXIS_OBJECT,
    CENTER,
    HAS_AXIS,
    HELD,
    INFORMATION,
    PIVOT,
    PIVOT_OBJECT,
    PIVOT_PALM,
    PRIOR_COVARIANCE,
    PRIOR_POSITION,
    RADIUS,
    ROTATION,
    VISION,
)  # fmt: skip
from handsight._kernels.vectors import accumulate


@inner
def held(model: Any, center: Any, sight: Any) -> None:
    """The evidence that the object's middle is among the contacts, give or take its radius; for the blind."""
    sight[:] = 0.0
    sight[0] = HELD
    for k in range(3):
        sight[PIVOT_OBJECT + k] = model[CENTER + k]
        sight[PIVOT_PALM + k] = center[k]
        sight[ROTATION + 4 * k] = 1.0
        sight[INFORMATION + 7 * k] = 1 / (model[RADIUS] * model[RADIUS])


@inner
def seen(model: Any, prior: Any, sight: Any, work: Any) -> None:
    """The evidence of a prior about an object so symmetric; `work` (120)."""
    radius = model[RADIUS]
    information, values, vectors = work[:36], work[36:42], work[42:78]
    for i in range(6):
        for j in range(6):
            scale = (1.0 if i < 3 else radius) * (1.0 if j < 3 else radius)
            information[6 * i + j] = prior[PRIOR_COVARIANCE + 6 * i + j] * scale
    eigen(information, 6, values, vectors)
    for k in range(6):
        values[k] = 1 / max(values[k], (1e-5 * radius) ** 2)
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += vectors[6 * i + k] * values[k] * vectors[6 * j + k]
            information[6 * i + j] = total * (1.0 if i < 3 else radius) * (1.0 if j < 3 else radius)
    sight[:] = 0.0
    sight[0] = VISION
    sight[HAS_AXIS] = model[AXIS_COUNT]
    arm, lever = work[78:81], work[81:90]
    for i in range(3):
        arm[i] = 0.0
        for k in range(3):
            sight[ROTATION + 3 * i + k] = prior[3 * i + k]
            arm[i] += prior[3 * i + k] * model[PIVOT + k]
        sight[PIVOT_OBJECT + i] = model[PIVOT + i]
        sight[AXIS_OBJECT + i] = model[AXES + i]
        sight[PIVOT_PALM + i] = prior[PRIOR_POSITION + i] + arm[i]
    # δp of the origin is that of the pivot less what the turn does to the arm between.
    lever[:] = 0.0
    lever[1], lever[2], lever[5] = -arm[2], arm[1], -arm[0]
    lever[3], lever[6], lever[7] = arm[2], -arm[1], arm[0]
    _carried(information, lever, sight, work[90:])
    for axis in range(int(model[AXIS_COUNT])):
        _without_spin(model, prior, axis, sight, work)


@inner
def _carried(information: Any, lever: Any, sight: Any, work: Any) -> None:
    """`FᵀΛF` for F = [1, lever; 0, 1], lever (3, 3)."""
    half = work[:18]  # Λ F, its right columns
    for i in range(6):
        for j in range(3):
            total = information[6 * i + 3 + j]
            for k in range(3):
                total += information[6 * i + k] * lever[3 * k + j]
            half[3 * i + j] = total
    for i in range(6):
        for j in range(3):
            if i < 3:
                sight[INFORMATION + 6 * i + j] = information[6 * i + j]
                sight[INFORMATION + 6 * i + 3 + j] = half[3 * i + j]
                sight[INFORMATION + 6 * (3 + j) + i] = half[3 * i + j]
            else:
                total = half[3 * i + j]
                for k in range(3):
                    total += lever[3 * k + i - 3] * half[3 * k + j]
                sight[INFORMATION + 6 * i + 3 + j] = total


@inner
def _without_spin(model: Any, prior: Any, axis: int, sight: Any, work: Any) -> None:
    """Takes what is known of the turn about a symmetry axis out of the information."""
    turned = work[:6]
    along = 0.0
    turned[:] = 0.0
    for j in range(3):
        direction = 0.0
        for k in range(3):
            direction += prior[3 * j + k] * model[AXES + 3 * axis + k]
        for i in range(6):
            turned[i] += sight[INFORMATION + 6 * i + 3 + j] * direction
        work[6 + j] = direction
    for j in range(3):
        along += work[6 + j] * turned[3 + j]
    along = max(along, 1e-300)
    for i in range(6):
        for j in range(6):
            sight[INFORMATION + 6 * i + j] -= turned[i] * turned[j] / along


@inner
def turn_between(sight: Any, pose: Any, turn: Any, by_turn: Any) -> None:
    """The rotation vector (3) from vision's rotation, or axis, to the pose's, and its derivative (3, 3) by a turn."""
    if sight[HAS_AXIS] > 0:
        _swing(sight, pose, turn, by_turn)
    else:
        _log(sight, pose, turn, by_turn)


@inner
def _swing(sight: Any, pose: Any, turn: Any, by_turn: Any) -> None:
    a, s = AXIS_OBJECT, sight
    fx = s[ROTATION] * s[a] + s[ROTATION + 1] * s[a + 1] + s[ROTATION + 2] * s[a + 2]
    fy = s[ROTATION + 3] * s[a] + s[ROTATION + 4] * s[a + 1] + s[ROTATION + 5] * s[a + 2]
    fz = s[ROTATION + 6] * s[a] + s[ROTATION + 7] * s[a + 1] + s[ROTATION + 8] * s[a + 2]
    tx = pose[0] * s[a] + pose[1] * s[a + 1] + pose[2] * s[a + 2]
    ty = pose[3] * s[a] + pose[4] * s[a + 1] + pose[5] * s[a + 2]
    tz = pose[6] * s[a] + pose[7] * s[a + 1] + pose[8] * s[a + 2]
    px, py, pz = fy * tz - fz * ty, fz * tx - fx * tz, fx * ty - fy * tx
    sine = np.sqrt(px * px + py * py + pz * pz)
    if sine < 1e-9:
        turn[0], turn[1], turn[2] = px, py, pz
        _symmetric(by_turn, 1 - tx * tx, -tx * ty, -tx * tz, 1 - ty * ty, -ty * tz, 1 - tz * tz)
        return
    angle = np.arctan2(sine, tx * fx + ty * fy + tz * fz)
    stretch = angle / sine
    turn[0], turn[1], turn[2] = stretch * px, stretch * py, stretch * pz
    nx, ny, nz = px / sine, py / sine, pz / sine
    # n nᵀ + α / sin α (n × from)(n × to)ᵀ
    ux, uy, uz = stretch * (ny * fz - nz * fy), stretch * (nz * fx - nx * fz), stretch * (nx * fy - ny * fx)
    vx, vy, vz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    by_turn[0], by_turn[1], by_turn[2] = nx * nx + ux * vx, nx * ny + ux * vy, nx * nz + ux * vz
    by_turn[3], by_turn[4], by_turn[5] = ny * nx + uy * vx, ny * ny + uy * vy, ny * nz + uy * vz
    by_turn[6], by_turn[7], by_turn[8] = nz * nx + uz * vx, nz * ny + uz * vy, nz * nz + uz * vz


@inner
def _symmetric(out: Any, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> None:
    out[0], out[1], out[2] = xx, xy, xz
    out[3], out[4], out[5] = xy, yy, yz
    out[6], out[7], out[8] = xz, yz, zz


@inner
def _log(sight: Any, pose: Any, turn: Any, by_turn: Any) -> None:
    Q = by_turn  # pose times vision's rotation transposed, for now
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += pose[3 * i + k] * sight[ROTATION + 3 * j + k]
            Q[3 * i + j] = total
    rotation_log(Q, turn)
    x, y, z = turn[0], turn[1], turn[2]
    square = x * x + y * y + z * z
    half = 0.5 * np.sqrt(square)
    bend = 1 / 12 + half * half / 180
    if half >= 5e-3:
        bend = (1 - half / np.tan(half)) / (4 * half * half)
    # 1 - S/2 + bend S², S² = w wᵀ - |w|²
    by_turn[0] = 1 + bend * (x * x - square)
    by_turn[4] = 1 + bend * (y * y - square)
    by_turn[8] = 1 + bend * (z * z - square)
    by_turn[1], by_turn[3] = 0.5 * z + bend * x * y, -0.5 * z + bend * x * y
    by_turn[2], by_turn[6] = -0.5 * y + bend * x * z, 0.5 * y + bend * x * z
    by_turn[5], by_turn[7] = 0.5 * x + bend * y * z, -0.5 * x + bend * y * z


@inner
def rotation_log(Q: Any, turn: Any) -> None:
    """The rotation vector (3) of a rotation; exact near 0 and near π (twin: `handsight.se3.rotation_log`)."""
    x, y, z = (Q[7] - Q[5]) / 2, (Q[2] - Q[6]) / 2, (Q[3] - Q[1]) / 2
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = (Q[0] + Q[4] + Q[8] - 1) / 2
    if cosine >= -0.9:
        factor = np.arctan2(sine, cosine) / sine if sine >= 1e-9 else 1.0
        turn[0], turn[1], turn[2] = factor * x, factor * y, factor * z
        return
    # Near π the quaternion keeps the axis: the longest column of 4 q qᵀ, real part last.
    trace = Q[0] + Q[4] + Q[8]
    best = 0
    if Q[4] > Q[0]:
        best = 1
    if Q[8] > Q[4 * best]:
        best = 2
    i, j = (best + 1) % 3, (best + 2) % 3
    turn[best] = 1 + 2 * Q[4 * best] - trace
    turn[i] = Q[3 * best + i] + Q[3 * i + best]
    turn[j] = Q[3 * best + j] + Q[3 * j + best]
    w = Q[3 * j + i] - Q[3 * i + j]
    length = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    angle = 2 * np.arctan2(length, abs(w))
    scale = (-angle if w < 0 else angle) / length
    for k in range(3):
        turn[k] *= scale


@inner
def add_sight(sight: Any, pose: Any, center: Any, radius: float, equations: Any, work: Any) -> None:
    """Adds vision's rows to normal equations by (τ, radius ω) about `center`; `work` (12)."""
    turn, d = work[:3], work[3:12]
    turn_between(sight, pose, turn, d)
    r, P, V, R = 1 / radius, PIVOT_OBJECT, PIVOT_PALM, pose
    px = R[9] + R[0] * sight[P] + R[1] * sight[P + 1] + R[2] * sight[P + 2]
    py = R[10] + R[3] * sight[P] + R[4] * sight[P + 1] + R[5] * sight[P + 2]
    pz = R[11] + R[6] * sight[P] + R[7] * sight[P + 1] + R[8] * sight[P + 2]
    # The pivot moves by τ + ω × (pivot - center).
    x, y, z = (px - center[0]) * r, (py - center[1]) * r, (pz - center[2]) * r
    rows = (
        1.0, 0.0, 0.0, 0.0, z, -y, px - sight[V],
        0.0, 1.0, 0.0, -z, 0.0, x, py - sight[V + 1],
        0.0, 0.0, 1.0, y, -x, 0.0, pz - sight[V + 2],
        0.0, 0.0, 0.0, d[0] * r, d[1] * r, d[2] * r, turn[0],
        0.0, 0.0, 0.0, d[3] * r, d[4] * r, d[5] * r, turn[1],
        0.0, 0.0, 0.0, d[6] * r, d[7] * r, d[8] * r, turn[2],
    )  # fmt: skip
    accumulate(sight, INFORMATION, rows, equations)


@inner
def sight_cost(sight: Any, pose: Any, work: Any) -> float:
    """Vision's squared residuals at a pose; `work` (18)."""
    turn, by_turn, error = work[:3], work[3:12], work[12:18]
    turn_between(sight, pose, turn, by_turn)
    for i in range(3):
        arm = 0.0
        for k in range(3):
            arm += pose[3 * i + k] * sight[PIVOT_OBJECT + k]
        error[i] = pose[9 + i] + arm - sight[PIVOT_PALM + i]
        error[3 + i] = turn[i]
    total = 0.0
    for i in range(6):
        for k in range(6):
            total += error[i] * sight[INFORMATION + 6 * i + k] * error[k]
    return total
