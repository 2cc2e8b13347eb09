"""Contacts as evidence: the distance and normal residuals of each, whitened together, added to the normal equations.

A row has the derivatives of a residual by a step (τ, radius ω), the shift and the turn of the pose about a frame's
center, along the palm's axes, and then the residual.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_four_rows
from handsight._compiled.vec3 import (
    Mat33,
    Pose,
    Vec3,
    add,
    add33,
    apply_inverse,
    block,
    cross,
    dot,
    matmul,
    mul,
    neg,
    norm,
    outer,
    scale,
    scale33,
    skew,
    store,
    sub,
    sub33,
    tmul,
    transpose,
    vector,
)
from handsight.objects.kernels.field import clamped, field_at

Frame = tuple[Vec3, float]
"""A center and a radius: a step is a shift τ, and a turn ω about the center multiplied by the radius."""
Surface = tuple[float, Vec3, Vec3, Mat33, Vec3]
"""The surface near a palm point: distance, its gradient, unit normal and curvature (the normal's derivative), all along
the palm's axes, and the point in the object's frame."""
Covariance = tuple[float, Vec3, Mat33]
"""Of (distance, normal): variance of the distance, its covariance with the normal, covariance of the normal."""
Factor = tuple[float, Vec3, Vec3, Vec3]
"""L D Lᵀ of such a covariance: d0 and the column below it, (d1, d2, d3), (l21, l31, l32)."""


@inner
def surface_at(nodes: Any, field: Any, point: Vec3, pose: Pose) -> Surface:
    """Returns the object's surface near a palm point."""
    R = pose[0]
    place = apply_inverse(pose, point)
    d, g, H = field_at(nodes, field, place)
    g = mul(R, g)
    H = matmul(matmul(R, H), transpose(R))
    s = 1 / max(norm(g), 1e-9)
    n = scale(g, s)
    # d(g/|g|) = (I - n nᵀ) dg / |g|
    K = scale33(sub33(H, outer(n, mul(H, n))), s)
    return d, g, n, K, place


@inner
def load_terms(contacts: Any, terms: Any) -> Vec3:
    """Returns the centroid of the contacts (n,); fills in their TERM (n,)."""
    center = (0.0, 0.0, 0.0)
    for i in range(len(contacts)):
        contact, term = contacts[i], terms[i]
        C, own = contact.covariance, term.contact
        # Field by field: numba cannot assign a nested record, and assigning arrays compiles long checks of shapes.
        store(vector(contact.point), own.point)
        store(vector(contact.normal), own.normal)
        own.has_normal, own.used = contact.has_normal, contact.used
        point = C[0, 0] + C[1, 1] + C[2, 2]
        normal = C[3, 3] + C[4, 4] + C[5, 5]
        off = 0.0
        for j in range(6):
            for k in range(6):
                own.covariance[j, k] = C[j, k]
                if j < 3:
                    off = max(off, abs(C[j, k] - (point / 3 if j == k else 0.0)))
        term.isotropic = off <= 1e-12 * point
        term.variance_point = point / 3
        term.variance_normal = normal / 2
        term.crowd = 1.0
        center = add(center, scale(vector(contact.point), 1 / len(contacts)))
    return center


@inner
def distance_row(point: Vec3, by_shift: Vec3, residual: float, frame: Frame) -> Any:
    """Returns the row of a residual that a shift at a palm point changes by `by_shift`; a turn by its cross product."""
    return by_shift + cross(scale(sub(point, frame[0]), 1 / frame[1]), by_shift) + (residual,)


@inner
def add_contact(term: Any, surface: Surface, frame: Frame, equations: Any) -> None:
    """Adds a contact's rows at its surface, weighted by `term.weight`."""
    d, g, n, K, _ = surface
    center, radius = frame
    contact = term.contact
    lever = scale(sub(vector(contact.point), center), 1 / radius)
    error = sub(n, vector(contact.normal))
    turned = skew(scale(n, 1 / radius))
    a, b, c = neg(K[0]), neg(K[1]), neg(K[2])
    # By a turn, the surface's normal also turns itself.
    by_distance = distance_row(vector(contact.point), neg(g), d, frame)
    by_normal = (
        a + sub(cross(lever, a), turned[0]) + (error[0],),
        b + sub(cross(lever, b), turned[1]) + (error[1],),
        c + sub(cross(lever, c), turned[2]) + (error[2],),
    )
    add_four_rows(term.weight, by_distance, by_normal, equations)


@inner
def add_contacts(evidence: Any, field: Any, pose: Pose, frame: Frame, rewhiten: bool, equations: Any) -> None:
    """Adds the rows of all contacts in use, weighted by the inverse of their covariance: at this pose if `rewhiten`,
    else at the pose of the last rewhitening."""
    for i in range(len(evidence.terms)):
        term = evidence.terms[i]
        if term.contact.used:
            surface = surface_at(evidence.nodes, field, vector(term.contact.point), pose)
            if rewhiten:
                whiten(evidence.model, evidence.nodes, field, term, surface)
            add_contact(term, surface, frame, equations)


@inner
def whiten(model: Any, nodes: Any, field: Any, term: Any, surface: Surface) -> None:
    """Fills in the inverse and the log determinant of the covariance of a contact's residuals."""
    factor = factored(residual_covariance(model, nodes, field, term, surface))
    term.variance_distance = factor[0]
    invert_covariance(factor, term.contact.has_normal != 0, term.weight)
    term.log_spread = log_determinant(factor, term.contact.has_normal != 0)


@inner
def contact_cost(evidence: Any, pose: Pose) -> float:
    """Returns the squared residuals of all contacts in use, plus the log determinants of their covariances, on the fine
    field."""
    model = evidence.model
    nodes = evidence.nodes
    field = evidence.model.fine
    total = 0.0
    for i in range(len(evidence.terms)):
        term = evidence.terms[i]
        if term.contact.used:
            surface = surface_at(nodes, field, vector(term.contact.point), pose)
            factor = factored(residual_covariance(model, nodes, field, term, surface))
            total += mahalanobis2(term.contact, surface, factor)
            total += log_determinant(factor, term.contact.has_normal != 0)
    return total


@inner
def residual_covariance(model: Any, nodes: Any, field: Any, term: Any, surface: Surface) -> Covariance:
    """Returns the covariance of a contact's (distance, normal) residuals: B Σ Bᵀ with B = [g 0; K -1], plus the errors
    of model and field.

    Along a curved surface the normal changes with the point. So curvature propagates the noise of the point into the
    residual of the normal, which has less weight near an edge than on a face. The errors of model and field are the
    same at contacts near each other, so each of a crowd has them that many times.
    """
    _, g, _, K, place = surface
    contact = term.contact
    of_distance, of_normal = field_error(model.error, nodes, place)
    if term.isotropic:
        v = term.variance_point
        distance = v * dot(g, g)
        both = scale(mul(K, g), v)
        normal = add33(scale33(matmul(K, transpose(K)), v), block(contact.covariance, 3, 3))
    else:
        P, X = block(contact.covariance, 0, 0), block(contact.covariance, 0, 3)
        Pg, KX = mul(P, g), matmul(K, X)
        distance = dot(g, Pg)
        both = sub(mul(K, Pg), tmul(X, g))
        normal = add33(matmul(matmul(K, P), transpose(K)), block(contact.covariance, 3, 3))
        normal = sub33(normal, add33(KX, transpose(KX)))
    of_distance = term.crowd * (of_distance + field.variance_distance)
    of_normal = term.crowd * (of_normal + field.variance_normal)
    tangential = (normal[0][0] + normal[1][1] + normal[2][2] + 3 * of_normal) / 2
    # Along the normal itself a unit vector has no first-order noise; the mean tangential variance there makes large
    # angles cost. Without a normal, a one keeps the matrix from being singular.
    n = vector(contact.normal)
    rest = of_normal + (0.0 if contact.has_normal else 1.0)
    ball = (rest, 0.0, 0.0), (0.0, rest, 0.0), (0.0, 0.0, rest)
    return distance + of_distance, both, add33(add33(normal, ball), scale33(outer(n, n), tangential))


@inner
def field_error(error: Any, nodes: Any, place: Vec3) -> tuple[float, float]:
    """Returns the error of the fine field near a point of the object: variances of its distance and its normal."""
    if error.inverse_cell == 0.0:
        return error.least_distance, error.least_normal
    distance, normal = model_error(error, nodes, place, 0)
    return error.least_distance + distance, error.least_normal + normal


@inner
def model_error(error: Any, nodes: Any, place: Vec3, first: int) -> tuple[float, float]:
    """Returns two of the four variances of a model's error near a point of the object, linear between nodes.

    `first` 0: of distance [m²] and normal [rad²]; 2: of the bumps' slope [rad²] and curvature [1/m²], times 3.84.
    """
    one = 0.0
    other = 0.0
    nx, ny, nz = error.shape[0], error.shape[1], error.shape[2]
    u = scale(sub(place, vector(error.origin)), error.inverse_cell)
    x, y, z = clamped(u[0], 0.0, nx - 1.001), clamped(u[1], 0.0, ny - 1.001), clamped(u[2], 0.0, nz - 1.001)
    i, j, k = int(x), int(y), int(z)
    x, y, z = x - i, y - j, z - k
    for a in range(2):
        for b in range(2):
            at = error.nodes + first + 4 * (((i + a) * ny + j + b) * nz + k)
            share = (x if a else 1 - x) * (y if b else 1 - y)
            one += share * ((1 - z) * nodes[at] + z * nodes[at + 4])
            other += share * ((1 - z) * nodes[at + 1] + z * nodes[at + 5])
    return one, other


@inner
def factored(S: Covariance) -> Factor:
    """Returns L D Lᵀ of a covariance of (distance, normal)."""
    s, b, N = S
    low = scale(b, 1 / s)
    d1 = N[0][0] - b[0] * low[0]
    p21, p31 = N[1][0] - b[1] * low[0], N[2][0] - b[2] * low[0]
    l21, l31 = p21 / d1, p31 / d1
    d2 = N[1][1] - b[1] * low[1] - p21 * l21
    p32 = N[2][1] - b[2] * low[1] - p31 * l21
    l32 = p32 / d2
    return s, low, (d1, d2, N[2][2] - b[2] * low[2] - p31 * l31 - p32 * l32), (l21, l31, l32)


@inner
def log_determinant(factor: Factor, has_normal: bool) -> float:
    """Returns the log determinant of the covariance; without a normal, that of the distance alone."""
    d0, _, d, _ = factor
    return np.log((d0 * d[0]) * (d[1] * d[2])) if has_normal else np.log(d0)


@inner
def invert_covariance(factor: Factor, has_normal: bool, out: Any) -> None:
    """Fills `out` (4, 4) with the inverse of the covariance; without a normal, that of the distance alone."""
    d0, low, d, (l21, l31, l32) = factor
    if not has_normal:
        out[:] = 0.0
        out[0, 0] = 1 / d0
        return
    # Rows of L⁻¹, below its diagonal of ones.
    a = -low[0]
    b0 = l21 * low[0] - low[1]
    b1 = -l21
    c1 = l32 * l21 - l31
    c2 = -l32
    c0 = -low[2] - l31 * a - l32 * b0
    e1, e2, e3 = 1 / d[0], 1 / d[1], 1 / d[2]
    out[0, 0] = 1 / d0 + a * a * e1 + b0 * b0 * e2 + c0 * c0 * e3
    out[1, 1] = e1 + b1 * b1 * e2 + c1 * c1 * e3
    out[2, 2] = e2 + c2 * c2 * e3
    out[3, 3] = e3
    out[0, 1] = out[1, 0] = a * e1 + b0 * b1 * e2 + c0 * c1 * e3
    out[0, 2] = out[2, 0] = b0 * e2 + c0 * c2 * e3
    out[1, 2] = out[2, 1] = b1 * e2 + c1 * c2 * e3
    out[0, 3] = out[3, 0] = c0 * e3
    out[1, 3] = out[3, 1] = c1 * e3
    out[2, 3] = out[3, 2] = c2 * e3


@inner
def mahalanobis2(contact: Any, surface: Surface, factor: Factor) -> float:
    """Returns the squared whitened residuals of a contact."""
    distance, _, facing, _, _ = surface
    d0, low, d, (l21, l31, l32) = factor
    square = distance * distance / d0
    if contact.has_normal:
        error = sub(sub(facing, vector(contact.normal)), scale(low, distance))
        y = error[1] - l21 * error[0]
        z = error[2] - l31 * error[0] - l32 * y
        square += error[0] * error[0] / d[0] + y * y / d[1] + z * z / d[2]
    return square
