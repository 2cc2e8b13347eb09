"""Distance, gradient and Hessian of an object's fields in plain NumPy and SciPy: what the kernel is judged by."""

import numpy as np
from scipy.interpolate import BSpline, RegularGridInterpolator

from handsight.checks import Array
from handsight.objects import ExactField, Field, FieldError, FieldValues, GridField

_EYE = np.eye(3)
_CUBIC = BSpline.basis_element(np.arange(-2, 3))
# How often to differentiate along x, y and z for the value, the gradient and the Hessian.
_ORDERS = [
    (0, 0, 0),
    *np.eye(3, dtype=int),
    *(a + b for a in np.eye(3, dtype=int) for b in np.eye(3, dtype=int)),
]


def evaluate(field: Field, points: Array) -> FieldValues:
    """Distance and derivatives at the points (n, 3) [m] of the object's frame."""
    kinds = {"grid": _grid, "box": _box, "cylinder": _cylinder, "sphere": _sphere}
    kind = "grid" if isinstance(field, GridField) else field.shape
    return kinds[kind](field, np.asarray(points, dtype=np.float64))


def variances(error: FieldError, points: Array) -> Array:
    """(n, 4) variances that a field says of itself near points (n, 3) [m]: linear between nodes."""
    axes = [o + error.cell * np.arange(n) for o, n in zip(error.origin, error.values.shape[:3], strict=True)]
    inside = np.clip(points, error.origin, [axis[-1] for axis in axes])
    return RegularGridInterpolator(axes, error.values)(inside)


def _grid(field: GridField, points: Array) -> FieldValues:
    """The cubic B-spline whose coefficients are the nodes; beyond the grid by `_beyond`."""
    u = (points - field.origin) / field.cell
    high = np.array(field.values.shape) - 2.0
    edge = np.clip(u, 1.0, high)
    node = np.minimum(edge, high - 1.0).astype(np.int64)[:, :, None] + np.arange(-1, 3)
    # (order, n, axis, 4): the weight of each of the four nodes around.
    weights = [np.nan_to_num(_CUBIC(edge[:, :, None] - node, nu=nu)) for nu in range(3)]
    nodes = field.values[node[:, 0, :, None, None], node[:, 1, None, :, None], node[:, 2, None, None, :]]
    if field.sheet:
        nodes = _on_one_side(nodes, edge - node[:, :, 1], field)
    products = [
        np.einsum("nijk,ni,nj,nk->n", nodes.astype(float), *(weights[o][:, k] for k, o in enumerate(order)))
        / field.cell ** sum(order)
        for order in _ORDERS
    ]
    inner = FieldValues(products[0], np.stack(products[1:4], 1), np.stack(products[4:], 1).reshape(-1, 3, 3))
    return _beyond(inner, (u - edge) * field.cell)


def _on_one_side(nodes: Array, past: Array, field: GridField) -> Array:
    """Nodes (n, 4, 4, 4), those with no surface on the way to the nearest one with its sign.

    `past` (n, 3): how far past the second node along each axis. A way from a node to another through the surface is at
    least as long as their distances to it add up to, but for the surface's blur.
    """
    nearest = 1 + (past > 0.5)
    here = nodes[np.arange(len(nodes)), *nearest.T][:, None, None, None]
    places = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1)
    way = field.cell * np.linalg.norm(places - nearest[:, None, None, None], axis=-1)
    return np.where(np.abs(nodes) + np.abs(here) > 1.02 * way + field.blur, np.copysign(nodes, here), nodes)


