"""Contacts as evidence: distance and normal, whitened together, their rows added to the normal equations.

Twin: `handsight.correction.evidence.Touch`. A pose is 12 numbers: rotation row by row, position.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import inner
from handsight._kernels.field import look
from handsight._kernels.layout import (
    BALL,
    BLUR,
    CONTACT,
    COVARIANCE,
    HAS_NORMAL,
    LEAST_ROUGH,
    NORMAL,
    POINT,
    ROUGH,
    ROUGH_CELL,
    ROUGH_ORIGIN,
    ROUGH_SHAPE,
    VARIANCE,
)  # fmt: skip
from handsight._kernels.vectors import accumulate

Three = tuple[float, float, float]

# What `surface` writes, along the palm's axes but for the last.
DISTANCE, SLOPE, FACING, BEND, PLACE = 0, 1, 4, 7, 16
SURFACE = 19
WHITE = 16
"""Numbers of a contact's weight: the inverse covariance (4, 4) of its residuals, zeros for what does not count."""


@inner
def surface(model: Any, singles: Any, field: int, x: Any, at: int, pose: Any, out: Any) -> None:
    """The surface near the palm point at `x[at]`: distance, its gradient, unit normal, curvature, place."""
    R = pose
    lx, ly, lz = x[at] - R[9], x[at + 1] - R[10], x[at + 2] - R[11]
    px = lx * R[0] + ly * R[3] + lz * R[6]
    py = lx * R[1] + ly * R[4] + lz * R[7]
    pz = lx * R[2] + ly * R[5] + lz * R[8]
    d, ox, oy, oz, xx, xy, xz, yy, yz, zz = look(model, singles, field, px, py, pz)
    gx = R[0] * ox + R[1] * oy + R[2] * oz
    gy = R[3] * ox + R[4] * oy + R[5] * oz
    gz = R[6] * ox + R[7] * oy + R[8] * oz
    s = 1 / max(np.sqrt(gx * gx + gy * gy + gz * gz), 1e-9)
    nx, ny, nz = gx * s, gy * s, gz * s
    out[DISTANCE] = d
    out[SLOPE], out[SLOPE + 1], out[SLOPE + 2] = gx, gy, gz
    out[FACING], out[FACING + 1], out[FACING + 2] = nx, ny, nz
    out[PLACE], out[PLACE + 1], out[PLACE + 2] = px, py, pz
    # Hessian along the palm's axes: R H Rᵀ.
    a0, a1, a2 = _times(R, 0, xx, xy, xz, yy, yz, zz)
    b0, b1, b2 = _times(R, 3, xx, xy, xz, yy, yz, zz)
    c0, c1, c2 = _times(R, 6, xx, xy, xz, yy, yz, zz)
    hxx, hyy = a0 * R[0] + a1 * R[1] + a2 * R[2], b0 * R[3] + b1 * R[4] + b2 * R[5]
    hxy, hzz = a0 * R[3] + a1 * R[4] + a2 * R[5], c0 * R[6] + c1 * R[7] + c2 * R[8]
    hxz, hyz = a0 * R[6] + a1 * R[7] + a2 * R[8], b0 * R[6] + b1 * R[7] + b2 * R[8]
    # d(g/|g|) = (I - n nᵀ) dg / |g|
    vx, vy, vz = (
        nx * hxx + ny * hxy + nz * hxz,
        nx * hxy + ny * hyy + nz * hyz,
        nx * hxz + ny * hyz + nz * hzz,
    )
    out[BEND], out[BEND + 1], out[BEND + 2] = (hxx - nx * vx) * s, (hxy - nx * vy) * s, (hxz - nx * vz) * s
    out[BEND + 3], out[BEND + 4], out[BEND + 5] = (
        (hxy - ny * vx) * s,
        (hyy - ny * vy) * s,
        (hyz - ny * vz) * s,
    )
    out[BEND + 6], out[BEND + 7], out[BEND + 8] = (
        (hxz - nz * vx) * s,
        (hyz - nz * vy) * s,
        (hzz - nz * vz) * s,
    )


