"""A correction's evidence in plain NumPy, one pose at a time and without derivatives: what its kernels are judged by."""

import numpy as np
from scipy.stats import multivariate_normal, multivariate_t

from handsight import se3
from handsight.checks import Array
from handsight.correction.kernels import prior_term
from handsight.correction.kernels.outside_term import POWER
from handsight.correction.problem import Problem
from oracles import fields

LEAST_ERROR = (1e-4, 2e-3)
STEP = 1e-6


def surface(problem: Problem, points_palm: Array, T: Array) -> tuple[Array, Array, Array, Array]:
    """Distance (n,), its gradient (n, 3), unit normal (n, 3) and the normal's derivative (n, 3, 3) at palm points."""
    values = fields.evaluate(problem.model.fine, se3.apply(se3.inverse(T), points_palm))
    R = T[:3, :3]
    gradient = values.gradient @ R.T
    length = np.linalg.norm(gradient, axis=1)[:, None]
    normal = gradient / length
    hessian = R @ values.hessian @ R.T
    along = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    return values.distance, gradient, normal, along @ hessian / length[..., None]


def covariance(problem: Problem, T: Array) -> Array:
    """(n, 4, 4) of every contact's distance and normal, to first order in the errors of point and normal."""
    contacts, model = problem.contacts, problem.model
    _, gradient, _, curvature = surface(problem, contacts.points_palm, T)
    n = len(contacts)
    by_error = np.zeros((n, 4, 6))
    by_error[:, 0, :3], by_error[:, 1:, 3:] = gradient, -np.eye(3)
    by_error[:, 1:, :3] = curvature
    S = by_error @ contacts.covariance @ by_error.transpose(0, 2, 1)
    own = np.tile([(LEAST_ERROR[0] * model.diameter) ** 2, LEAST_ERROR[1] ** 2], (n, 1))
    if model.field_error is not None:
        own += fields.variances(model.field_error, se3.apply(se3.inverse(T), contacts.points_palm))[:, :2]
    S[:, 0, 0] += own[:, 0]
    S[:, 1:, 1:] += own[:, 1, None, None] * np.eye(3)
    # Along the normal, where a unit vector has no noise of first order, the mean variance of the tangents.
    tangential = np.trace(S[:, 1:, 1:], axis1=1, axis2=2) / 2
    normals = np.where(contacts.has_normal[:, None], contacts.normals_palm, 0.0)
    S[:, 1:, 1:] += tangential[:, None, None] * normals[:, :, None] * normals[:, None, :]
    return S


def of_contacts(problem: Problem, T: Array, T_weights: Array, used: Array | None = None) -> Array:
    """Residuals (n, 4) of the contacts at `T`, whitened as at `T_weights`; zeros for what does not count."""
    contacts = problem.contacts
    distance, _, normal, _ = surface(problem, contacts.points_palm, T)
    S, rows = covariance(problem, T_weights), np.zeros((len(contacts), 4))
    for i in range(len(contacts)):
        size = 4 if contacts.has_normal[i] else 1
        if used is None or used[i]:
            error = np.concatenate([distance[i : i + 1], normal[i] - contacts.normals_palm[i]])[:size]
            rows[i, :size] = np.linalg.solve(np.linalg.cholesky(S[i, :size, :size]), error)
    return rows


def log_spread(problem: Problem, T: Array, used: Array | None = None) -> float:
    """log det of the covariances of the contacts that count."""
    S, total = covariance(problem, T), 0.0
    for i in range(len(S)):
        size = 4 if problem.contacts.has_normal[i] else 1
        if used is None or used[i]:
            total += np.linalg.slogdet(S[i, :size, :size])[1]
    return total


def of_prior(problem: Problem, T: Array) -> Array:
    """Residuals (6,) of vision: the pivot's shift and the turn, or swing of the axis; nothing of a spin."""
    vision, axes = problem.vision, problem.model.symmetries.axes
    T_vision = vision.T_palm_object
    R = T_vision[:3, :3]
    pivot = problem.model.center_object  # or the point on the axes that is nearest to it
    if len(axes) > 1:
        pivot = axes[0][0]
    elif axes:
        point, direction = axes[0]
        pivot = point + direction * (direction @ (pivot - point))
    if axes:
        a, b = R @ axes[0][1], T[:3, :3] @ axes[0][1]
        product = np.cross(a, b)
        sine = np.linalg.norm(product)
        turn = product * (np.arctan2(sine, a @ b) / sine if sine > 1e-12 else 1.0)
    else:
        turn = se3.rotation_log(T[:3, :3] @ R.T)
    root = np.linalg.cholesky(np.linalg.inv(vision.covariance)).T
    from_pivot = np.eye(6)
    from_pivot[:3, 3:] = se3.skew(R @ pivot)
    root = root @ from_pivot
    if axes:
        # Spins take up what they can: the rows' part across what spins do.
        spins = root[:, 3:] @ R @ np.stack([axis for _, axis in axes], axis=1)
        root = root - spins @ np.linalg.pinv(spins) @ root
    shift = se3.apply(T, pivot[None])[0] - se3.apply(T_vision, pivot[None])[0]
    return root @ np.concatenate([shift, turn])


