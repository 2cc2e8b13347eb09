"""Distance fields: how far a point is from the surface, with first and second derivatives.

Points, gradients and Hessians are in the object's frame. Distances are metres, negative inside.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.errors import InvalidInput


class FieldValues(NamedTuple):
    """A distance field at n points of the object's frame."""

    distance: Array
    """(n,) to the surface [m], negative inside."""
    gradient: Array
    """(n, 3) derivative of the distance; about unit, outward near the surface."""
    hessian: Array
    """(n, 3, 3) derivative of the gradient [1/m]."""


class Field(Protocol):
    """A distance field of an object."""

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]; nothing is checked, this is the hot path."""
        ...


_VALUE = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
_SLOPE = np.vstack([_VALUE[1:] * [[1], [2], [3]], np.zeros(4)])
_BEND = np.vstack([_SLOPE[1:] * [[1], [2], [3]], np.zeros(4)])
BASIS = np.hstack([_VALUE, _SLOPE, _BEND])
"""(4, 12): powers (1, f, f², f³) times this are the four weights, their slopes and their bends."""

# Where (i, j) of a Hessian stands among the 27 products of derivative orders (x, y, z), each 0 to 2.
_GRADIENT = np.array([9, 3, 1])
_HESSIAN = np.array([18, 12, 10, 12, 6, 4, 10, 4, 2])
_CHUNK = 4096


class GridField:
    """A uniform cubic B-spline over a grid of distances, its nodes used as coefficients.

    Without the prefilter of interpolation the spline smooths the samples by about a third of a cell (their
    mean over a kernel of variance cell²/3 per axis): wanted, because noise and facets have no curvature to
    offer. Second derivatives are continuous. Outside the grid the distance goes on as that to the surface
    point below the nearest point of the grid (see `_beyond`), with an exact gradient.
    """

    __slots__ = ("_flat", "_high", "_inverse", "_offsets", "_order", "_strides", "cell", "origin", "values")

    def __init__(self, origin: Array, cell: float, values: NDArray[np.float32]) -> None:
        """`origin` (3,): node (0, 0, 0) [m]; `cell`: node spacing [m]; `values` (nx, ny, nz) [m], each ≥ 4."""
        if values.ndim != 3 or min(values.shape) < 4:
            raise InvalidInput(f"values: expected at least 4 x 4 x 4 nodes, got shape {values.shape}")
        self.origin = np.asarray(origin, dtype=np.float64)
        self.cell = float(cell)
        self.values = np.ascontiguousarray(values, dtype=np.float32)
        self.values.flags.writeable = False
        _, ny, nz = values.shape
        self._flat = self.values.reshape(-1)
        self._high = np.array(values.shape) - 2.0
        self._inverse = 1 / self.cell
        self._strides = np.array([ny * nz, nz, 1])
        step = np.arange(-1, 3)
        self._offsets = (step[:, None, None] * ny * nz + step[:, None] * nz + step).reshape(-1)
        # Derivatives by u = p / cell become derivatives by p.
        self._order = (self._inverse ** np.add.outer(np.add.outer(np.r_[:3], np.r_[:3]), np.r_[:3])).reshape(
            -1
        )

    def __reduce__(self) -> tuple[type["GridField"], tuple[Array, float, NDArray[np.float32]]]:
        """For pickle: rebuilt from what it was made of."""
        return GridField, (self.origin, self.cell, self.values)

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]."""
        if len(points_object) > _CHUNK:  # keep the gathered neighbourhoods in cache
            parts = range(0, len(points_object), _CHUNK)
            values = [self.evaluate(points_object[k : k + _CHUNK]) for k in parts]
            return FieldValues(*(np.concatenate(column) for column in zip(*values, strict=True)))
        u = (points_object - self.origin) * self._inverse
        clamped = np.minimum(np.maximum(u, 1.0), self._high)
        inner = self._inside(clamped)
        beyond = u - clamped
        if beyond.any():
            return _beyond(inner, beyond * self.cell)
        return inner

    def _inside(self, u: Array) -> FieldValues:
        """The spline at grid coordinates `u` (n, 3), each in [1, size - 2]."""
        n = len(u)
        node = np.minimum(u, self._high - 1.0).astype(np.int64)
        f = u - node
        powers = np.empty((n, 3, 4))
        powers[..., 0] = 1.0
        powers[..., 1] = f
        powers[..., 2] = f * f
        powers[..., 3] = powers[..., 2] * f
        weights = (powers.reshape(-1, 4) @ BASIS).reshape(n, 3, 3, 4)
        nodes = self._flat.take((node @ self._strides)[:, None] + self._offsets).astype(np.float64)
        # One axis after another; the derivative's order of that axis takes the place of the nodes.
        along_x = weights[:, 0] @ nodes.reshape(n, 4, 16)
        along_z = along_x.reshape(n, 12, 4) @ weights[:, 2].swapaxes(1, 2)
        along_y = weights[:, None, 1] @ along_z.reshape(n, 3, 4, 3)
        products = along_y.reshape(n, 27) * self._order
        return FieldValues(
            products[:, 0], products.take(_GRADIENT, axis=1), products.take(_HESSIAN, axis=1).reshape(n, 3, 3)
        )


def _beyond(edge: FieldValues, w: Array) -> FieldValues:
    """The field at points a way `w` (n, 3) [m] outside the grid, from its values where they leave it.

    With m and g the distance and gradient at the edge, the surface point below is about -m g away, so
    f = |w + m g| = √(m² |g|² + 2 m g·w + |w|²), taken with |g| = 1 where w is 0 so that f is continuous.
    Continuous gradient too, bounded because |m H| ≤ 1 on a distance field. Where the edge of the grid lies
    inside the object (no model has this) f goes on linearly. The Hessian is that of the distance to a point.
    """
    m, g, H = edge
    free = w == 0
    slope = (g * w).sum(axis=1)
    by_edge = np.where(free, (H @ w[:, :, None])[..., 0], 0.0)
    outside = m > 0
    m = np.where(outside, m, 1.0)
    f = np.sqrt(np.maximum(m * m + 2 * m * slope + (w * w).sum(axis=1), 1e-300))
    sideways = np.where(free, g * slope[:, None], 0.0)
    gradient = (m[:, None] * (g + by_edge) + sideways + w) / f[:, None]
    still = free.all(axis=1)
    distance = np.where(outside, f, edge.distance + slope)
    gradient = np.where(outside[:, None], gradient, g + by_edge)
    length2 = np.maximum((gradient * gradient).sum(axis=1), 1e-12)[:, None, None]
    sphere = (np.eye(3) - gradient[:, :, None] * gradient[:, None, :] / length2) / f[:, None, None]
    keep = still | ~outside
    return FieldValues(
        np.where(still, edge.distance, distance),
        np.where(still[:, None], g, gradient),
        np.where(keep[:, None, None], H, sphere),
    )
