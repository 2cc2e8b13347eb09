"""The posterior at a pose: its information, its cost, and by how much that falls when a contact is left out."""

from typing import Any

from handsight._compiled.dense6 import factor, solve
from handsight._compiled.jit import inner
from handsight._compiled.records import VISION_PRIOR
from handsight._compiled.vec3 import Pose, dot, vector
from handsight.correction.kernels.contact_term import (
    add_contact,
    factored,
    invert_covariance,
    log_determinant,
    mahalanobis2,
    residual_covariance,
    surface_at,
)
from handsight.correction.kernels.spurious_information import (
    add_spurious_information,
    subtract_spurious_information,
)
from handsight.correction.kernels.terms import (
    ALL,
    FIXED_NOISE,
    PRIOR,
    WALLS,
    Evidence,
    add_evidence,
    evidence_cost,
)
from handsight.objects.kernels.field import FLAT


@inner
def contact_information(evidence: Evidence, pose: Pose, spurious: Any) -> tuple[float, float]:
    """Returns χ² of the contacts, and the log determinant of the covariances that whiten them; writes every term's
    equations by (δp, δθ), and adds their spurious information to `spurious`."""
    model = evidence.model
    field = evidence.model.fine
    frame = (pose[1], 1.0)
    chi2 = 0.0
    log_spread = 0.0
    for i in range(len(evidence.terms)):
        term = evidence.terms[i]
        term.equations[:] = 0.0
        if term.contact.used:
            surface = surface_at(evidence.nodes, field, vector(term.contact.point), pose)
            has_normal = term.contact.has_normal != 0
            factor4 = factored(residual_covariance(model, evidence.nodes, field, term, surface))
            invert_covariance(factor4, has_normal, term.weight)
            log_spread += log_determinant(factor4, has_normal)
            add_spurious_information(model, evidence.nodes, term, surface, pose, spurious)
            K = surface[3]
            bend = dot(K[0], K[0]) + dot(K[1], K[1]) + dot(K[2], K[2])
            if bend > model.edge_curvature2 and has_normal:
                # A contact that the prior has pushed to an edge is stopped on one side only: the sharp bend is a wall,
                # and no information about the other direction. It is replaced by a plane with the contact's normal,
                # and the gradient is set to zero, as it would pull the contact over the edge.
                square = mahalanobis2(term.contact, surface, factor4)
                n = vector(term.contact.normal)
                plane = surface[0], n, n, FLAT, surface[4]
                add_contact(term, plane, frame, term.equations)
                for k in range(6):
                    term.equations[6, k] = 0.0
                term.equations[6, 6] = square
            else:
                add_contact(term, surface, frame, term.equations)
            chi2 += term.equations[6, 6]
    return chi2, log_spread


@inner
def information(evidence: Evidence, pose: Pose, total: Any, u: Any) -> tuple[float, float]:
    """Returns χ², and the cost without a weak prior; writes the information (6, 6) by (δp, δθ) of touch alone to
    `u.by_touch` and of all evidence to `total`.

    The weight counts as touch, as all evidence that corrects the prior. Spurious information is subtracted from both,
    but not from the terms' equations nor from `u.equations`, which hold those of the weight and the prior together.
    `u.prior` and `u.walls` hold the equations of the prior and of walls alone.
    """
    by_touch, equations = u.by_touch, u.equations
    equations[:] = 0.0
    u.prior[:] = 0.0
    u.walls[:] = 0.0
    chi2, log_spread = contact_information(evidence, pose, equations)
    model = evidence.model
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for k in range(len(evidence.terms)):
                value += evidence.terms[k].equations[i, j]
            by_touch[i, j] = by_touch[j, i] = value
    subtract_spurious_information(by_touch, equations, model.radius)
    # Walls are part of the cost, but not of the information.
    frame = pose[1], 1.0
    add_evidence(evidence, WALLS, model.fine, pose, frame, u.walls)
    equations[:] = 0.0
    add_evidence(evidence, FIXED_NOISE, model.fine, pose, frame, equations)
    for i in range(6):
        for j in range(i + 1):
            total[i, j] = by_touch[i, j]
            by_touch[i, j] = by_touch[j, i] = by_touch[i, j] + equations[i, j]
    if evidence.prior.kind == VISION_PRIOR:
        add_evidence(evidence, PRIOR, model.fine, pose, frame, u.prior)
    for i in range(7):
        for j in range(i + 1):
            equations[i, j] += u.prior[i, j]
    for i in range(6):
        for j in range(i + 1):
            total[i, j] = total[j, i] = total[i, j] + equations[i, j]
    chi2 += equations[6, 6] + u.walls[6, 6]
    return chi2, chi2 + log_spread


@inner
def posterior_cost(evidence: Evidence, pose: Pose) -> float:
    """Returns minus two log of the posterior density at a pose, up to a constant."""
    return evidence_cost(evidence, ALL, pose)


@inner
def largest_gain(evidence: Evidence, u: Any) -> float:
    """Returns the most that χ² falls, to first order, when one contact is left out and the pose adapts to that.

    With a contact's share of Hessian and gradient, H_i and g_i, and its squared residuals: rᵀr + gᵀ (H - H_i)⁻¹ g. The
    share of other evidence is in `u.equations`; spurious information is part of the cost, and is not subtracted.
    """
    total = u.wider
    most = 0.0
    for r in range(6):
        for c in range(r + 1):
            total[r, c] = u.equations[r, c]
            for i in range(len(evidence.terms)):
                total[r, c] += evidence.terms[i].equations[r, c]
    ridge = 1e-12 * (total[0, 0] + total[1, 1] + total[2, 2])
    for i in range(len(evidence.terms)):
        term = evidence.terms[i]
        if term.contact.used:
            for r in range(6):
                for c in range(r + 1):
                    u.matrix[r, c] = total[r, c] - term.equations[r, c]
            gain = term.equations[6, 6]
            if factor(u.matrix, 6, ridge, u.factor):
                solve(u.factor, 6, term.equations[6], u.row)
                for k in range(6):
                    gain += u.row[k] * term.equations[6, k]
            term.contact.gain = gain
            most = max(most, gain)
    return most


@inner
def group_gain(evidence: Evidence, group: Any, u: Any) -> float:
    """Returns how much χ² falls, to first order, when the evidence of some equations (7, 8) is left out and the pose
    adapts to that; to be called after `largest_gain`, which leaves the sum of all other equations but walls' in
    `u.wider`.

    A direction that the rest leaves open cannot be contradicted: there gradient and Hessian of the rest both vanish,
    and their ratio is rounding. So a fiftieth of the group's own information stays, which lowers the gain only where
    the rest knows less than that.
    """
    gain = group[6, 6]
    if gain == 0.0:
        return 0.0
    for r in range(6):
        for c in range(r + 1):
            u.matrix[r, c] = u.wider[r, c] + u.walls[r, c] - 0.98 * group[r, c]
    if factor(u.matrix, 6, 0.0, u.factor):
        solve(u.factor, 6, group[6], u.row)
        for k in range(6):
            gain += u.row[k] * group[6, k]
    return gain
