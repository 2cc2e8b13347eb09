"""Exact distance fields of the box, the cylinder and the sphere, each centred at the object's origin.

At edges and on the axis the curvature is infinite: it is held below 1 / `least`, a length the user of the
field can resolve. On the medial axis, where the nearest point is not unique, the choice is fixed: the first
axis, the positive side, the side wall before the cap.
"""

import numpy as np

from handsight.checks import Array
from handsight.objects.fields.field import FieldValues

RESOLUTION = 72
"""Curvatures are held below this many per diameter."""
_EYE = np.eye(3)
_UP = np.array([0.0, 0.0, 1.0])


def _outer(a: Array) -> Array:
    return a[:, :, None] * a[:, None, :]


class SphereField:
    """The exact distance field of a ball."""

    __slots__ = ("least", "radius")

    def __init__(self, radius: float) -> None:
        """`radius` [m]."""
        self.radius = radius
        self.least = 2 * radius / RESOLUTION

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]."""
        r = np.sqrt((points_object * points_object).sum(axis=1))
        center = r == 0
        gradient = points_object / np.where(center, 1.0, r)[:, None]
        gradient[center] = _UP
        hessian = (_EYE - _outer(gradient)) / np.maximum(r, self.least)[:, None, None]
        return FieldValues(r - self.radius, gradient, hessian)


class BoxField:
    """The exact distance field of a box."""

    __slots__ = ("half", "least")

    def __init__(self, half: Array) -> None:
        """`half` (3,): half the sides along x, y, z [m]."""
        self.half = np.asarray(half, dtype=np.float64)
        self.least = float(2 * np.linalg.norm(self.half)) / RESOLUTION

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]."""
        n = len(points_object)
        side = np.where(points_object < 0, -1.0, 1.0)
        q = np.abs(points_object) - self.half
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
        hessian *= (away / np.maximum(outside, self.least))[:, None, None]
        return FieldValues(np.where(away, outside, q[rows, face]), gradient, hessian)


class CylinderField:
    """The exact distance field of a cylinder whose axis is z."""

    __slots__ = ("half_height", "least", "radius")

    def __init__(self, radius: float, half_height: float) -> None:
        """`radius` and half the height [m]."""
        self.radius = radius
        self.half_height = half_height
        self.least = 2 * float(np.hypot(radius, half_height)) / RESOLUTION

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]."""
        x, y, z = points_object.T
        r = np.hypot(x, y)
        qr, qz = r - self.radius, np.abs(z) - self.half_height
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
        around = gr / np.maximum(r, self.least)
        over = ((qr > 0) & (qz > 0)) / np.maximum(outside, self.least)
        hessian = around[:, None, None] * _outer(across) + over[:, None, None] * _outer(rim)
        return FieldValues(np.where(away, outside, np.maximum(qr, qz)), gradient, hessian)
