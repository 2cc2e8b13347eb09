"""A mode's mean and covariance where it is not Gaussian: along a flat direction that is bounded, or at an edge.

Coordinates are (s, radius θ) [m], straight along the object (`retract_body`). Along the few directions in which the
posterior departs from a Gaussian points are visited from the mode on, as far as there is density: along one direction
more of them where the density changes, along several a lattice. At each of them a Gauss-Newton step leads to the best
of the other directions, which count as Gaussian there (Laplace):

    weight = exp(-cost / 2) / √det H,    H: Gauss-Newton Hessian across the flat directions, walls in it

Along a flat direction over a scan's bumps the mode is in the deepest dent: there the cost of contacts counts only from
the level that dents explain.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.outside_term import measure_clearances
from handsight._kernels.evidence.prior_term import prior_cost
from handsight._kernels.evidence.terms import FIXED_NOISE, PRIOR, Evidence, evidence_cost
from handsight._kernels.math.dense6 import eigen, from_eigen, scale_turns
from handsight._kernels.math.simd import local
from handsight._kernels.math.so3 import rotation_log
from handsight._kernels.math.symmetry import nearest, pose_of
from handsight._kernels.math.vec3 import matmul, scale, sub, tmul, transpose
from handsight._kernels.posterior.flat_directions import (
    build_lattice,
    choose,
    fine_enough,
    mark_spins,
    measure,
)
from handsight._kernels.posterior.lattice import add_up, cover, visit
from handsight._kernels.posterior.options import INTEGRATION
from handsight._kernels.posterior.spurious_information import cost_deviation
from handsight._kernels.posterior.uncertainty import retract_body
from handsight._kernels.records import (
    LATTICE_POINT,
    OUTSIDE,
    SUMS,
    UNCERTAINTY,
    WEAK_PRIOR,
)
from handsight._kernels.runtime.compilation import inner


@inner
def _flood(evidence: Evidence, mode: Pose, flat: Any, others: Any, points: Any, sums: Any) -> int:
    """Returns how many points of the lattice were visited, from the mode on; 0 where `points` do not suffice."""
    u = local(UNCERTAINTY)
    reach = INTEGRATION.max_extent[flat.count - 2]
    side = 2 * reach + 1
    visited = np.zeros(side**flat.count, np.bool_)
    count, done, middle, best = 1, 0, len(visited) // 2, -np.inf
    points[0].index[:], points[0].lateral[:] = 0.0, 0.0
    visited[middle] = True
    while done < count:
        point = points[done]
        done += 1
        visit(evidence, mode, flat, point, u)
        best = max(best, point.log_weight)
        if not point.log_weight > best - 0.5 * INTEGRATION.max_cost:
            continue
        cover(flat, others, u)
        where = middle
        for k in range(flat.count):
            where += int(point.index[k]) * side**k
        for k in range(flat.count):
            for direction in range(2):
                step = 2 * direction - 1
                next_to = where + step * side**k
                if abs(point.index[k] + step) > reach or visited[next_to]:
                    continue
                if count == len(points):
                    return 0
                visited[next_to] = True
                added = points[count]
                for n in range(3):
                    added.index[n] = point.index[n] + (step if n == k else 0)
                for n in range(6):
                    added.lateral[n] = point.lateral[n]
                count += 1
    sums.best = best
    for n in range(count):
        points[n].share = np.exp(points[n].log_weight - best)
    return count


@inner
def _follow(evidence: Evidence, mode: Pose, flat: Any, others: Any, points: Any, sums: Any) -> int:
    """Returns how many points of the one flat direction were visited.

    From the mode on, to where there is no density. Then the gap in which most of it may be at the wrong place, which
    is at a wall or on a slope, is halved until that is little. Between points the logarithm of the density is a
    monotone cubic (Fritsch and Butland), and all else linear.
    """
    order, u = np.empty(len(points), np.int64), local(UNCERTAINTY)
    low = high = flat.spacing[0]
    count, best, at, place, passed = 0, -np.inf, 0, 0.0, 0
    while True:
        point = points[count]
        point.index[:], point.lateral[:] = 0.0, 0.0
        point.index[0] = place
        if count:
            a, b = points[order[max(at - 1, 0)]], points[order[min(at, count - 1)]]
            flat.spacing[0] = abs(b.index[0] - place)
            part = (
                0.5
                if abs(a.log_weight - b.log_weight) < 1.0
                else (1.0 if a.log_weight > b.log_weight else 0.0)
            )
            for n in range(6):
                point.lateral[n] = part * a.lateral[n] + (1 - part) * b.lateral[n]
        visit(evidence, mode, flat, point, u)
        if count and (at == 0 or at == count):
            beside = points[order[0 if at == 0 else count - 1]]
            if beside.log_weight - point.log_weight < INTEGRATION.small_fall:
                low, high = (2 * low, high) if at == 0 else (low, 2 * high)
        for n in range(count, at, -1):
            order[n] = order[n - 1]
        order[at], count, best = count, count + 1, max(best, point.log_weight)
        if point.log_weight > best - 0.5 * INTEGRATION.max_cost:
            cover(flat, others, u)
        first, last = points[order[0]], points[order[count - 1]]
        if count == len(points):
            break
        if first.log_weight > best - INTEGRATION.max_fall:
            at, place = 0, first.index[0] - low
        elif last.log_weight > best - INTEGRATION.max_fall:
            at, place = count, last.index[0] + high
        else:
            at, most, mass = 0, 0.0, 0.0
            for n in range(1, count):
                a, b = points[order[n - 1]], points[order[n]]
                gap, p, q = b.index[0] - a.index[0], np.exp(a.log_weight - best), np.exp(b.log_weight - best)
                mass += 0.5 * gap * (p + q)
                if gap * abs(p - q) > most:
                    at, most, place = n, gap * abs(p - q), 0.5 * (a.index[0] + b.index[0])
            while not most > INTEGRATION.misplaced * mass and passed < len(others):
                place = 0.0  # of another mode, whether it is beside the line
                for i in range(6):
                    place += flat.along[i, 0] * others[passed, i]
                passed += 1
                for n in range(1, count):
                    a, b = points[order[n - 1]].index[0], points[order[n]].index[0]
                    at, most = (n, np.inf) if min(place - a, b - place) > 1e-9 else (at, most)
            if not most > INTEGRATION.misplaced * mass:
                break
    sums.best = best
    _share(points, order[:count], flat, evidence.model.radius, sums)
    return count


@inner
def _share(points: Any, order: Any, flat: Any, radius: float, sums: Any) -> None:
    """Fills in the shares of points in order along a line, so that sums over them are integrals of what is interpolated
    between them; writes to the sums of squares by how much these would be too large.

    Beyond a wall a point's coordinates across mean nothing: up to it they are taken as those of the point before it.
    """
    floor, slope = sums.best - INTEGRATION.deepest, 0.0
    for n in range(len(order)):
        point = points[order[n]]
        point.share = 0.0
        for side in range(2 if point.log_weight < floor else 0):
            beside = points[order[min(max(n + 2 * side - 1, 0), len(order) - 1)]]
            if beside.log_weight >= floor:
                for i in range(6):
                    gap = (point.index[0] - beside.index[0]) / (1.0 if i < 3 else radius)
                    point.moved[i] = beside.moved[i] + gap * flat.along[i, 0]
                    for j in range(6):
                        point.within[i, j] = beside.within[i, j]
    for n in range(1, len(order)):
        a, b = points[order[n - 1]], points[order[n]]
        gap, low, high = b.index[0] - a.index[0], max(a.log_weight, floor), max(b.log_weight, floor)
        rise, between = (high - low) / gap, 0.0
        before, slope = slope if n > 1 else rise, rise
        if n + 1 < len(order):
            c = points[order[n + 1]]
            next_gap = c.index[0] - b.index[0]
            next_rise, part = (max(c.log_weight, floor) - high) / next_gap, gap / (gap + next_gap)
            part = (2 - part) / 3
            slope = rise * next_rise
            slope = slope / (part * next_rise + (1 - part) * rise) if slope > 0 else 0.0
        for m in range(INTEGRATION.parts if max(low, high) > floor else 0):
            x = (m + 0.5) / INTEGRATION.parts
            y = 1 - x
            bent = (
                low * (1 + 2 * x) * y * y
                + high * x * x * (1 + 2 * y)
                + gap * x * y * (before * y - slope * x)
            )
            weight = gap / INTEGRATION.parts * np.exp(bent - sums.best)
            a.share += y * weight
            b.share += x * weight
            between += x * y * weight
        for i in range(6):
            for j in range(6):
                sums.second[i, j] -= between * ((b.moved[i] - a.moved[i]) * (b.moved[j] - a.moved[j]))


@inner
def _integrate_mode(evidence: Evidence, mode: Pose, cost: float, others: Any, flat: Any, sums: Any) -> bool:
    """Returns whether the points were close enough, and few enough; fills in the sums over them.

    cost: minus two log of the density at the mode.
    """
    choose(evidence, mode, flat)
    rows = np.empty(len(evidence.outside), OUTSIDE)
    measure_clearances(evidence, evidence.model.fine, mode, np.inf, rows)
    nodes, terms, given = evidence.nodes, evidence.terms, evidence.constraints
    near = Evidence(evidence.model, nodes, terms, rows, given, evidence.prior, mode[1])
    flat.bump_margin = INTEGRATION.bump_sigmas * cost_deviation(evidence, mode)
    flat.level = cost - evidence_cost(evidence, PRIOR | FIXED_NOISE, mode) + flat.bump_margin
    points = np.empty(INTEGRATION.max_points[min(flat.count, 2) - 1], LATTICE_POINT)
    one, cell = flat.count == 1, 0.0
    if not one:
        measure(near, mode, flat, cost + flat.bump_margin)
    for _ in range(INTEGRATION.max_lattices):
        others[:, 6], sums.total = 0.0, 0.0
        sums.first[:], sums.second[:], sums.within[:] = 0.0, 0.0, 0.0
        if one:
            count = _follow(near, mode, flat, others, points, sums)
        else:
            cell = build_lattice(flat)
            count = _flood(near, mode, flat, others, points, sums)
        add_up(points[:count], sums)
        if count == 0:
            for k in range(flat.count):
                flat.spacing[k] *= 1.5
        elif not sums.total > 0:
            return False
        elif one or fine_enough(flat, sums, evidence.model.radius):
            sums.best += cell - 0.5 * flat.count * np.log(2 * np.pi)
            return True
    return False


@inner
def _store_mean(model: Any, mode: Pose, flat: Any, sums: Any, row: Any) -> None:
    """Writes the answer's pose, covariance and information; where a direction is unknown, as may be without vision, the
    latter two stay the mode's."""
    u, radius = local(UNCERTAINTY), model.radius
    for i in range(6):
        u.row[i] = sums.first[i] / sums.total
    mean = u.row
    R, _ = retract_body(mode, ((0.0, 0.0, 0.0), (mean[3], mean[4], mean[5])))
    for i in range(3):
        for j in range(3):
            row.T_palm_object[i, j] = R[i][j]
        row.T_palm_object[i, 3] = mode[1][i] + mean[i]
    if not flat.proper:
        return
    for i in range(6):
        for j in range(6):
            row.covariance[i, j] = (sums.second[i, j] + sums.within[i, j]) / sums.total - mean[i] * mean[j]
    scale_turns(row.covariance, radius, u.matrix)
    limit = mark_spins(model, R, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for k in range(6):
        u.values[k] = 1 / u.values[k] if u.values[k] < limit else 0.0
    from_eigen(u.values, u.vectors, radius, row.information)


@inner
def to_mean(evidence: Evidence, answers: Any, k: int, flat: Any, best: float) -> float:
    """Turns the k-th of the answers (K,), whose shape is filled in, into a mean, where that is wanted; returns the
    largest of `best` and its log weight.

    Another mode that is reached along the flat directions is part of that mean: its weight becomes -1. `log_weight`
    becomes the logarithm of the integral. An answer's `pose` remains the mode.
    """
    model, row, weak = evidence.model, answers[k], evidence.prior.kind == WEAK_PRIOR
    not_gaussian = row.departure > INTEGRATION.max_gaussian_rise and (row.complete or not weak)
    if (
        k >= INTEGRATION.max_modes
        or row.weight < 0
        or row.log_weight < best - INTEGRATION.min_log_weight
        or not (row.mean == 2 or (row.mean == 1 and not_gaussian))
    ):
        return best
    mode, sums, others = pose_of(row.pose), local(SUMS), np.empty((len(answers) - k - 1, 7))
    for n in range(len(others)):
        # Coordinates (s, radius θ), from the mode, of the other mode's nearest equivalent.
        Q, q = nearest(model, pose_of(answers[k + 1 + n].pose), mode)
        E = matmul(Q, transpose(mode[0]))
        six = tmul(E, sub(q, mode[1])) + scale(rotation_log(E), model.radius)
        for i in range(6):
            others[n, i] = six[i]
    cost = row.posterior_cost + (prior_cost(evidence.prior, mode) if weak else 0.0)
    if _integrate_mode(evidence, mode, cost, others, flat, sums):
        _store_mean(model, mode, flat, sums, row)
        spins = 6 - flat.count - flat.count_across
        floor = (1.0 if weak else 1e-9) / model.radius**2
        row.log_weight = np.log(sums.total) + sums.best - 0.5 * spins * np.log(floor)
        for n in range(len(others)):
            if others[n, 6] == 1.0:
                answers[k + 1 + n].weight = -1.0
    return max(best, row.log_weight)
