"""From a minimum to what is known about it: what its information claims, covariance, open directions.

Twin: `handsight.correction.modes`.
"""

from typing import Any

import numpy as np

from handsight._kernels.algebra import eigen, factor, inverted
from handsight._kernels.compiled import inner
from handsight._kernels.layout import (
    CENTER,
    RADIUS,
)  # fmt: skip
from handsight._kernels.posterior import cost
from handsight._kernels.settings import KNOWN, LEAST_FACTOR, OPEN, SECANT_PASSES, STRIDE


@inner
def slid(pose: Any, vectors: Any, k: int, length: float, radius: float, out: Any) -> None:
    """`pose` after a slide of `length` along the k-th column of `vectors` (6, 6): `exp(δθ) R` and `p + exp(δθ) s`."""
    sx, sy, sz = length * vectors[k], length * vectors[6 + k], length * vectors[12 + k]
    x, y, z = (
        length * vectors[18 + k] / radius,
        length * vectors[24 + k] / radius,
        length * vectors[30 + k] / radius,
    )
    half = 0.5 * np.sqrt(x * x + y * y + z * z)
    ratio = np.sin(half) / half if half > 1e-9 else 1.0
    a, b = ratio * np.cos(half), 0.5 * ratio * ratio
    square = x * x + y * y + z * z
    E0, E1, E2 = 1 + b * (x * x - square), b * x * y - a * z, b * x * z + a * y
    E3, E4, E5 = b * x * y + a * z, 1 + b * (y * y - square), b * y * z - a * x
    E6, E7, E8 = b * x * z - a * y, b * y * z + a * x, 1 + b * (z * z - square)
    for j in range(3):
        p, q, r = pose[j], pose[3 + j], pose[6 + j]
        out[j], out[3 + j], out[6 + j] = (
            E0 * p + E1 * q + E2 * r,
            E3 * p + E4 * q + E5 * r,
            E6 * p + E7 * q + E8 * r,
        )
    out[9] = pose[9] + E0 * sx + E1 * sy + E2 * sz
    out[10] = pose[10] + E3 * sx + E4 * sy + E5 * sz
    out[11] = pose[11] + E6 * sx + E7 * sy + E8 * sz


@inner
def in_metres(total: Any, radius: float, out: Any) -> None:
    """Information by (δp, radius δθ)."""
    scale = 1 / radius
    for i in range(6):
        for j in range(6):
            out[6 * i + j] = total[6 * i + j] * ((1.0 if i < 3 else scale) * (1.0 if j < 3 else scale))


@inner
def secant(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, anchor: Any, hand: Any, pose: Any, values: Any,
    vectors: Any, work: Any,
) -> None:  # fmt: skip
    """Lowers the eigenvalues of an information [1/m²] to what the posterior's own cost does a stride away."""
    radius = model[RADIUS]
    other, rest = work[:12], work[12:]
    largest = 0.0
    for k in range(6):
        largest = max(largest, values[k])
    here = cost(model, singles, contacts, used, sight, anchor, hand, pose, rest)
    for k in range(6):
        if not values[k] > KNOWN * largest:
            values[k] = 0.0
        else:
            for _ in range(SECANT_PASSES):
                length = STRIDE * min(1 / np.sqrt(values[k]), radius / 2)
                change = 0.0
                for side in range(2):
                    slid(pose, vectors, k, -length if side else length, radius, other)
                    there = cost(model, singles, contacts, used, sight, anchor, hand, other, rest)
                    rise = (there - here) / (length * length * values[k])
                    change += 0.5 * min(max(rise, LEAST_FACTOR), 1.0)
                values[k] *= change
                if change > 0.5:
                    break


@inner
def spread(values: Any, vectors: Any, radius: float, least: float, total: Any, sigma: Any, work: Any) -> bool:
    """Information and covariance (6, 6) by (δp, δθ) of a posterior that is Gaussian along the object.

    Whether all is known: of values above `least`. `work` (200).
    """
    bounded, arc, wider, factored, rest = work[:36], work[36:45], work[45:81], work[81:117], work[117:]
    largest = 0.0
    for k in range(6):
        largest = max(largest, values[k])
    known = 0
    for k in range(6):
        if values[k] > KNOWN * largest:
            values[known] = values[k]
            for i in range(6):
                vectors[6 * i + known] = vectors[6 * i + k]
            known += 1
    complete = known == 6
    for k in range(known):
        complete = complete and values[k] > least
    scale = 1 / radius
    for k in range(known):
        rest[k] = min(1 / values[k], radius * radius)
    for i in range(6):
        for j in range(6):
            value = 0.0
            for k in range(known):
                value += vectors[6 * i + k] * rest[k] * vectors[6 * j + k]
            bounded[6 * i + j] = value * ((1.0 if i < 3 else scale) * (1.0 if j < 3 else scale))
    _arc(bounded, arc)
    for a in range(known):
        for b in range(a + 1):
            value = 1 / values[a] if a == b else 0.0
            for i in range(3):
                for j in range(3):
                    value += vectors[6 * i + a] * arc[3 * i + j] * vectors[6 * j + b]
            wider[known * a + b] = wider[known * b + a] = value
    factor(wider, known, known, 0.0, factored)
    inverted(factored, known, bounded, rest)
    _product(vectors, known, bounded, radius, 1.0, total)
    _product(vectors, known, wider, radius, -1.0, sigma)
    return complete


