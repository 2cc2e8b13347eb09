"""A mode's mean and covariance where it is not Gaussian: along a flat direction that is bounded, or at an edge.

Coordinates are (s, radius θ) [m], straight along the object (`retract_body`). Along the few directions in which the
posterior departs from a Gaussian points are visited from the mode on, as far as there is density: along one direction
more of them at walls and where the density is not smooth, along several a lattice. At each of them a Gauss-Newton step
leads to the best of the other directions, which count as Gaussian there (Laplace):

    weight = exp(-cost / 2) / √det H,    H: Gauss-Newton Hessian across the flat directions, walls in it

Along a flat direction over a scan's bumps the mode is in the deepest dent: there the cost of contacts counts only from
the level that dents explain.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, from_eigen, scale_turns
from handsight._compiled.jit import inner
from handsight._compiled.records import (
    GRID,
    LATTICE_POINT,
    SHEET,
    SUMS,
    UNCERTAINTY,
    WEAK_PRIOR,
)
from handsight._compiled.so3 import rotation_log
from handsight._compiled.stack import local
from handsight._compiled.symmetry import nearest, pose_of
from handsight._compiled.vec3 import Pose, matmul, scale, sub, tmul, transpose
from handsight.correction.kernels.density import posterior_cost
from handsight.correction.kernels.flat_directions import (
    at_coordinates,
    build_lattice,
    choose,
    coordinates_at,
    fine_enough,
    mark_spins,
    measure,
    without_bumps,
)
from handsight.correction.kernels.integration_options import INTEGRATION
from handsight.correction.kernels.lattice import add_up, cover, visit
from handsight.correction.kernels.prior_term import prior_cost
from handsight.correction.kernels.spurious_information import cost_deviation
from handsight.correction.kernels.terms import FIXED_NOISE, PRIOR, Evidence, evidence_cost
from handsight.correction.kernels.uncertainty import retract_body


@inner
def _flood(evidence: Evidence, mode: Pose, flat: Any, others: Any, points: Any, sums: Any) -> int:
    """Returns how many points of the lattice were visited, from the mode on; 0 where `points` do not suffice."""
    u = local(UNCERTAINTY)
    reach = INTEGRATION.max_extent[flat.count - 2]
    side = 2 * reach + 1
    visited = np.zeros(side**flat.count, np.bool_)
    count = 1
    done = 0
    middle = len(visited) // 2
    best = -np.inf
    points[0].index[:] = 0.0
    points[0].lateral[:] = 0.0
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
def _secant(points: Any, order: Any, n: int, floor: float) -> float:
    """Returns the slope of the logarithm of the density between the n-th point in order and the next one; NaN where
    there is none, or where a wall may be between them. What is below `floor` counts as there."""
    if n < 0 or n > len(order) - 2:
        return np.nan
    a = points[order[n]]
    b = points[order[n + 1]]
    rise = max(b.log_weight, floor) - max(a.log_weight, floor)
    return rise / (b.index[0] - a.index[0]) if abs(rise) < INTEGRATION.wall_fall else np.nan


@inner
def _find_bends(points: Any, order: Any, floor: float) -> None:
    """Fills in the bend of each point in order: half the second derivative of the parabola through the logarithm of the
    density there and at its neighbours; NaN at an end and beside a wall."""
    before = np.nan
    for n in range(len(order)):
        after = _secant(points, order, n, floor)
        points[order[n]].bend = np.nan
        if before == before and after == after:
            both = points[order[n + 1]].index[0] - points[order[n - 1]].index[0]
            points[order[n]].bend = (after - before) / both
        before = after


@inner
def _between(points: Any, a: int, b: int, point: Any) -> None:
    """Fills in the coordinates across of a point of the line: on the straight line through two others, or, where a wall
    may be between these, the likelier one's."""
    first, second = points[a], points[b]
    part = 0.0
    if a != b:
        part = (point.index[0] - first.index[0]) / (second.index[0] - first.index[0])
        if abs(first.log_weight - second.log_weight) > INTEGRATION.wall_fall:
            part = 0.0 if first.log_weight > second.log_weight else 1.0
    for n in range(6):
        point.lateral[n] = (1 - part) * first.lateral[n] + part * second.lateral[n]


@inner
def _wall(
    evidence: Evidence, mode: Pose, flat: Any, points: Any, order: Any, at: int, point: Any, u: Any
) -> float:
    """Returns the place beyond the wall in the gap before the point that is number `at` in order, and makes a point of
    the line the place before the wall, that of the likelier end if the wall is there.

    It is found by halving the gap, by the cost alone, with the coordinates across on the straight line through the last
    two points before it.
    """
    rising = points[order[at]].log_weight > points[order[at - 1]].log_weight
    inside = order[at if rising else at - 1]
    before = order[min(at + 1, len(order) - 1) if rising else max(at - 2, 0)]
    near = points[inside].index[0]
    beyond = points[order[at - 1 if rising else at]].index[0]
    limit = points[inside].cost + 2 * INTEGRATION.wall_depth
    for _ in range(INTEGRATION.halvings):
        point.index[0] = 0.5 * (near + beyond)
        _between(points, before, inside, point)
        coordinates_at(flat, point, u.row)
        pose = at_coordinates(mode, evidence.model.radius, u.row)
        if without_bumps(evidence, flat, pose, posterior_cost(evidence, pose)) < limit:
            near = point.index[0]
        else:
            beyond = point.index[0]
    point.index[0] = near
    return beyond


