"""The uncertainty of a pose: its calibrated information, its covariance, and the unobservable directions.

Information is judged in metres: coordinates (δp, radius δθ), so that a turn counts by how far it moves the surface.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, factor, from_eigen, in_metres, solve
from handsight._compiled.jit import inner
from handsight._compiled.records import UNCERTAINTY, VISION_PRIOR
from handsight._compiled.so3 import rotation_exp
from handsight._compiled.stack import local
from handsight._compiled.vec3 import (
    Pose,
    Vec3,
    add,
    cross,
    dot,
    matmul,
    matrix,
    mul,
    scale,
    scale33,
    sub,
    vector,
)
from handsight.correction.kernels.density import group_gain, information, largest_gain, posterior_cost
from handsight.correction.kernels.integration_options import CALIBRATION, INTEGRATION
from handsight.correction.kernels.prior_term import about_point, prior_square
from handsight.correction.kernels.terms import Evidence, walls_met


@inner
def retract_body(pose: Pose, step: tuple[Vec3, Vec3]) -> Pose:
    """Returns the pose after a step (s, δθ) that is straight along the object: `exp(δθ) R` and `p + exp(δθ) s`."""
    (R, p), (s, turn) = pose, step
    E = rotation_exp(turn)
    return matmul(E, R), add(p, mul(E, s))


@inner
def column(vectors: Any, k: int, length: float, radius: float) -> tuple[Vec3, Vec3]:
    """Returns the step (s, δθ) of a length [m] along the k-th eigenvector."""
    shift, turn = (vectors[0, k], vectors[1, k], vectors[2, k]), (vectors[3, k], vectors[4, k], vectors[5, k])
    return scale(shift, length), scale(turn, length / radius)


@inner
def calibrated_information(
    evidence: Evidence, pose: Pose, stride: float, values: Any, vectors: Any, rises: Any
) -> None:
    """Lowers the eigenvalues of an information [1/m²] to what the posterior's cost shows at a stride from the mode.

    At an edge, on a bumpy scan or along a bounded flat direction the slope of the residuals at the mode says little
    about the cost a standard deviation away. So the cost is read along each eigenvector on both sides, `stride`
    deviations away, where a Gaussian's has risen by the square of that; the eigenvalue is scaled by the ratio of the
    two, and again where that more than halved it. Written to `rises` (6) is that ratio on the steeper side: infinite
    where a deviation is as large as in an unobservable direction, and 0 where nothing is known.
    """
    radius = evidence.model.radius
    largest = 0.0
    here = 0.0
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
                # The mode itself comes first, as k = -1: only one place evaluates, for it is long to compile.
                step = column(vectors, max(k, 0), (-length if side else length) if k >= 0 else 0.0, radius)
                there = posterior_cost(evidence, retract_body(pose, step))
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
    """Returns the largest rise along a wide direction; infinite if more is unknown than spins about declared axes."""
    most = 0.0
    unknown = 0
    for k in range(6):
        if values[k] * (CALIBRATION.wide_sigma * model.radius) ** 2 < 1:
            most = max(most, rises[k])
        unknown += values[k] == 0.0
    return np.inf if unknown > model.symmetry.axes else most


@inner
def second_order_information(model: Any, least: float, row: Any, u: Any) -> bool:
    """Returns whether every direction is known of a posterior that is Gaussian along the object; writes its information
    and covariance.

    From the eigenvalues `u.values` [1/m²] and `u.vectors`; known is what is above `least`. The contacts are linear in a
    step `s` along the object's own, turned, axes: `δp = exp(δθ) s ≈ s + δθ × s`. Along the palm's axes a long step with
    an uncertain turn is therefore an arc, wider than the first order by the covariance of `δθ × s`. Deviations count up
    to the radius: what touches cannot move further. Unknown directions stay unknown.
    """
    radius = model.radius
    values = u.values
    vectors = u.vectors
    largest = 0.0
    known = 0
    for k in range(6):
        largest = max(largest, values[k])
    complete = True
    for k in range(6):  # the known ones move to the first columns
        u.row[k] = 0.0
        complete = complete and values[k] > least
        if values[k] > CALIBRATION.negligible * largest:
            values[known], u.row[known] = values[k], min(1 / values[k], radius * radius)
            for i in range(6):
                vectors[i, known] = vectors[i, k]
            known += 1
    from_eigen(u.row, vectors, 1 / radius, u.matrix)
    _arc_covariance(u.matrix, u.arc)
    arc = scale33(matrix(u.arc), 0.0 if row.first_order else 1.0)
    for a in range(known):
        va = vectors[0, a], vectors[1, a], vectors[2, a]
        for b in range(a + 1):
            bent = dot(va, mul(arc, (vectors[0, b], vectors[1, b], vectors[2, b])))
            u.wider[a, b] = u.wider[b, a] = bent + (1 / values[a] if a == b else 0.0)
    factor(u.wider, known, 0.0, u.factor)
    for j in range(known):
        for i in range(known):
            u.row[i] = 1.0 if i == j else 0.0
        solve(u.factor, known, u.row, u.column)
        for i in range(known):
            u.matrix[i, j] = u.column[i]
    _sandwich(vectors, known, u.matrix, radius, row.information)
    _sandwich(vectors, known, u.wider, 1 / radius, row.covariance)
    return complete and known == 6


@inner
def _sandwich(vectors: Any, known: int, middle: Any, turn: float, out: Any) -> None:
    """Fills `out` (6, 6) with V M Vᵀ, V the first `known` vectors, the rows and columns of δθ multiplied by `turn`."""
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
    """Fills `out` (3, 3) with the covariance of `δθ × s`, (s, δθ) being Gaussian with covariance C (Isserlis)."""
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
    """Returns how many directions touch leaves open; writes them, orthonormal (δp, radius δθ) about the origin, to the
    first rows of `out`.

    They are judged about the object's center: an origin far from the object swings by metres where the object itself
    hardly turns.
    """
    radius = model.radius
    count = 0
    limit = 1 / (CALIBRATION.open_sigma * radius) ** 2
    lever = mul(pose[0], vector(model.center))
    about_point(by_touch, lever, u.matrix)
    in_metres(u.matrix, radius, u.wider)
    if factor(u.wider, 6, -limit, u.factor):
        return 0
    eigen(u.wider, u.values, u.vectors)
    for k in range(6):
        if u.values[k] < limit:
            shift, turn = column(u.vectors, k, 1.0, radius)
            # δp at the origin is that of the center less the turn's part.
            moved = sub(shift, cross(turn, lever)) + scale(turn, radius)
            row = out[count]
            square = 0.0
            for i in range(6):
                row[i] = moved[i]
            for earlier in range(count):  # Gram-Schmidt
                along = 0.0
                for i in range(6):
                    along += row[i] * out[earlier, i]
                for i in range(6):
                    row[i] -= along * out[earlier, i]
            for i in range(6):
                square += row[i] * row[i]
            for i in range(6):
                row[i] /= np.sqrt(square)
            count += 1
    return count


@inner
def _shape(evidence: Evidence, pose: Pose, row: Any, flat: Any, u: Any) -> None:
    """Fills in the shape of a mode by its information: eigenvectors and eigenvalues, as they are and, in `u.values`
    too, calibrated by the cost, and how much the cost rises along them; and the answer's departure from a Gaussian.

    Where a mean is wanted, the cost along the wide ones is also read as far away as walls may be.
    """
    radius = evidence.model.radius
    row.departure = 0.0
    in_metres(row.information, radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for i in range(6):
        flat.slopes[i] = flat.calibrated[i] = u.values[i]
        flat.rises[i] = 0.0
        for j in range(6):
            flat.vectors[i, j] = u.vectors[i, j]
    for far in range(0 if row.first_order else 2):
        stride = INTEGRATION.wall_stride if far else CALIBRATION.stride
        calibrated_information(evidence, pose, stride, u.values, u.vectors, u.row)
        if not far:
            row.departure = _departure(evidence.model, u.values, u.row)
        not_gaussian = row.departure > INTEGRATION.max_gaussian_rise
        for k in range(6):
            wide = flat.slopes[k] * (INTEGRATION.narrow_sigma * radius) ** 2 < 1
            if not far:
                flat.calibrated[k] = u.values[k]
                u.row[k] = u.row[k] if u.values[k] > 0 else np.inf
            if wide:
                flat.rises[k] = max(flat.rises[k], u.row[k])
            u.values[k] = flat.slopes[k] if wide and flat.rises[k] < np.inf else 0.0
        if not (row.mean == 2 or (row.mean == 1 and not_gaussian)):
            break
    for k in range(6):
        u.values[k] = flat.calibrated[k]


@inner
def summarize(evidence: Evidence, pose: Pose, row: Any, flat: Any) -> None:
    """Fills in an ANSWER of a pose, all but the pose itself, and the shape of its mode."""
    model = evidence.model
    u = local(UNCERTAINTY)
    chi2, cost = information(evidence, pose, row.information, u)
    row.chi2, row.posterior_cost = chi2, cost
    row.walls = walls_met(evidence, pose) if u.walls[6, 6] > 0 else 0
    row.gain = largest_gain(evidence, u)
    row.prior_gain = max(group_gain(evidence, u.prior, u), prior_square(evidence.prior, pose))
    row.outside_gain = group_gain(evidence, u.walls, u)
    row.open_count = unobservable(model, u.by_touch, pose, row.unobservable, u)
    _shape(evidence, pose, row, flat, u)
    least = 0.0 if evidence.prior.kind == VISION_PRIOR else 1 / (CALIBRATION.open_sigma * model.radius) ** 2
    row.complete = second_order_information(model, least, row, u)
    row.rows = 0
    for i in range(len(evidence.terms)):
        contact = evidence.terms[i].contact
        if contact.used:
            row.rows += 3 if contact.has_normal else 1
    row.rows += 3 if evidence.constraints.weight.known else 0