@inner
def _product(vectors: Any, known: int, middle: Any, radius: float, power: float, out: Any) -> None:
    """vectors @ middle @ vectorsᵀ, its turns scaled by the radius, or by one over it."""
    scale = radius if power > 0 else 1 / radius
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for a in range(known):
                row = 0.0
                for b in range(known):
                    row += middle[known * a + b] * vectors[6 * j + b]
                value += vectors[6 * i + a] * row
            value *= (1.0 if i < 3 else scale) * (1.0 if j < 3 else scale)
            out[6 * i + j] = out[6 * j + i] = value


@inner
def _arc(C: Any, out: Any) -> None:
    """Covariance (3, 3) of `δθ × s` for (s, δθ) Gaussian with covariance C (Isserlis)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        for n in range(3):
            p, q = (n + 1) % 3, (n + 2) % 3
            # (θ_i s_j - θ_j s_i)(θ_p s_q - θ_q s_p)
            out[3 * k + n] = (
                _pair(C, 3 + i, j, 3 + p, q)
                - _pair(C, 3 + i, j, 3 + q, p)
                - _pair(C, 3 + j, i, 3 + p, q)
                + _pair(C, 3 + j, i, 3 + q, p)
            )


@inner
def _pair(C: Any, a: int, b: int, c: int, d: int) -> float:
    return C[6 * a + c] * C[6 * b + d] + C[6 * a + d] * C[6 * b + c]


@inner
def unobservable(model: Any, by_touch: Any, pose: Any, out: Any, work: Any) -> int:
    """Writes the directions (k, 6) that touch leaves open, orthonormal at the origin; k. `work` (200)."""
    radius = model[RADIUS]
    at_middle, vectors, values, lever = work[:36], work[36:72], work[72:78], work[78:81]
    factored = work[81:117]
    for i in range(3):
        row = pose[3 * i : 3 * i + 3]
        lever[i] = row[0] * model[CENTER] + row[1] * model[CENTER + 1] + row[2] * model[CENTER + 2]
    _moved(by_touch, lever, at_middle, factored)
    in_metres(at_middle, radius, vectors)
    limit = 1 / (OPEN * radius) ** 2
    if factor(vectors, 6, 6, -limit, factored):
        return 0
    at_middle[:] = vectors
    eigen(at_middle, 6, values, vectors)
    count = 0
    for k in range(6):
        if values[k] < limit:
            # δp at the origin is that of the middle less the turn's part: δp - δθ × lever.
            x, y, z = vectors[18 + k] / radius, vectors[24 + k] / radius, vectors[30 + k] / radius
            row = out[6 * count : 6 * count + 6]
            row[0] = vectors[k] - (y * lever[2] - z * lever[1])
            row[1] = vectors[6 + k] - (z * lever[0] - x * lever[2])
            row[2] = vectors[12 + k] - (x * lever[1] - y * lever[0])
            for i in range(3):
                row[3 + i] = vectors[6 * (3 + i) + k]
            for earlier in range(count):
                along = 0.0
                for i in range(6):
                    along += row[i] * out[6 * earlier + i]
                for i in range(6):
                    row[i] -= along * out[6 * earlier + i]
            length = 0.0
            for i in range(6):
                length += row[i] * row[i]
            length = np.sqrt(length)
            for i in range(6):
                row[i] /= length
            count += 1
    return count


@inner
def _moved(matrix: Any, lever: Any, out: Any, half: Any) -> None:
    """`FᵀMF` for F = [1, skew(lever); 0, 1]."""
    x, y, z = lever[0], lever[1], lever[2]
    for i in range(6):
        a, b, c = matrix[6 * i], matrix[6 * i + 1], matrix[6 * i + 2]
        half[6 * i], half[6 * i + 1], half[6 * i + 2] = a, b, c
        half[6 * i + 3] = matrix[6 * i + 3] + b * z - c * y
        half[6 * i + 4] = matrix[6 * i + 4] - a * z + c * x
        half[6 * i + 5] = matrix[6 * i + 5] + a * y - b * x
    for j in range(6):
        a, b, c = half[j], half[6 + j], half[12 + j]
        out[j], out[6 + j], out[12 + j] = a, b, c
        out[18 + j] = half[18 + j] + b * z - c * y
        out[24 + j] = half[24 + j] - a * z + c * x
        out[30 + j] = half[30 + j] + a * y - b * x
