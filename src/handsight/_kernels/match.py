"""Phase 1: Gauss-Newton on the nearest surface samples in (point, w normal).

Twins: `handsight.correction.solve.Matches` and `match`.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import inner
from handsight._kernels.layout import (
    BAND,
    BLIND,
    CONTACT,
    EQUATIONS,
    HAS_NORMAL,
    MATCH_WEIGHT,
    NORMAL,
    RADIUS,
    SAMPLE_VARIANCE,
    SAMPLES,
    SCAN,
    SCAN_COUNT,
    VARIANCE,
    WEIGHT_TANGENTIAL,
)  # fmt: skip
from handsight._kernels.settings import MATCH_STEPS, MATCH_TOLERANCE
from handsight._kernels.sight import add_sight
from handsight._kernels.solve import damped, stepped
from handsight._kernels.vectors import accumulate, scan


@inner
def _nearest(model: Any, singles: Any, contacts: Any, c: int, pose: Any) -> int:
    """The sample nearest to a contact in (point, w normal)."""
    R, w = pose, model[MATCH_WEIGHT]
    lx, ly, lz = contacts[c] - R[9], contacts[c + 1] - R[10], contacts[c + 2] - R[11]
    nx, ny, nz = contacts[c + NORMAL], contacts[c + NORMAL + 1], contacts[c + NORMAL + 2]
    # |a - b|² without |a|², which is the same for every sample.
    query = (
        np.float32(1.0),
        np.float32(-2 * (lx * R[0] + ly * R[3] + lz * R[6])),
        np.float32(-2 * (lx * R[1] + ly * R[4] + lz * R[7])),
        np.float32(-2 * (lx * R[2] + ly * R[5] + lz * R[8])),
        np.float32(-2 * w * (nx * R[0] + ny * R[3] + nz * R[6])),
        np.float32(-2 * w * (nx * R[1] + ny * R[4] + nz * R[7])),
        np.float32(-2 * w * (nx * R[2] + ny * R[5] + nz * R[8])),
    )
    return scan(singles, int(model[SCAN]), int(model[SCAN_COUNT]), query)


@inner
def _add(model: Any, contacts: Any, i: int, best: int, pose: Any, center: Any, equations: Any) -> None:
    """Adds contact i against the sample's plane, normal and place beyond its band."""
    c, at, r, R = CONTACT * i, int(model[SAMPLES]) + 6 * best, 1 / model[RADIUS], pose
    mx, my, mz = model[at + 3], model[at + 4], model[at + 5]
    nx, ny, nz = (
        R[0] * mx + R[1] * my + R[2] * mz,
        R[3] * mx + R[4] * my + R[5] * mz,
        R[6] * mx + R[7] * my + R[8] * mz,
    )
    px, py, pz = model[at], model[at + 1], model[at + 2]
    ox = contacts[c] - R[9] - (R[0] * px + R[1] * py + R[2] * pz)
    oy = contacts[c + 1] - R[10] - (R[3] * px + R[4] * py + R[5] * pz)
    oz = contacts[c + 2] - R[11] - (R[6] * px + R[7] * py + R[8] * pz)
    x, y, z = (
        (contacts[c] - center[0]) * r,
        (contacts[c + 1] - center[1]) * r,
        (contacts[c + 2] - center[2]) * r,
    )
    distance = ox * nx + oy * ny + oz * nz
    ax, ay, az = ox - distance * nx, oy - distance * ny, oz - distance * nz
    reach = np.sqrt(ax * ax + ay * ay + az * az)
    s = -1 / max(reach, 1e-300)
    ax, ay, az = ax * s, ay * s, az * s
    beyond = reach > model[BAND]
    has = contacts[c + HAS_NORMAL] > 0
    sideways = model[WEIGHT_TANGENTIAL] * model[WEIGHT_TANGENTIAL] if beyond else 0.0
    facing = 1 / max(contacts[c + VARIANCE + 1] + model[SAMPLE_VARIANCE + 1], 1e-12) if has else 0.0
    weights = (1 / (contacts[c + VARIANCE] + model[SAMPLE_VARIANCE]), sideways, facing, facing, facing)
    rows = (
        -nx, -ny, -nz, z * ny - y * nz, x * nz - z * nx, y * nx - x * ny,
        distance,
        ax, ay, az, y * az - z * ay, z * ax - x * az, x * ay - y * ax,
        reach - model[BAND],
        0.0, 0.0, 0.0, 0.0, nz * r, -ny * r, nx - contacts[c + NORMAL],
        0.0, 0.0, 0.0, -nz * r, 0.0, nx * r, ny - contacts[c + NORMAL + 1],
        0.0, 0.0, 0.0, ny * r, -nx * r, 0.0, nz - contacts[c + NORMAL + 2],
    )  # fmt: skip
    accumulate(weights, 0, rows, equations)


@inner
def match(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, center: Any, pose: Any, work: Any
) -> int:
    """Moves `pose` by Gauss-Newton steps on nearest samples; how many."""
    radius = model[RADIUS]
    equations, rest = work[:EQUATIONS], work[EQUATIONS:]
    step, before, scratch = rest[:6], rest[6:18], rest[18:]
    for taken in range(1, MATCH_STEPS + 1):
        equations[:] = 0.0
        for i in range(len(used)):
            if used[i]:
                best = _nearest(model, singles, contacts, CONTACT * i, pose)
                _add(model, contacts, i, best, pose, center, equations)
        if sight[0] != BLIND:
            add_sight(sight, pose, center, radius, equations, scratch)
        damped(equations, radius, 1e-9, step, scratch)
        before[:] = pose
        stepped(before, step, center, radius, pose)
        longest = 0.0
        for k in range(6):
            longest = max(longest, abs(step[k]))
        if longest < MATCH_TOLERANCE * radius:
            return taken
    return MATCH_STEPS
