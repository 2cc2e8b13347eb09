"""What is known of a pose: its calibrated information, its covariance, and the directions that are open.

Information is judged in metres: coordinates (δp, radius δθ), so that a turn counts by what it moves.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.outside_term import NEVER_MEASURED, nearby
from handsight._kernels.evidence.prior_term import IDENTITY
from handsight._kernels.evidence.terms import Evidence
from handsight._kernels.math.dense6 import eigen, factor, in_metres, solve
from handsight._kernels.math.simd import local
from handsight._kernels.math.vec3 import (
    Vec3,
    add,
    add33,
    cross,
    matmul,
    matrix,
    mul,
    norm,
    scale,
    scale33,
    skew,
    sub,
    vector,
)
from handsight._kernels.posterior.density import information, largest_gain, posterior_cost
from handsight._kernels.posterior.options import CALIBRATION
from handsight._kernels.records import OUTSIDE, UNCERTAINTY, VISION_PRIOR
from handsight._kernels.runtime.compilation import inner


@inner
def retract_body(pose: Pose, flat: tuple[Vec3, Vec3]) -> Pose:
    """Returns the pose after a slide (s, δθ), straight along the object: `exp(δθ) R` and `p + exp(δθ) s`."""
    (R, p), (s, w) = pose, flat
    half = 0.5 * norm(w)
    ratio = np.sin(half) / half if half > 1e-9 else 1.0
    S = skew(w)
    E = add33(IDENTITY, add33(scale33(S, ratio * np.cos(half)), scale33(matmul(S, S), 0.5 * ratio * ratio)))
    return matmul(E, R), add(p, mul(E, s))


@inner
def _column(vectors: Any, k: int, length: float, radius: float) -> tuple[Vec3, Vec3]:
    """Returns the slide of a length [m] along the k-th eigenvector."""
    shift, turn = (vectors[0, k], vectors[1, k], vectors[2, k]), (vectors[3, k], vectors[4, k], vectors[5, k])
    return scale(shift, length), scale(turn, length / radius)


@inner
def calibrated_information(
    evidence: Evidence, pose: Pose, stride: float, values: Any, vectors: Any, rises: Any
) -> None:
    """Lowers the eigenvalues of an information [1/m²] to what the posterior's own cost does a stride away.

    At an edge, on a bumpy scan or along a bounded slide the slope of the residuals at the mode tells little about a
    standard deviation away. Along each eigenvector the cost is read on both sides at `stride` deviations, where a
    Gaussian's has risen by its square; the eigenvalue is scaled by what it did, again where that was more than halving
    it. `rises` (6): how much more than a Gaussian's the cost rose to the steeper side, as a ratio; infinite where a
    deviation is an open direction's, and 0 where nothing is known.
    """
    model, largest, here = evidence.model, 0.0, 0.0
    radius = model.radius
    near, clearances, rows = evidence, NEVER_MEASURED, np.empty(len(evidence.outside), OUTSIDE)
    for k in range(6):
        largest = max(largest, values[k])
    for k in range(-1, 6):
        if k >= 0 and not values[k] > CALIBRATION.negligible * largest:
            values[k] = rises[k] = 0.0
            continue
        for again in range(CALIBRATION.secant_passes):
            length = stride * min(1 / np.sqrt(values[max(k, 0)]), radius / 2)
            change = steeper = 0.0
            for side in range(2):
                # Before the eigenvectors, the mode itself: one place evaluates, for it is long to compile.
                flat = _column(vectors, max(k, 0), (-length if side else length) if k >= 0 else 0.0, radius)
                beside = retract_body(pose, flat)
                if len(rows):
                    clearances = nearby(evidence, model.fine, beside, clearances, rows)
                    left = rows[: clearances[1]]
                    near = Evidence(
                        model,
                        evidence.nodes,
                        evidence.terms,
                        left,
                        evidence.weight,
                        evidence.prior,
                        evidence.center,
                    )
                there = posterior_cost(near, beside)
                if k < 0:
                    here = there
                    break
                rise = (there - here) / (length * length * values[k])
                change += 0.5 * min(max(rise, CALIBRATION.min_factor), 1.0)
                steeper = max(steeper, rise)
            if k < 0:
                break
            if again == 0:
                rises[k] = steeper if values[k] * (CALIBRATION.open_sigma * radius) ** 2 > 1 else np.inf
            values[k] *= change
            if change > 0.5:
                break


@inner
def _departure(model: Any, values: Any, rises: Any) -> float:
    """Returns the largest of the rises along slides; infinite where more is unknown than turns about declared axes."""
    most, unknown = 0.0, 0
    for k in range(6):
        if values[k] * (CALIBRATION.wide_sigma * model.radius) ** 2 < 1:
            most = max(most, rises[k])
        unknown += values[k] == 0.0
    return np.inf if unknown > model.symmetry.axes else most


@inner
def second_order_information(model: Any, least: float, row: Any, u: Any) -> bool:
    """Returns whether all is known of a posterior that is Gaussian along the object; writes its information and
    covariance.

    From `u.values` [1/m²] and `u.vectors`; known is what is above `least`. The contacts are linear in a slide `s` along
    the object's own, turned, axes: `δp = exp(δθ) s ≈ s + δθ × s`. Along the palm's axes a long slide with an uncertain
    turn is therefore an arc, wider than the first order says by the covariance of `δθ × s`. Deviations count up to the
    radius: what touches cannot slide further. Unknown directions stay unknown.
    """
    radius, values, vectors = model.radius, u.values, u.vectors
    known, complete = _keep_known(values, vectors, least)
    for k in range(known):
        u.row[k] = min(1 / values[k], radius * radius)
    for i in range(6):
        for j in range(6):
            value = 0.0
            for k in range(known):
                value += vectors[i, k] * u.row[k] * vectors[j, k]
            u.matrix[i, j] = value * ((1.0 if i < 3 else 1 / radius) * (1.0 if j < 3 else 1 / radius))
    _arc_covariance(u.matrix, u.arc)
    arc = scale33(matrix(u.arc), 0.0 if row.first_order else 1.0)
    for a in range(known):
        va = vectors[0, a], vectors[1, a], vectors[2, a]
        for b in range(a + 1):
            along = mul(arc, (vectors[0, b], vectors[1, b], vectors[2, b]))
            value = (
                va[0] * along[0] + va[1] * along[1] + va[2] * along[2] + (1 / values[a] if a == b else 0.0)
            )
            u.wider[a, b] = u.wider[b, a] = value
    factor(u.wider, known, 0.0, u.factor)
    for j in range(known):
        for i in range(known):
            u.row[i] = 1.0 if i == j else 0.0
        solve(u.factor, known, u.row, u.column)
        for i in range(known):
            u.matrix[i, j] = u.column[i]
    _sandwich(vectors, known, u.matrix, radius, row.information)
    _sandwich(vectors, known, u.wider, 1 / radius, row.covariance)
    return complete


@inner
def _keep_known(values: Any, vectors: Any, least: float) -> tuple[int, bool]:
    """Returns how many directions are known, moved to the first columns; whether all are, better than `least`."""
    largest, known = 0.0, 0
    for k in range(6):
        largest = max(largest, values[k])
    for k in range(6):
        if values[k] > CALIBRATION.negligible * largest:
            values[known] = values[k]
            for i in range(6):
                vectors[i, known] = vectors[i, k]
            known += 1
    complete = known == 6
    for k in range(known):
        complete = complete and values[k] > least
    return known, complete


@inner
def _sandwich(vectors: Any, known: int, middle: Any, turn: float, out: Any) -> None:
    """Computes `vectors @ middle @ vectorsᵀ`, turns scaled by `turn`."""
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for a in range(known):
                row = 0.0
                for b in range(known):
                    row += middle[a, b] * vectors[j, b]
                value += vectors[i, a] * row
            out[i, j] = out[j, i] = value * ((1.0 if i < 3 else turn) * (1.0 if j < 3 else turn))


@inner
def _arc_covariance(C: Any, out: Any) -> None:
    """Fills `out` (3, 3) with the covariance of `δθ × s` for (s, δθ) Gaussian with covariance C (Isserlis)."""
    for k in range(3):
        i, j = 3 + (k + 1) % 3, 3 + (k + 2) % 3
        for n in range(3):
            p, q = (n + 1) % 3, (n + 2) % 3
            # (θ_i s_j - θ_j s_i)(θ_p s_q - θ_q s_p); s_j is the number j - 3.
            out[k, n] = (
                (C[i, 3 + p] * C[j - 3, q] + C[i, q] * C[j - 3, 3 + p])
                - (C[i, 3 + q] * C[j - 3, p] + C[i, p] * C[j - 3, 3 + q])
                - (C[j, 3 + p] * C[i - 3, q] + C[j, q] * C[i - 3, 3 + p])
                + (C[j, 3 + q] * C[i - 3, p] + C[j, p] * C[i - 3, 3 + q])
            )


@inner
def unobservable(model: Any, by_touch: Any, pose: Pose, out: Any, u: Any) -> int:
    """Returns how many directions touch leaves open; writes them, orthonormal (δp, radius δθ) at the origin, to rows
    of `out`.

    Judged at the object's center: an origin far from the object swings by metres where the object itself hardly turns.
    """
    radius = model.radius
    limit = 1 / (CALIBRATION.open_sigma * radius) ** 2
    lever = mul(pose[0], vector(model.center))
    _at_center(by_touch, lever, u.matrix)
    in_metres(u.matrix, radius, u.wider)
    if factor(u.wider, 6, -limit, u.factor):
        return 0
    eigen(u.wider, u.values, u.vectors)
    count = 0
    for k in range(6):
        if u.values[k] < limit:
            shift, turn = _column(u.vectors, k, 1.0, radius)
            # δp at the origin is that of the center less the turn's part.
            moved = sub(shift, cross(turn, lever)) + scale(turn, radius)
            for i in range(6):
                out[count, i] = moved[i]
            _orthonormalize(out, count)
            count += 1
    return count


@inner
def _orthonormalize(rows: Any, n: int) -> None:
    """Makes row n, at right angles to those before it and of unit length."""
    row = rows[n]
    for earlier in range(n):
        along = 0.0
        for i in range(6):
            along += row[i] * rows[earlier, i]
        for i in range(6):
            row[i] -= along * rows[earlier, i]
    square = 0.0
    for i in range(6):
        square += row[i] * row[i]
    for i in range(6):
        row[i] /= np.sqrt(square)


@inner
def _at_center(matrix: Any, lever: Vec3, out: Any) -> None:
    """Fills `out` = FᵀMF for F = [1, [lever]x; 0, 1]."""
    for i in range(6):
        row = (matrix[i, 0], matrix[i, 1], matrix[i, 2])
        turned = cross(row, lever)
        for j in range(3):
            out[i, j], out[i, 3 + j] = row[j], matrix[i, 3 + j] + turned[j]
    for j in range(6):
        turned = cross((out[0, j], out[1, j], out[2, j]), lever)
        for i in range(3):
            out[3 + i, j] += turned[i]


@inner
def summarize(evidence: Evidence, pose: Pose, row: Any) -> None:
    """Fills in everything that an answer says beside its pose."""
    model, u = evidence.model, local(UNCERTAINTY)
    chi2, cost = information(evidence, pose, u.by_touch, row.information, u.equations)
    row.chi2, row.posterior_cost = chi2, cost
    row.gain = largest_gain(evidence, u)
    row.open_count = unobservable(model, u.by_touch, pose, row.unobservable, u)
    in_metres(row.information, model.radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    if not row.first_order:
        calibrated_information(evidence, pose, CALIBRATION.stride, u.values, u.vectors, u.row)
    row.departure = 0.0 if row.first_order else _departure(model, u.values, u.row)
    least = 0.0 if evidence.prior.kind == VISION_PRIOR else 1 / (CALIBRATION.open_sigma * model.radius) ** 2
    row.complete = second_order_information(model, least, row, u)
    row.rows = 0
    for i in range(len(evidence.terms)):
        contact = evidence.terms[i].contact
        if contact.used:
            row.rows += 3 if contact.has_normal else 1
    row.rows += 3 if evidence.weight.known else 0