@inner
def _follow(evidence: Evidence, mode: Pose, flat: Any, others: Any, points: Any, sums: Any) -> int:
    """Returns how many points of the one flat direction were visited.

    From the mode on, to where there is no density. Then the gap is divided in which most of it may be at the wrong
    place: at a wall if it falls steeply, else in the middle where the parabolas through the points around it differ.
    Between points the logarithm of the density is a cubic, and all else linear.
    """
    order = np.empty(len(points), np.int64)
    u = local(UNCERTAINTY)
    # On a mesh a slide may be bent, and its density bumpy: steps are shorter, and all that falls is looked into.
    smooth = evidence.model.fine.kind not in (GRID, SHEET)
    low = high = (INTEGRATION.first_step if smooth else 1.0) * flat.spacing[0]
    count = 0
    best = -np.inf
    at = 0
    place = 0.0
    passed = 0
    pending = False
    beyond = 0.0
    while True:
        point = points[count]
        point.index[:] = 0.0
        point.lateral[:] = 0.0
        point.index[0] = place
        if count:
            n = min(max(at, 1), count - 1)  # outward, the last two
            _between(points, order[n - 1 if count > 1 else 0], order[n], point)
            flat.spacing[0] = abs(points[order[min(at, count - 1)]].index[0] - place)
        visit(evidence, mode, flat, point, u)
        point.share = np.exp(point.log_weight - points[0].log_weight)
        if count and (at == 0 or at == count):
            beside = points[order[0 if at == 0 else count - 1]]
            if beside.log_weight - point.log_weight < INTEGRATION.small_fall:
                low, high = (2 * low, high) if at == 0 else (low, 2 * high)
        for n in range(count, at, -1):
            order[n] = order[n - 1]
        order[at] = count
        count += 1
        best = max(best, point.log_weight)
        flat.most_cost = points[0].cost + 2 * (points[0].log_weight - best + INTEGRATION.given_up)
        if point.log_weight > best - 0.5 * INTEGRATION.max_cost:
            cover(flat, others, u)
        first = points[order[0]]
        last = points[order[count - 1]]
        if count == len(points):
            break
        if pending:
            at += 1 if beyond > place else 0
            place = beyond
            pending = False
        elif first.log_weight > best - INTEGRATION.max_fall:
            at = 0
            place = first.index[0] - low
        elif last.log_weight > best - INTEGRATION.max_fall:
            at = count
            place = last.index[0] + high
        elif count == 1:  # no number, or so improbable that nothing can be told from it
            break
        else:
            at, most = _worst_gap(points, order[:count], best - INTEGRATION.deepest, smooth)
            place = 0.5 * (points[order[max(at - 1, 0)]].index[0] + points[order[at]].index[0])
            while not most > INTEGRATION.misplaced and passed < len(others):
                place = 0.0  # of another mode, whether it is beside the line
                for i in range(6):
                    place += flat.along[i, 0] * others[passed, i]
                passed += 1
                for n in range(1, count):
                    a = points[order[n - 1]].index[0]
                    b = points[order[n]].index[0]
                    at, most = (n, np.inf) if min(place - a, b - place) > 1e-9 else (at, most)
            if not most > INTEGRATION.misplaced:
                break
            a = points[order[at - 1]]
            b = points[order[at]]
            steep = abs(a.log_weight - b.log_weight) > INTEGRATION.wall_fall
            if smooth and steep and most < np.inf and count + 1 < len(points):
                beyond = _wall(evidence, mode, flat, points, order[:count], at, points[count], u)
                place = points[count].index[0]
                pending = place not in (a.index[0], b.index[0])
                place = place if pending else beyond
    sums.best = best
    _share(points, order[:count], flat, evidence.model.radius, sums)
    return count


@inner
def _worst_gap(points: Any, order: Any, floor: float, smooth: bool) -> tuple[int, float]:
    """Returns the gap in which most of the density may be at the wrong place, by the number of its second point in
    order, and how much that is, as a part of all: all that falls there at a wall, or where the density is not known to
    be smooth, else as much as bends around it differ."""
    count = len(order)
    at = 1
    most = 0.0
    mass = 0.0
    _find_bends(points, order, floor)
    for n in range(1, count):
        a = points[order[n - 1]]
        b = points[order[n]]
        gap = b.index[0] - a.index[0]
        fall = abs(a.log_weight - b.log_weight)
        differ = -1.0
        bends = 0
        for m in range(max(n - 2, 0), min(n + 1, count - 1)):
            first = points[order[m]].bend
            second = points[order[m + 1]].bend
            if first == first and second == second:
                differ = max(differ, abs(first - second) * gap * gap)
        for point in (a, b):
            bends += 1 if point.bend == point.bend else 0
        if fall > INTEGRATION.wall_fall or not smooth:
            differ = 1.0
        elif differ < 0.0:
            differ = 0.25 * fall if bends else fall
        wrong = gap * abs(a.share - b.share) * min(1.0, differ)
        mass += 0.5 * gap * (a.share + b.share)
        if wrong > most:
            at, most = n, wrong
    return at, most / mass


