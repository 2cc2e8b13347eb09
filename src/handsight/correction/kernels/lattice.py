"""One point along the flat directions: its best other coordinates, its weight, its part of the sums.

weight = exp(-cost / 2) / √det H,    H: Gauss-Newton Hessian across the flat directions, walls in it
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import factor, solve
from handsight._compiled.jit import inner
from handsight._compiled.vec3 import Mat33, Pose, add, cross, matmul, mul, norm, scale, sub, transpose
from handsight.correction.kernels.flat_directions import (
    at_coordinates,
    coordinates_at,
    without_bumps,
)
from handsight.correction.kernels.integration_options import INTEGRATION
from handsight.correction.kernels.terms import ALL, REWHITENED, Evidence, add_evidence


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
                row += u.equations[i, j] * u.wider[j, a]
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
def visit(evidence: Evidence, mode: Pose, flat: Any, point: Any, u: Any) -> None:
    """Fills in a point, whose coordinates across become the best ones.

    The cost is that which the step across predicts: the contacts' covariances are taken as before the step. After a
    step that changes much another one follows, and of the last one nothing that it predicts is believed; not so where
    the cost is above `flat.most_cost`.
    """
    radius = evidence.model.radius
    count = 0
    cost = 0.0
    point.log_weight = -np.inf
    for _ in range(INTEGRATION.steps_across):
        coordinates_at(flat, point, u.row)
        pose = at_coordinates(mode, radius, u.row)
        u.equations[:] = 0.0
        add_evidence(
            evidence, ALL | REWHITENED, evidence.model.fine, pose, (evidence.center, radius), u.equations
        )
        count = flat.count_across if _relax(flat, matmul(pose[0], transpose(mode[0])), u) else 0
        cost = u.equations[6, 6]
        fall = 0.0
        for a in range(count):
            fall += u.values[a] * u.column[a]
            point.lateral[a] -= u.column[a]
        if fall < INTEGRATION.large_fall or cost - fall > flat.most_cost:
            cost -= fall
            break
    for i in range(len(evidence.terms)):
        if evidence.terms[i].contact.used:
            cost += evidence.terms[i].log_spread
    coordinates_at(flat, point, u.row)
    pose = at_coordinates(mode, radius, u.row)
    half = 0.5 * norm((u.row[3], u.row[4], u.row[5])) / radius
    point.cost = cost = without_bumps(evidence, flat, pose, cost)
    if count and half < 0.5 * np.pi:  # beyond, the pose is also reached by the turn the other way round
        point.log_weight = -0.5 * cost
        if half > 1e-6:  # the volume of rotations shrinks with the turn
            point.log_weight += 2 * np.log(np.sin(half) / half)
        for a in range(count):
            point.log_weight += np.log(u.factor[a, a])
    shift = sub(pose[1], mode[1])
    moved = shift + scale((u.row[3], u.row[4], u.row[5]), 1 / radius)
    for a in range(count):
        turn = scale((u.wider[3, a], u.wider[4, a], u.wider[5, a]), 1 / radius)
        six = scale(add((u.wider[0, a], u.wider[1, a], u.wider[2, a]), cross(turn, shift)), flat.stretch[a])
        column = six + scale(turn, flat.stretch[a])
        # The columns of A = L⁻¹ Gᵀ: Aᵀ A = G H⁻¹ Gᵀ.
        for i in range(6):
            value = column[i]
            for b in range(a):
                value -= u.factor[a, b] * u.by_touch[i, b]
            u.by_touch[i, a] = value * u.factor[a, a]
    for i in range(6):
        point.moved[i] = moved[i]
        for j in range(i + 1):
            value = 0.0
            for a in range(count):
                value += u.by_touch[i, a] * u.by_touch[j, a]
            point.within[i, j] = point.within[j, i] = value


@inner
def add_up(points: Any, sums: Any) -> None:
    """Adds points (n,) to the sums."""
    for k in range(len(points)):
        point = points[k]
        sums.total += point.share
        for i in range(6):
            sums.first[i] += point.share * point.moved[i]
            for j in range(6):
                sums.second[i, j] += point.share * (point.moved[i] * point.moved[j])
                sums.within[i, j] += point.share * point.within[i, j]


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