def _beyond(edge: FieldValues, w: Array) -> FieldValues:
    """The field at points a way `w` (n, 3) [m] outside the grid, as GridField's docstring has it, on either side."""
    side = np.where(edge.distance < 0, -1.0, 1.0)
    m, g, H = side * edge.distance, side[:, None] * edge.gradient, side[:, None, None] * edge.hessian
    free = w == 0
    slope = (g * w).sum(axis=1)
    by_edge = np.where(free, (H @ w[:, :, None])[..., 0], 0.0)
    f = np.sqrt(np.maximum(m * m + 2 * m * slope + (w * w).sum(axis=1), 1e-300))
    sideways = np.where(free, g * slope[:, None], 0.0)
    gradient = (m[:, None] * (g + by_edge) + sideways + w) / f[:, None]
    length2 = np.maximum((gradient * gradient).sum(axis=1), 1e-12)[:, None, None]
    sphere = (np.eye(3) - gradient[:, :, None] * gradient[:, None, :] / length2) / f[:, None, None]
    still = free.all(axis=1)
    return FieldValues(
        np.where(still, edge.distance, side * f),
        np.where(still[:, None], edge.gradient, side[:, None] * gradient),
        np.where(still[:, None, None], edge.hessian, side[:, None, None] * sphere),
    )


def least_radius(field: ExactField) -> float:
    """The shortest radius of curvature [m] that an exact field has: a 72nd of its object's diameter."""
    return 2 * float(np.linalg.norm(field.sizes)) / 72


def _outer(a: Array) -> Array:
    return a[:, :, None] * a[:, None, :]


def _sphere(field: ExactField, points: Array) -> FieldValues:
    r = np.sqrt((points * points).sum(axis=1))
    center = r == 0
    gradient = points / np.where(center, 1.0, r)[:, None]
    gradient[center] = np.array([0.0, 0.0, 1.0])
    hessian = (_EYE - _outer(gradient)) / np.maximum(r, least_radius(field))[:, None, None]
    return FieldValues(r - field.sizes[0], gradient, hessian)


def _box(field: ExactField, points: Array) -> FieldValues:
    n = len(points)
    side = np.where(points < 0, -1.0, 1.0)
    q = np.abs(points) - field.sizes
    beyond = np.maximum(q, 0.0)
    outside = np.sqrt((beyond * beyond).sum(axis=1))
    face = q.argmax(axis=1)
    rows = np.arange(n)
    # Scaled by the largest entry, so that the direction survives a distance of 1e-170.
    largest = beyond[rows, face]
    away = largest > 0
    scaled = beyond / np.where(away, largest, 1.0)[:, None]
    direction = scaled / np.where(away, np.sqrt((scaled * scaled).sum(axis=1)), 1.0)[:, None]
    inward = np.zeros((n, 3))
    inward[rows, face] = 1.0
    gradient = np.where(away[:, None], direction, inward) * side
    hessian = -_outer(gradient)
    for k in range(3):
        hessian[:, k, k] += q[:, k] > 0
    hessian *= (away / np.maximum(outside, least_radius(field)))[:, None, None]
    return FieldValues(np.where(away, outside, q[rows, face]), gradient, hessian)


def _cylinder(field: ExactField, points: Array) -> FieldValues:
    x, y, z = points.T
    r = np.hypot(x, y)
    qr, qz = r - field.sizes[0], np.abs(z) - field.sizes[1]
    er, ez = np.maximum(qr, 0.0), np.maximum(qz, 0.0)
    outside = np.hypot(er, ez)
    away = outside > 0
    wall = qr >= qz
    safe = np.where(away, outside, 1.0)
    # In the half plane (radial, axial) the cylinder is a rectangle.
    gr = np.where(away, er / safe, wall)
    gz = np.where(away, ez / safe, ~wall) * np.where(z < 0, -1.0, 1.0)
    axis = r == 0
    reach = np.where(axis, 1.0, r)
    cosine, sine = np.where(axis, 1.0, x / reach), y / reach
    gradient = np.stack([gr * cosine, gr * sine, gz], axis=1)
    across = np.stack([-sine, cosine, np.zeros_like(sine)], axis=1)
    rim = np.stack([-gz * cosine, -gz * sine, gr], axis=1)
    around = gr / np.maximum(r, least_radius(field))
    over = ((qr > 0) & (qz > 0)) / np.maximum(outside, least_radius(field))
    hessian = around[:, None, None] * _outer(across) + over[:, None, None] * _outer(rim)
    return FieldValues(np.where(away, outside, np.maximum(qr, qz)), gradient, hessian)