@inner
def _slope(points: Any, order: Any, n: int, floor: float) -> float:
    """Returns the slope of the logarithm of the density at the n-th point in order: that of the parabola through it and
    its neighbours, on the same side of a wall, but no steeper than a monotone cubic has it (Fritsch and Carlson)."""
    before = _secant(points, order, n - 1, floor)
    after = _secant(points, order, n, floor)
    if before == before and after == after:
        left = points[order[n]].index[0] - points[order[n - 1]].index[0]
        slope = before + left * points[order[n]].bend
        least = min(abs(before), abs(after))
    elif before == before:
        bend = points[order[n - 1]].bend
        gap = points[order[n]].index[0] - points[order[n - 1]].index[0]
        least = abs(before)
        slope = before + gap * (bend if bend == bend else 0.0)
    elif after == after:
        bend = points[order[n + 1]].bend
        gap = points[order[n + 1]].index[0] - points[order[n]].index[0]
        least = abs(after)
        slope = after - gap * (bend if bend == bend else 0.0)
    else:
        return 0.0
    return min(max(slope, -3 * least), 3 * least)


@inner
def _share(points: Any, order: Any, flat: Any, radius: float, sums: Any) -> None:
    """Fills in the shares of points in order along a line, so that sums over them are integrals of what is interpolated
    between them; writes to the sums of squares by how much these would be too large.

    Beyond a wall a point's coordinates across mean nothing: up to it they are taken as those of the point before it.
    """
    floor = sums.best - INTEGRATION.deepest
    _find_bends(points, order, floor)
    slope = _slope(points, order, 0, floor)
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
        a = points[order[n - 1]]
        b = points[order[n]]
        gap = b.index[0] - a.index[0]
        low = max(a.log_weight, floor)
        high = max(b.log_weight, floor)
        between = 0.0
        before = slope
        slope = _slope(points, order, n, floor)
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
    nodes = evidence.nodes
    terms = evidence.terms
    hand = evidence.outside
    given = evidence.constraints
    near = Evidence(evidence.model, nodes, terms, hand, evidence.measured, given, evidence.prior, mode[1])
    flat.bump_margin = INTEGRATION.bump_sigmas * cost_deviation(evidence, mode)
    flat.level = cost - evidence_cost(evidence, PRIOR | FIXED_NOISE, mode) + flat.bump_margin
    points = np.empty(INTEGRATION.max_points[min(flat.count, 2) - 1], LATTICE_POINT)
    one = flat.count == 1
    cell = 0.0
    flat.most_cost = np.inf
    if not one:
        flat.most_cost = -np.inf  # one step suffices from a lattice's point to the next
        measure(near, mode, flat, cost + flat.bump_margin)
    for _ in range(INTEGRATION.max_lattices):
        others[:, 6] = 0.0
        sums.total = 0.0
        sums.first[:] = 0.0
        sums.second[:] = 0.0
        sums.within[:] = 0.0
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
    u = local(UNCERTAINTY)
    radius = model.radius
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
    largest = 0.0
    for k in range(6):
        largest = max(largest, u.values[k] if u.values[k] < limit else 0.0)
    for k in range(6):  # what is smaller than rounding leaves of it is none
        u.values[k] = 1 / max(u.values[k], 1e-14 * largest) if u.values[k] < limit else 0.0
    from_eigen(u.values, u.vectors, radius, row.information)


@inner
def to_mean(evidence: Evidence, answers: Any, k: int, flat: Any, best: float) -> float:
    """Turns the k-th of the answers (K,), whose shape is filled in, into a mean, where that is wanted; returns the
    largest of `best` and its log weight.

    Another mode that is reached along the flat directions is part of that mean: its weight becomes -1. `log_weight`
    becomes the logarithm of the integral. An answer's `pose` remains the mode.
    """
    model = evidence.model
    row = answers[k]
    weak = evidence.prior.kind == WEAK_PRIOR
    not_gaussian = row.departure > INTEGRATION.max_gaussian_rise and (row.complete or not weak)
    if (
        k >= INTEGRATION.max_modes
        or row.weight < 0
        or row.log_weight < best - INTEGRATION.min_log_weight
        or not (row.mean and not_gaussian)
    ):
        return best
    mode = pose_of(row.pose)
    sums = local(SUMS)
    others = np.empty((len(answers) - k - 1, 7))
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
