"""A distance field as the flat numbers that kernels take (`handsight._kernels.layout`)."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import field as kernel
from handsight._kernels import layout as at
from handsight._kernels.threads import in_parts
from handsight.checks import Array
from handsight.objects.fields.field import (
    BoxField,
    CylinderField,
    Field,
    FieldValues,
    GridField,
    SphereField,
)

MANY = 16_384
"""Points that are worth another thread."""


def packed_field(field: Field, nodes: int) -> tuple[Array, NDArray[np.float32]]:
    """The field's numbers (FIELD,) and its nodes, none where it is exact; they will begin at `nodes`."""
    numbers = np.zeros(at.FIELD)
    if isinstance(field, GridField):
        numbers[at.KIND] = at.GRID
        numbers[at.ORIGIN : at.ORIGIN + 3] = field.origin
        numbers[at.CELL], numbers[at.INVERSE_CELL] = field.cell, 1 / field.cell
        numbers[at.SHAPE : at.SHAPE + 3] = field.values.shape
        numbers[at.NODES] = nodes
        return numbers, field.values.reshape(-1)
    if isinstance(field, BoxField):
        numbers[at.KIND], numbers[at.ORIGIN : at.ORIGIN + 3] = at.BOX, field.half
    elif isinstance(field, CylinderField):
        numbers[at.KIND], numbers[at.ORIGIN : at.ORIGIN + 2] = at.CYLINDER, (field.radius, field.half_height)
    elif isinstance(field, SphereField):
        numbers[at.KIND], numbers[at.ORIGIN] = at.SPHERE, field.radius
    else:
        raise TypeError(f"field: expected a grid, box, cylinder or sphere, got {type(field).__name__}")
    numbers[at.LEAST] = field.least
    nothing = np.empty(0, dtype=np.float32)
    nothing.flags.writeable = False  # as a grid's nodes are: to a kernel that is another type
    return numbers, nothing


def looked_up(field: Field, points_object: Array) -> FieldValues:
    """As `field.evaluate`, in a kernel."""
    return evaluated(packed_field(field, 0), points_object)


def evaluated(packed: tuple[Array, NDArray[np.float32]], points_object: Array) -> FieldValues:
    """As `evaluate` of the field that was packed, in a kernel on all cores."""
    numbers, nodes = packed
    points = np.require(points_object, np.float64, ["C", "W"])
    values = np.empty((len(points), 13))
    in_parts(partial(kernel.evaluate, numbers, nodes, 0, points, values), len(points), MANY)
    return FieldValues(values[:, 0], values[:, 1:4], values[:, 4:].reshape(-1, 3, 3))
