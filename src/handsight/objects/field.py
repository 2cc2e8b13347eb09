"""Signed distance to a surface, with gradient and Hessian: where contacts meet the object.

Distances [m] are negative inside. The gradient is the outward normal where the field is exact, and shorter
where a smooth one blends over an edge; the Hessian carries the surface's curvature.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from handsight.checks import Array


class FieldValues(NamedTuple):
    """The field at n points."""

    distance: Array
    """(n,) [m], negative inside."""
    gradient: Array
    """(n, 3)."""
    hessian: Array
    """(n, 3, 3) [1/m]."""


class Field(Protocol):
    """A signed distance field."""

    def evaluate(self, points_object: Array) -> FieldValues:
        """The field at points (n, 3) [m]."""
        ...


SPLINE = np.array([[1.0, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
"""Weights of four neighbours = [1, t, t², t³] @ SPLINE: the uniform cubic B-spline."""
POWERS = np.zeros((3, 4, 4))
"""[1, t, t², t³] @ POWERS[k] is its k-th derivative."""
POWERS[0] = np.eye(4)
POWERS[1, (0, 1, 2), (1, 2, 3)] = 1, 2, 3
POWERS[2, (0, 1), (2, 3)] = 2, 6
WEIGHTS = POWERS @ SPLINE
"""(3, 4, 4): weights, their first and second derivatives."""


@dataclass(frozen=True, slots=True, eq=False)
class GridField:
    """A field sampled on a grid and read through a cubic B-spline, which smooths it by about a cell.

    The smoothing is wanted: edges become round, facets of curved objects disappear, solvers see a curvature.
    Outside the grid the field goes on linearly.
    """

    origin: Array
    """(3,) the first node [m]."""
    cell: float
    """Spacing of the nodes [m]."""
    values: Array
    """(nx, ny, nz) float32, distance at the nodes [m]; at least 4 along each axis."""
    _flat: Array = field(init=False, repr=False)
    _strides: Array = field(init=False, repr=False)
    _offsets: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        _, ny, nz = values.shape
        steps = np.arange(4)
        offsets = steps[:, None, None] * (ny * nz) + steps[:, None] * nz + steps
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "_flat", values.reshape(-1))
        object.__setattr__(self, "_strides", np.array([ny * nz, nz, 1]))
        object.__setattr__(self, "_offsets", offsets.reshape(-1))
        values.setflags(write=False)

    def evaluate(self, points_object: Array) -> FieldValues:
        """The field at points (n, 3) [m]."""
        if len(points_object) > CHUNK:
            parts = [
                self.evaluate(part) for part in np.array_split(points_object, -(-len(points_object) // CHUNK))
            ]
            return FieldValues(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        n, h = len(points_object), self.cell
        place = (points_object - self.origin) / h
        inside = np.minimum(np.maximum(place, 1.0), np.array(self.values.shape) - 2.001)
        first = inside.astype(np.int64)
        t = (inside - first)[..., None]
        powers = np.concatenate([np.ones_like(t), t, t * t, t * t * t], axis=-1)
        weights = powers @ WEIGHTS[:, None]  # (derivative, n, axis, neighbour)
        x, y, z = weights.transpose(2, 1, 0, 3)  # each (n, derivative, neighbour)
        nodes = self._flat[((first - 1) @ self._strides)[:, None] + self._offsets]
        # Contract z, then y, then x; entry [a, c, b] is the derivative of order a, b, c along x, y, z.
        by_z = (nodes.reshape(n, 16, 4) @ z.swapaxes(1, 2)).reshape(n, 4, 4, 3)
        by_y = by_z.swapaxes(2, 3).reshape(n, 12, 4) @ y.swapaxes(1, 2)
        d = (x @ by_y.reshape(n, 4, 9)).reshape(n, 27)
        # Flat index of (a, c, b) is 9 a + 3 c + b.
        gradient = d[:, (9, 1, 3)] / h
        hessian = d[:, (18, 10, 12, 10, 2, 4, 12, 4, 6)].reshape(n, 3, 3) / (h * h)
        beyond = (place - inside) * h
        return FieldValues(d[:, 0] + (gradient * beyond).sum(axis=1), gradient, hessian)


CHUNK = 1 << 16
"""Points evaluated at once; bounds the memory of large queries."""