@inner
def _times(R: Any, row: int, xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> Three:
    """A row of a rotation times a symmetric matrix."""
    x, y, z = R[row], R[row + 1], R[row + 2]
    return x * xx + y * xy + z * xz, x * xy + y * yy + z * yz, x * xz + y * yz + z * zz


@inner
def add_touch(
    contacts: Any, i: int, s: Any, weight: Any, at: int, center: Any, radius: float, equations: Any
) -> None:
    """Adds contact i at its surface `s`, weighted by the (4, 4) at `weight[at:]`, by (τ, radius ω)."""
    c = CONTACT * i
    r = 1 / radius
    x, y, z = (
        (contacts[c] - center[0]) * r,
        (contacts[c + 1] - center[1]) * r,
        (contacts[c + 2] - center[2]) * r,
    )
    gx, gy, gz = -s[SLOPE], -s[SLOPE + 1], -s[SLOPE + 2]
    nx, ny, nz = s[FACING] * r, s[FACING + 1] * r, s[FACING + 2] * r
    ax, ay, az = -s[BEND], -s[BEND + 1], -s[BEND + 2]
    bx, by, bz = -s[BEND + 3], -s[BEND + 4], -s[BEND + 5]
    cx, cy, cz = -s[BEND + 6], -s[BEND + 7], -s[BEND + 8]
    # The derivative by a turn is the lever's cross product with that by a shift; a normal turns by itself too.
    rows = (
        gx, gy, gz, y * gz - z * gy, z * gx - x * gz, x * gy - y * gx,
        s[DISTANCE],
        ax, ay, az, y * az - z * ay, z * ax - x * az + nz, x * ay - y * ax - ny,
        s[FACING] - contacts[c + NORMAL],
        bx, by, bz, y * bz - z * by - nz, z * bx - x * bz, x * by - y * bx + nx,
        s[FACING + 1] - contacts[c + NORMAL + 1],
        cx, cy, cz, y * cz - z * cy + ny, z * cx - x * cz - nx, x * cy - y * cx,
        s[FACING + 2] - contacts[c + NORMAL + 2],
    )  # fmt: skip
    accumulate(weight, at, rows, equations)


@inner
def scatter(model: Any, contacts: Any, i: int, s: Any, blurred: bool, S: Any, work: Any) -> None:
    """Covariance (4, 4) of contact i's distance and normal residuals, its lower triangle; `work` (24)."""
    c = CONTACT * i
    v = c + COVARIANCE
    if contacts[c + BALL] > 0:
        _of_ball(contacts[c + VARIANCE], s, contacts, v, S)
    else:
        _of_any(s, contacts, v, S, work)
    point, normal = roughness(model, s[PLACE], s[PLACE + 1], s[PLACE + 2])
    if blurred:
        point += model[BLUR]
        normal += model[BLUR + 1]
    S[0] += point
    for k in range(1, 4):
        S[5 * k] += normal
    tangential = (S[5] + S[10] + S[15]) / 2
    nx, ny, nz = contacts[c + NORMAL], contacts[c + NORMAL + 1], contacts[c + NORMAL + 2]
    # Along the normal itself, and where there is none, what keeps the matrix from being singular.
    rest = 0.0 if contacts[c + HAS_NORMAL] > 0 else 1.0
    S[5] += tangential * nx * nx + rest
    S[9] += tangential * ny * nx
    S[10] += tangential * ny * ny + rest
    S[13] += tangential * nz * nx
    S[14] += tangential * nz * ny
    S[15] += tangential * nz * nz + rest


@inner
def _of_ball(variance: float, s: Any, contacts: Any, v: int, S: Any) -> None:
    """The scatter of a point as uncertain in every direction, and of a normal that knows nothing of it."""
    gx, gy, gz = s[SLOPE] * variance, s[SLOPE + 1] * variance, s[SLOPE + 2] * variance
    ax, ay, az = s[BEND], s[BEND + 1], s[BEND + 2]
    bx, by, bz = s[BEND + 3], s[BEND + 4], s[BEND + 5]
    cx, cy, cz = s[BEND + 6], s[BEND + 7], s[BEND + 8]
    S[0] = gx * s[SLOPE] + gy * s[SLOPE + 1] + gz * s[SLOPE + 2]
    S[4] = gx * ax + gy * ay + gz * az
    S[8] = gx * bx + gy * by + gz * bz
    S[12] = gx * cx + gy * cy + gz * cz
    S[5] = variance * (ax * ax + ay * ay + az * az) + contacts[v + 21]
    S[9] = variance * (ax * bx + ay * by + az * bz) + contacts[v + 27]
    S[13] = variance * (ax * cx + ay * cy + az * cz) + contacts[v + 33]
    S[10] = variance * (bx * bx + by * by + bz * bz) + contacts[v + 28]
    S[14] = variance * (bx * cx + by * cy + bz * cz) + contacts[v + 34]
    S[15] = variance * (cx * cx + cy * cy + cz * cz) + contacts[v + 35]


@inner
def _of_any(s: Any, contacts: Any, v: int, S: Any, work: Any) -> None:
    """The scatter of any covariance; `work` (24)."""
    # Rows of B = [gradient 0; curvature -1] times the covariance, then times Bᵀ.
    for r in range(4):
        b = SLOPE if r == 0 else BEND + 3 * (r - 1)
        for k in range(6):
            value = s[b] * contacts[v + k] + s[b + 1] * contacts[v + 6 + k] + s[b + 2] * contacts[v + 12 + k]
            if r > 0:
                value -= contacts[v + 6 * (2 + r) + k]
            work[6 * r + k] = value
    for r in range(4):
        for q in range(r + 1):
            b = SLOPE if q == 0 else BEND + 3 * (q - 1)
            value = work[6 * r] * s[b] + work[6 * r + 1] * s[b + 1] + work[6 * r + 2] * s[b + 2]
            if q > 0:
                value -= work[6 * r + 2 + q]
            S[4 * r + q] = value


@inner
def roughness(model: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """The model's own variances of distance and normal at an object point (twin: `evidence.variances`)."""
    point, normal = model[LEAST_ROUGH], model[LEAST_ROUGH + 1]
    inverse = model[ROUGH_CELL]
    if inverse == 0.0:
        return point, normal
    nx, ny, nz = model[ROUGH_SHAPE], model[ROUGH_SHAPE + 1], model[ROUGH_SHAPE + 2]
    u = _between((x - model[ROUGH_ORIGIN]) * inverse, nx - 1.001)
    v = _between((y - model[ROUGH_ORIGIN + 1]) * inverse, ny - 1.001)
    w = _between((z - model[ROUGH_ORIGIN + 2]) * inverse, nz - 1.001)
    i, j, k = int(u), int(v), int(w)
    u, v, w = u - i, v - j, w - k
    for a in range(2):
        for b in range(2):
            at = int(model[ROUGH]) + 2 * (((i + a) * int(ny) + j + b) * int(nz) + k)
            share = (u if a else 1 - u) * (v if b else 1 - v)
            point += share * ((1 - w) * model[at] + w * model[at + 2])
            normal += share * ((1 - w) * model[at + 1] + w * model[at + 3])
    return point, normal


@inner
def _between(u: float, most: float) -> float:
    low = u if u > 0.0 else 0.0
    return low if low < most else most


@inner
def weigh(S: Any, has_normal: bool, weight: Any, at: int) -> float:
    """Writes the inverse of `S` (4, 4) to `weight[at:]`; answers log det of what is in use."""
    if not has_normal:
        weight[at : at + WHITE] = 0.0
        weight[at] = 1 / S[0]
        return np.log(S[0])
    # S = L D Lᵀ; its inverse by that of L.
    d0 = 1 / S[0]
    l10, l20, l30 = S[4] * d0, S[8] * d0, S[12] * d0
    e1 = S[5] - S[4] * l10
    d1 = 1 / e1
    p21, p31 = S[9] - S[8] * l10, S[13] - S[12] * l10
    l21, l31 = p21 * d1, p31 * d1
    e2 = S[10] - S[8] * l20 - p21 * l21
    d2 = 1 / e2
    p32 = S[14] - S[12] * l20 - p31 * l21
    l32 = p32 * d2
    e3 = S[15] - S[12] * l30 - p31 * l31 - p32 * l32
    d3 = 1 / e3
    w32 = -l32
    w21, w31 = -l21, -l31 - l32 * -l21
    w10, w20 = -l10, -l20 - l21 * -l10
    w30 = -l30 - l31 * w10 - l32 * w20
    a, b, c = w30 * d3, w31 * d3, w32 * d3
    m = weight[at : at + WHITE]
    m[15] = d3
    m[12] = m[3] = a
    m[13] = m[7] = b
    m[14] = m[11] = c
    f, g = w20 * d2, w21 * d2
    m[10] = d2 + w32 * c
    m[8] = m[2] = f + w30 * c
    m[9] = m[6] = g + w31 * c
    m[5] = d1 + w21 * g + w31 * b
    m[4] = m[1] = w10 * d1 + w20 * g + w30 * b
    m[0] = d0 + w10 * w10 * d1 + w20 * f + w30 * a
    return np.log((S[0] * e1) * (e2 * e3))


@inner
def surprise(contacts: Any, i: int, s: Any, S: Any) -> tuple[float, float]:
    """Squared whitened residuals of contact i, and log det of their covariance `S`."""
    c = CONTACT * i
    r0 = s[DISTANCE]
    d0 = 1 / S[0]
    if not contacts[c + HAS_NORMAL] > 0:
        return r0 * r0 * d0, np.log(S[0])
    l10, l20, l30 = S[4] * d0, S[8] * d0, S[12] * d0
    e1 = S[5] - S[4] * l10
    p21, p31 = S[9] - S[8] * l10, S[13] - S[12] * l10
    d1 = 1 / e1
    l21, l31 = p21 * d1, p31 * d1
    e2 = S[10] - S[8] * l20 - p21 * l21
    p32 = S[14] - S[12] * l20 - p31 * l21
    d2 = 1 / e2
    l32 = p32 * d2
    e3 = S[15] - S[12] * l30 - p31 * l31 - p32 * l32
    r1 = s[FACING] - contacts[c + NORMAL] - l10 * r0
    r2 = s[FACING + 1] - contacts[c + NORMAL + 1] - l20 * r0 - l21 * r1
    r3 = s[FACING + 2] - contacts[c + NORMAL + 2] - l30 * r0 - l31 * r1 - l32 * r2
    return r0 * r0 * d0 + r1 * r1 * d1 + r2 * r2 * d2 + r3 * r3 / e3, np.log((S[0] * e1) * (e2 * e3))


@inner
def point_of(i: int) -> int:
    """Where contact i's point is."""
    return CONTACT * i + POINT
