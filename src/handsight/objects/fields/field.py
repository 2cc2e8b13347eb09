"""Distance fields: how far a point is from the surface, with first and second derivatives.

Points, gradients and Hessians are in the object's frame. Distances are metres, negative inside. A field is data alone;
what it is worth at a point is computed by `handsight._kernels.field`.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

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


class Field:
    """A distance field of an object: a grid, or exact.

    Exact ones are centred at the object's origin. On the medial axis, where the nearest point is not unique, the
    choice is fixed: the first axis, the positive side, the side wall before the cap.
    """

    def evaluate(self, points_object: Array) -> FieldValues:
        """Distance and derivatives at the points (n, 3) [m]; nothing is checked, this is the hot path."""
        from handsight.objects.record import evaluate  # numba's import is long

        return evaluate(*self._record, points_object)

    @cached_property
    def _record(self) -> tuple[NDArray[np.void], NDArray[np.float32]]:
        from handsight.objects.record import field_record  # as above

        return field_record(self)

    def __reduce__(self) -> tuple[type["Field"], tuple[Any, ...]]:
        """For pickle: rebuilt from what it was made of."""
        return type(self), tuple(getattr(self, part.name) for part in fields(self))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class GridField(Field):
    """A uniform cubic B-spline over a grid of distances, its nodes used as coefficients.

    Without the prefilter of interpolation the spline smooths the samples by about a third of a cell (their
    mean over a kernel of variance cell²/3 per axis): wanted, because noise and facets have no curvature to
    offer. Second derivatives are continuous.

    Outside the grid the distance goes on as that to the surface point below the nearest point of the grid. With m and g
    the distance and gradient there and w the way out, that point is about -m g away, so f = |w + m g| =
    √(m² |g|² + 2 m g·w + |w|²), taken with |g| = 1 where w is 0 so that f is continuous. The gradient is exact and
    continuous, bounded because |m H| ≤ 1 on a distance field; the Hessian is that of the distance to a point. Where the
    edge of the grid lies inside the object (no model has this) f goes on linearly.
    """

    origin: Array
    """(3,) node (0, 0, 0) [m]."""
    cell: float
    """Between neighbouring nodes [m]."""
    values: NDArray[np.float32]
    """(nx, ny, nz) distances [m], each side at least 4; read-only."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for too few nodes."""
        if self.values.ndim != 3 or min(self.values.shape) < 4:
            raise InvalidInput(f"values: expected at least 4 x 4 x 4 nodes, got shape {self.values.shape}")
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)


@dataclass(frozen=True, eq=False)
class SphereField(Field):
    """The exact distance field of a ball."""

    radius: float
    """[m]."""


@dataclass(frozen=True, eq=False)
class BoxField(Field):
    """The exact distance field of a box."""

    half: Array
    """(3,) half the sides along x, y, z [m]."""


@dataclass(frozen=True, eq=False)
class CylinderField(Field):
    """The exact distance field of a cylinder whose axis is z."""

    radius: float
    """[m]."""
    half_height: float
    """[m]."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldError:
    """How far a fine field is off the surface it was made of, place by place, on a grid over the object.

    A grid rounds off edges and irons out facets; near a rim its normal may be wrong by tens of degrees where on
    a face it is right to one. A contact is only as good as the model where it touches.
    """

    origin: Array
    """(3,) the first node [m]."""
    cell: float
    """Spacing of the nodes [m]."""
    values: Array
    """(nx, ny, nz, 2): variance of the distance [m²] and of the normal per axis [rad²]."""
