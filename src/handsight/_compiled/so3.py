"""Rotations and their rotation vectors [rad]."""

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.vec3 import Mat33, Vec3, add33, dot, matmul, norm, outer, scale, scale33, skew

IDENTITY: Mat33 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@inner
def about_normal(n: Vec3) -> Mat33:
    """Returns a rotation that brings a unit normal to +x, the same for the same normal (Duff et al. 2017)."""
    sign = -1.0 if n[2] < 0.0 else 1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return n, (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@inner
def rotation_about(axis: Vec3, cosine: float, sine: float) -> Mat33:
    """Returns the rotation about a unit axis, by an angle with that cosine and sine (Rodrigues)."""
    along = scale33(outer(axis, axis), 1 - cosine)
    across = scale33(skew(axis), sine)
    return add33(add33(scale33(IDENTITY, cosine), across), along)


@inner
def rotation_exp(turn: Vec3) -> Mat33:
    """Returns the rotation of a rotation vector."""
    half = 0.5 * norm(turn)
    ratio = np.sin(half) / half if half > 1e-9 else 1.0
    S = skew(turn)
    first = scale33(S, ratio * np.cos(half))
    second = scale33(matmul(S, S), 0.5 * ratio * ratio)
    return add33(IDENTITY, add33(first, second))


@inner
def rotation_log(Q: Mat33) -> Vec3:
    """Returns the rotation vector of a rotation; exact near 0 and near π."""
    v = (Q[2][1] - Q[1][2]) / 2, (Q[0][2] - Q[2][0]) / 2, (Q[1][0] - Q[0][1]) / 2
    sine = norm(v)
    trace = Q[0][0] + Q[1][1] + Q[2][2]
    cosine = (trace - 1) / 2
    if cosine >= -0.9:
        return scale(v, np.arctan2(sine, cosine) / sine if sine >= 1e-9 else 1.0)
    # Near π the quaternion keeps the axis: the longest column of 4 q qᵀ, real part w last.
    if Q[0][0] >= Q[1][1] and Q[0][0] >= Q[2][2]:
        q = (1 + 2 * Q[0][0] - trace, Q[0][1] + Q[1][0], Q[0][2] + Q[2][0])
        w = 2 * v[0]
    elif Q[1][1] >= Q[2][2]:
        q = (Q[0][1] + Q[1][0], 1 + 2 * Q[1][1] - trace, Q[1][2] + Q[2][1])
        w = 2 * v[1]
    else:
        q = (Q[0][2] + Q[2][0], Q[1][2] + Q[2][1], 1 + 2 * Q[2][2] - trace)
        w = 2 * v[2]
    length = norm(q)
    angle = 2 * np.arctan2(length, abs(w))
    return scale(q, (-angle if w < 0 else angle) / length)


@inner
def log_derivative(turn: Vec3) -> Mat33:
    """Returns the derivative of a rotation vector w by a further turn: 1 - [w]x/2 + b [w]x²."""
    square = dot(turn, turn)
    half = 0.5 * np.sqrt(square)
    b = 1 / 12 + half * half / 180
    if half >= 5e-3:
        b = (1 - half / np.tan(half)) / (4 * half * half)
    S = skew(turn)
    return add33(add33(IDENTITY, scale33(S, -0.5)), scale33(matmul(S, S), b))
