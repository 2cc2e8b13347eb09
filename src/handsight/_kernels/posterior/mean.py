"""A mode's mean and covariance where it is not Gaussian: along a flat direction that is bounded, or at an edge.

Coordinates are (s, radius θ) [m], straight along the object (`retract_body`). Along the few directions in which the
posterior departs from a Gaussian a lattice is flooded from the mode on, as far as there is density. At each of its
points a Gauss-Newton step leads to the best of the other directions, which count as Gaussian there (Laplace):

    weight = exp(-cost / 2) / √det H,    H: Gauss-Newton Hessian across the flat directions, walls in it

Along a flat direction over a scan's bumps the mode is in the deepest dent: there the cost of contacts counts only from
the level that dents explain.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.outside_term import measure_clearances
from handsight._kernels.evidence.terms import FIXED_NOISE, PRIOR, Evidence, evidence_cost
from handsight._kernels.math.dense6 import eigen, from_eigen, scale_turns
from handsight._kernels.math.simd import local
from handsight._kernels.math.so3 import rotation_log
from handsight._kernels.math.symmetry import nearest, pose_of
from handsight._kernels.math.vec3 import matmul, scale, sub, tmul, transpose
from handsight._kernels.posterior.density import posterior_cost
from handsight._kernels.posterior.flat_directions import (
    build_lattice,
    choose,
    fine_enough,
    mark_spins,
    measure,
)
from handsight._kernels.posterior.lattice import cover, visit
from handsight._kernels.posterior.options import INTEGRATION
from handsight._kernels.posterior.spurious_information import cost_deviation
from handsight._kernels.posterior.uncertainty import retract_body
from handsight._kernels.records import (
    FLAT_DIRECTIONS,
    LATTICE_POINT,
    OUTSIDE,
    PRIOR_TERM,
    SUMS,
    TERM,
    UNCERTAINTY,
    WEAK_PRIOR,
)
from handsight._kernels.runtime.compilation import entry, inner
from handsight._kernels.solve.batch import load_evidence


@inner
def _flood(evidence: Evidence, mode: Pose, flat: Any, others: Any, sums: Any) -> bool:
    """Returns whether all places with density were visited, from the mode on."""
    u, points = local(UNCERTAINTY), np.zeros(INTEGRATION.max_points, LATTICE_POINT)
    reach = INTEGRATION.max_extent[flat.count - 1]
    side = 2 * reach + 1
    visited = np.zeros(side**flat.count, np.bool_)
    sums.total, sums.best = 0.0, -np.inf
    sums.first[:], sums.second[:], sums.within[:] = 0.0, 0.0, 0.0
    count, done, middle = 1, 0, len(visited) // 2
    visited[middle] = True
    while done < count:
        point = points[done]
        done += 1
        log_weight = visit(evidence, mode, flat, point, sums, u)
        if not log_weight > sums.best - 0.5 * INTEGRATION.max_cost:
            continue
        cover(flat, others, u)
        where = middle
        for k in range(flat.count):
            where += point.index[k] * side**k
        for k in range(flat.count):
            for direction in range(2):
                step = 2 * direction - 1
                next_to = where + step * side**k
                if abs(point.index[k] + step) > reach or visited[next_to]:
                    continue
                if count == INTEGRATION.max_points:
                    return False
                visited[next_to] = True
                added = points[count]
                for n in range(3):
                    added.index[n] = point.index[n] + (step if n == k else 0)
                for n in range(6):
                    added.lateral[n] = point.lateral[n]
                count += 1
    return True


@inner
def _integrate_mode(evidence: Evidence, mode: Pose, others: Any, flat: Any, sums: Any) -> bool:
    """Returns whether a lattice was fine enough, and small enough to be covered; fills in the sums over its places."""
    choose(evidence, mode, flat, local(UNCERTAINTY))
    rows = np.empty(len(evidence.outside), OUTSIDE)
    measure_clearances(evidence, evidence.model.fine, mode, np.inf, rows)
    nodes, terms, given = evidence.nodes, evidence.terms, evidence.constraints
    near = Evidence(evidence.model, nodes, terms, rows, given, evidence.prior, evidence.center)
    flat.bump_margin = INTEGRATION.bump_sigmas * cost_deviation(evidence, mode)
    here = posterior_cost(evidence, mode)
    by_prior = evidence_cost(evidence, PRIOR | FIXED_NOISE, mode)
    flat.level = here - by_prior + flat.bump_margin
    measure(near, mode, flat, here + flat.bump_margin)
    for _ in range(INTEGRATION.max_lattices):
        cell = build_lattice(flat)
        others[:, 6] = 0.0
        if not _flood(near, mode, flat, others, sums):
            for k in range(flat.count):
                flat.spacing[k] *= 1.5
        elif not sums.total > 0:
            return False
        elif fine_enough(flat, sums, evidence.model.radius):
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
    limit = mark_spins(model, (R, (0.0, 0.0, 0.0)), u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    for k in range(6):
        u.values[k] = 1 / u.values[k] if u.values[k] < limit else 0.0
    from_eigen(u.values, u.vectors, radius, row.information)


@entry
def integrate(model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, answers: Any) -> None:
    """Turns the first of the answers (K,), where they depart from a Gaussian, into means.

    The first set of contacts is used. Another mode that is reached along the flat directions is part of that mean: its
    weight becomes -1. `log_weight` becomes the logarithm of the integral. An answer's `pose` remains the mode.
    """
    term, flat, sums = local(PRIOR_TERM), local(FLAT_DIRECTIONS), local(SUMS)
    terms, others = np.empty(contacts.shape[1], TERM), np.empty((len(answers), 7))
    load_evidence(model[0], contacts[0], constraints[0], terms, term)
    floor = (1.0 if term.kind == WEAK_PRIOR else 1e-9) / model[0].radius ** 2
    best = -np.inf
    for k in range(min(len(answers), INTEGRATION.max_modes)):
        row = answers[k]
        if (
            row.weight < 0
            or not row.departure > INTEGRATION.max_gaussian_rise
            or row.log_weight < best - INTEGRATION.min_log_weight
        ):
            continue
        mode = pose_of(row.pose)
        for n in range(k + 1, len(answers)):
            # Coordinates (s, radius θ), from the mode, of the other mode's nearest equivalent.
            Q, q = nearest(model[0], pose_of(answers[n].pose), mode)
            E = matmul(Q, transpose(mode[0]))
            six = tmul(E, sub(q, mode[1])) + scale(rotation_log(E), model[0].radius)
            for i in range(6):
                others[n, i] = six[i]
        evidence = Evidence(model[0], nodes, terms, outside, constraints[0], term, mode[1])
        if _integrate_mode(evidence, mode, others[k + 1 :], flat, sums):
            _store_mean(model[0], mode, flat, sums, row)
            spins = 6 - flat.count - flat.count_across
            row.log_weight = np.log(sums.total) + sums.best - 0.5 * spins * np.log(floor)
            for n in range(k + 1, len(answers)):
                if others[n, 6] == 1.0:
                    answers[n].weight = -1.0
        best = max(best, row.log_weight)
