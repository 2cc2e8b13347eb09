"""One point of the lattice along the flat directions: its best other coordinates, its weight, its part of the sums.

weight = exp(-cost / 2) / √det H,    H: Gauss-Newton Hessian across the flat directions, walls in it
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.terms import ALL, Evidence, add_evidence
from handsight._kernels.math.dense6 import factor, solve
from handsight._kernels.math.vec3 import Mat33, add, cross, matmul, mul, norm, scale, sub, transpose
from handsight._kernels.posterior.flat_directions import (
    at_coordinates,
    coordinates_at,
    moved_to,
    without_bumps,
)
from handsight._kernels.posterior.options import INTEGRATION
from handsight._kernels.runtime.compilation import inner


@inner
def _relax(flat: Any, E: Mat33, u: Any) -> bool:
    """Returns whether the step across the flat directions is determined.

    Written: `u.wider`, these directions (τ, radius ω) after the turn E that led to the point; `u.values` and
    `u.matrix`, gradient and Hessian along them; `u.column`, the step.
    """
    count = flat.count_across
    for a in range(count):
        shift = mul(E, (flat.across[0, a], flat.across[1, a], flat.across[2, a]))
        turn = mul(E, (flat.across[3, a], flat.across[4, a], flat.across[5, a]))
        six = shift + turn
        for i in range(6):
            u.wider[i, a] = six[i]
    for a in range(count):
        slope = 0.0
        for i in range(6):
            row = 0.0
            for j in range(6):
                row += u.equations[max(i, j), min(i, j)] * u.wider[j, a]
            u.column[i] = row
            slope += u.equations[6, i] * u.wider[i, a]
        u.values[a] = slope
        for b in range(count):
            value = 0.0
            for i in range(6):
                value += u.wider[i, b] * u.column[i]
            u.matrix[b, a] = value
    trace = 0.0
    for a in range(count):
        trace += u.matrix[a, a]
    if not factor(u.matrix, count, 1e-12 * trace, u.factor):
        return False
    solve(u.factor, count, u.values, u.column)
    return True


@inner
def visit(evidence: Evidence, mode: Pose, flat: Any, point: Any, sums: Any, u: Any) -> float:
    """Returns the log weight of a point, whose coordinates across become the best ones; adds it to the sums.

    The cost is that which the step across predicts: the contacts' covariances are taken as before the step.
    """
    count, fine = flat.count_across, evidence.model.fine
    coordinates_at(flat, point, u.row)
    pose = moved_to(evidence, mode, u.row)
    u.equations[:] = 0.0
    add_evidence(evidence, ALL, fine, pose, (evidence.center, evidence.model.radius), True, u.equations)
    if not _relax(flat, matmul(pose[0], transpose(mode[0])), u):
        return -np.inf
    cost = u.equations[6, 6]
    for a in range(count):
        cost -= u.values[a] * u.column[a]
        point.lateral[a] -= u.column[a]
    for i in range(len(evidence.terms)):
        if evidence.terms[i].contact.used:
            cost += evidence.terms[i].log_spread
    coordinates_at(flat, point, u.row)
    cost = without_bumps(evidence, flat, at_coordinates(mode, evidence.model.radius, u.row), cost)
    half = 0.5 * norm((u.row[3], u.row[4], u.row[5])) / evidence.model.radius
    if half > 0.5 * np.pi:
        return -np.inf  # this pose is also reached by the turn the other way round
    log_weight = -0.5 * cost
    if half > 1e-6:
        log_weight += 2 * np.log(np.sin(half) / half)  # the volume of rotations shrinks with the turn
    for a in range(count):
        log_weight += np.log(u.factor[a, a])
    _add(flat, mode, evidence.model.radius, log_weight, sums, u)
    return log_weight


@inner
def _add(flat: Any, mode: Pose, radius: float, log_weight: float, sums: Any, u: Any) -> None:
    """Adds the point at the coordinates `u.row` with its Gaussian across the flat directions, both by (δp, δθ)."""
    count, shift = flat.count_across, sub(at_coordinates(mode, radius, u.row)[1], mode[1])
    if log_weight > sums.best:
        before = np.exp(sums.best - log_weight)
        sums.best = log_weight
        sums.total *= before
        for i in range(6):
            sums.first[i] *= before
            for j in range(6):
                sums.second[i, j] *= before
                sums.within[i, j] *= before
    weight = np.exp(log_weight - sums.best)
    six = shift + scale((u.row[3], u.row[4], u.row[5]), 1 / radius)
    for a in range(count):
        turn = scale((u.wider[3, a], u.wider[4, a], u.wider[5, a]), 1 / radius)
        moved = scale(add((u.wider[0, a], u.wider[1, a], u.wider[2, a]), cross(turn, shift)), flat.stretch[a])
        column = moved + scale(turn, flat.stretch[a])
        # The columns of A = L⁻¹ Gᵀ: Aᵀ A = G H⁻¹ Gᵀ.
        for i in range(6):
            value = column[i]
            for b in range(a):
                value -= u.factor[a, b] * u.by_touch[i, b]
            u.by_touch[i, a] = value * u.factor[a, a]
    sums.total += weight
    for i in range(6):
        sums.first[i] += weight * six[i]
        for j in range(6):
            value = 0.0
            for a in range(count):
                value += u.by_touch[i, a] * u.by_touch[j, a]
            sums.second[i, j] += weight * (six[i] * six[j])
            sums.within[i, j] += weight * value


@inner
def cover(flat: Any, others: Any, u: Any) -> None:
    """Marks those of the other modes (n, 7), coordinates and a mark, that lie beside the point visited last."""
    for n in range(len(others)):
        beside = True
        for k in range(flat.count):
            along = 0.0
            for i in range(6):
                along += flat.along[i, k] * (others[n, i] - u.row[i])
            beside = beside and abs(along) <= flat.spacing[k]
        square = 0.0
        for a in range(flat.count_across):
            u.column[a] = 0.0
            for i in range(6):
                u.column[a] += flat.across[i, a] * (others[n, i] - u.row[i])
        for a in range(flat.count_across):
            for b in range(flat.count_across):
                square += u.column[a] * u.matrix[a, b] * u.column[b]
        if beside and square < INTEGRATION.same_mode:
            others[n, 6] = 1.0