def tail(problem: Problem, T: Array) -> tuple[float, float]:
    """The weight of vision's rows, and what they cost beside their weighted squares: 1 and 0, but in the tail of
    vision's errors, by SciPy's densities of a Student's t and a Gaussian."""
    if problem.vision is None:
        return 1.0, 0.0
    k = 6 - len(problem.model.symmetries.axes)
    none = np.zeros(k)
    student = multivariate_t(none, df=prior_term.TAIL_FREEDOM)
    peak = multivariate_normal(none).logpdf(none)

    def cost(square: float) -> float:
        there = np.r_[np.sqrt(square), none[1:]]
        return float(prior_term.IN_TAIL - 2 * (student.logpdf(there) - peak))

    r = of_prior(problem, T)
    square = float(r @ r)
    if cost(square) >= square:
        return 1.0, 0.0
    step = 1e-4 * square
    weight = (cost(square + step) - cost(square - step)) / (2 * step)
    return weight, cost(square) - weight * square


def of_outside(problem: Problem, T: Array, power: int = POWER) -> Array:
    """Residuals (links,) of the hand: the norm of how deep a link's points are, in their deviations."""
    rows = problem.outside
    places = se3.apply(se3.inverse(T), rows["point"])
    distance = fields.evaluate(problem.model.fine, places).distance if len(rows) else np.empty(0)
    deep = np.maximum(-(distance + rows["slack"]), 0.0) / rows["sigma"]
    return np.array(
        [(deep[rows["link"] == k] ** power).sum() ** (1 / power) for k in np.unique(rows["link"])]
    )


def of_weight(problem: Problem, T: Array) -> Array:
    """Residuals (3,) of the object's weight, where it is known: its centre of mass is where the loads have it."""
    weight = problem.weight
    if weight is None:
        return np.empty(0)
    root = np.linalg.cholesky(np.linalg.inv(weight.covariance)).T
    return root @ (se3.apply(T, weight.center_object[None])[0] - weight.center_palm)


def residuals(
    problem: Problem,
    T: Array,
    T_weights: Array | None = None,
    used: Array | None = None,
    by_vision: float = 1.0,
) -> Array:
    """All of them, whitened as at `T_weights`, which is `T` where not given; vision's with a weight."""
    weights = T if T_weights is None else T_weights
    touch = of_contacts(problem, T, weights, used).reshape(-1)
    sight = np.empty(0) if problem.vision is None else np.sqrt(by_vision) * of_prior(problem, T)
    return np.concatenate([touch, of_outside(problem, T), sight, of_weight(problem, T)])


def posterior_cost(problem: Problem, T: Array, used: Array | None = None) -> float:
    """Minus two log of the density, up to a constant; blind, with the weak prior on the center's position."""
    by_vision, more = tail(problem, T)
    r = residuals(problem, T, used=used, by_vision=by_vision)
    total = r @ r + more + log_spread(problem, T, used)
    if problem.vision is None:
        center = se3.apply(T, problem.model.center_object[None])[0]
        off = (center - problem.contacts.points_palm.mean(axis=0)) / problem.model.radius
        total += off @ off
    return float(total)


def turned(T: Array, step: Array, center: Array) -> Array:
    """The pose after a shift and a turn (6,) about a palm point."""
    Q = se3.rotation_exp(step[3:])
    return se3.compose(Q @ T[:3, :3], Q @ (T[:3, 3] - center) + center + step[:3])


def jacobian(function, T: Array, center: Array) -> Array:
    """Central differences (r, 6) of a function of the pose, by a shift and a turn about a palm point."""
    columns = [
        (function(turned(T, step, center)) - function(turned(T, -step, center))) / (2 * STEP)
        for step in STEP * np.eye(6)
    ]
    return np.stack(columns, axis=1)


def spurious_information(problem: Problem, T: Array) -> Array:
    """(6, 6) information by (δp, δθ) that bumps add to the contacts, on the average."""
    contacts, F = problem.contacts, np.zeros((6, 6))
    _, _, normals, _ = surface(problem, contacts.points_palm, T)
    bumps = fields.variances(problem.model.field_error, se3.apply(se3.inverse(T), contacts.points_palm))[
        :, 2:
    ]
    S = covariance(problem, T)
    for i in range(len(contacts)):
        W, size = np.zeros((4, 4)), 4 if contacts.has_normal[i] else 1
        W[:size, :size] = np.linalg.inv(S[i, :size, :size])
        f = W[0, 0] * bumps[i, 0] + 1.5 * np.trace(W[1:, 1:]) / 2.5 * bumps[i, 1]
        x, y, z = contacts.points_palm[i] - T[:3, 3]
        B = np.hstack([np.eye(3), -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])])
        F += f * B.T @ (np.eye(3) - np.outer(normals[i], normals[i])) @ B
    return F


def cost_deviation(problem: Problem, T: Array, draws: int = 300) -> float:
    """Standard deviation of the contacts' cost where their errors stay what they are and bumps are drawn anew."""
    contacts, rng, square = problem.contacts, np.random.default_rng(0), 0.0
    _, _, normals, _ = surface(problem, contacts.points_palm, T)
    bumps = fields.variances(problem.model.field_error, se3.apply(se3.inverse(T), contacts.points_palm))
    S = covariance(problem, T)
    for i in range(len(contacts)):
        size = 4 if contacts.has_normal[i] else 1
        V = np.zeros((4, 4))
        V[0, 0] = bumps[i, 0]
        V[1:, 1:] = bumps[i, 2] / 3.84 * (np.eye(3) - np.outer(normals[i], normals[i]))
        V, whole = V[:size, :size], S[i, :size, :size]
        own = rng.multivariate_normal(np.zeros(size), whole - V, draws)
        by_bumps = rng.multivariate_normal(np.zeros(size), V, draws)
        r = own[:, None] + by_bumps
        square += np.einsum("abi,ij,abj->ab", r, np.linalg.inv(whole), r).var(axis=1).mean()
    return float(np.sqrt(square))
