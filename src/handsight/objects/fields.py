"""Distance fields, with two derivatives, and the grids that they are sampled on.

Points, gradients and Hessians are in the object's frame. Distances are in metres, negative inside. A field is only
data; `handsight.objects.kernels.field` computes its value at a point.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._compiled import records
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput


class FieldValues(NamedTuple):
    """Distance field and its two derivatives at n points of the object's frame."""

    distance: Array
    """(n,) to the surface [m], negative inside."""
    gradient: Array
    """(n, 3) derivative of the distance; near the surface it points outward and has about unit length."""
    hessian: Array
    """(n, 3, 3) derivative of the gradient [1/m]."""


class Field:
    """Distance field of an object: a `GridField` or an `ExactField`.

    Exact ones are centred at the object's origin. On the medial axis, where the nearest point is not unique, the
    choice is fixed: the first axis, the positive side, the side wall before the cap.
    """

    def evaluate(self, points_object: Array) -> FieldValues:
        """Returns distance, gradient and Hessian at points (n, 3) [m], on all cores; the points are not checked."""
        from handsight._compiled.threads import in_parts
        from handsight.objects.kernels import field as kernel  # numba's import is long

        points = np.require(points_object, np.float64, ["C", "W"])
        values = np.empty((len(points), 13))
        record, nodes = self.record
        # Fewer are not worth another thread's start.
        in_parts(partial(kernel.evaluate, nodes, record), (points, values), 16_384)
        return FieldValues(values[:, 0], values[:, 1:4], values[:, 4:].reshape(-1, 3, 3))

    def fill(self, row: np.void, first_node: int) -> NDArray[np.float32]:
        """Fills a FIELD record and returns the field's nodes, which begin at `first_node` among those of the object."""
        raise NotImplementedError

    @cached_property
    def record(self) -> tuple[NDArray[np.void], NDArray[np.float32]]:
        """The FIELD record (1,) of this field on its own, and its nodes."""
        record = np.zeros(1, dtype=records.FIELD)
        return record, np.array(self.fill(record[0], 0))  # a copy, because kernels take writable nodes

    def __reduce__(self) -> tuple[type["Field"], tuple[Any, ...]]:
        """Returns the class and the values of its dataclass fields for pickle, without the cached record."""
        return type(self), tuple(getattr(self, part.name) for part in fields(self))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class GridField(Field):
    """Uniform cubic B-spline over a grid of distances, its nodes used as coefficients.

    Without the prefilter of interpolation the spline smooths the samples by about a third of a cell (their
    mean over a kernel of variance cell²/3 per axis). That is intended, because the curvature of noise and of facets
    is not the object's. Second derivatives are continuous.

    Outside the grid the distance is that to the surface point below the nearest point of the grid. With m and g the
    distance and gradient there and w the vector from there, that point is about -m g away, so f = |w + m g| =
    √(m² |g|² + 2 m g·w + |w|²), with |g| = 1 where w is 0 so that f is continuous. The gradient is exact and
    continuous, and bounded because |m H| ≤ 1 on a distance field; the Hessian is that of the distance to a point.

    Around a `sheet`, a surface that has no inside, distances are negative behind it, and somewhere beyond its rim the
    sign must change where no surface is. A continuous field would be zero there. So before nodes are interpolated,
    those with no surface between them and the node nearest to the point take that node's sign: then the sign jumps, and
    the size of the distance does not. There is no surface between two places whose distances add up to more than the
    distance between them and the sheet's `blur`.
    """

    origin: Array  # (3,) node (0, 0, 0) [m]
    cell: float  # between neighbouring nodes [m]
    values: NDArray[np.float32]  # (nx, ny, nz) distances [m], each side at least 4; read-only
    sheet: bool = False  # whether the surface has no inside; the sign is then that of its sides
    blur: float = 0.0
    """How much the distances at two places on different sides of the sheet may add up to beyond the distance between
    these places [m]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for too few nodes."""
        if self.values.ndim != 3 or min(self.values.shape) < 4:
            raise InvalidInput(f"values: expected at least 4 x 4 x 4 nodes, got shape {self.values.shape}")
        values = np.ascontiguousarray(self.values, dtype=np.float32)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def fill(self, row: np.void, first_node: int) -> NDArray[np.float32]:
        """Fills a FIELD record and returns the nodes; see `Field.fill`."""
        row["kind"] = records.SHEET if self.sheet else records.GRID
        row["blur"] = self.blur
        row["origin"] = self.origin
        row["nodes"] = first_node
        row["cell"] = self.cell
        row["inverse_cell"] = 1 / self.cell
        row["shape"] = self.values.shape
        return self.values.reshape(-1)


@dataclass(frozen=True, eq=False)
class ExactField(Field):
    """Exact distance field of a box, of a cylinder whose axis is z, or of a ball."""

    shape: Literal["box", "cylinder", "sphere"]
    sizes: Array
    """(3,) [m]: half the sides; or radius, half the height, 0; or radius, 0, 0. Its length is half the diameter."""

    def fill(self, row: np.void, first_node: int) -> NDArray[np.float32]:
        """Fills a FIELD record and returns no nodes; see `Field.fill`."""
        kinds = {"box": records.BOX, "cylinder": records.CYLINDER, "sphere": records.SPHERE}
        row["kind"] = kinds[self.shape]
        row["origin"] = self.sizes
        # Without a limit the curvature would be infinite at edges and on the axis.
        row["least_radius"] = 2 * np.linalg.norm(self.sizes) / 72
        return np.empty(0, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class FieldError:
    """Error of a fine distance field as a function of place, on a grid over the object.

    A grid of distances rounds off edges and facets: near an edge its normal may be wrong by tens of degrees, on a face
    by less than one. A contact is only as exact as the model where it touches.
    """

    origin: Array  # (3,) the first node [m]
    cell: float  # spacing of the nodes [m]
    values: Array
    """(nx, ny, nz, 4): variances of the distance [m²] and of the normal per axis [rad²]; then those of the slope [rad²]
    and of the curvature [1/m²], from which follows the spurious information that a scan's bumps add about a flat
    direction. The last two are zero for a surface that is no scan."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Regular grid of nodes."""

    origin: Array  # (3,) node (0, 0, 0) [m]
    cell: float  # between neighbours [m]
    shape: tuple[int, int, int]

    def nodes(self) -> Array:
        """Returns (nx ny nz, 3) positions [m], z fastest."""
        return self.nodes_at(np.arange(int(np.prod(self.shape))))

    def nodes_at(self, index: Indices) -> Array:
        """Returns (n, 3) positions [m] of the nodes with these indices (n,) in the flat order."""
        return self.origin + self.cell * np.stack(np.unravel_index(index, self.shape), axis=-1)

    def field(self, values: Array, *, sheet: bool = False, blur: float = 0.0) -> GridField:
        """Returns the field with these distances (nx ny nz,) [m] at the nodes; `sheet` and `blur` as in `GridField`."""
        nodes = values.reshape(self.shape).astype(np.float32)
        return GridField(self.origin, self.cell, nodes, sheet, blur)


def grids(vertices: Array, diameter: float) -> tuple[Grid, Grid, tuple[str, ...]]:
    """Returns the coarse and the fine grid around vertices (k, 3) [m], with a remark where their cells are large."""
    centered = vertices - vertices.mean(axis=0)
    principal = np.linalg.eigh(centered.T @ centered)[1]
    width = min(np.ptp(vertices, axis=0).min(), np.ptp(centered @ principal, axis=0).min())
    coarse, thin = coarse_grid(vertices, diameter, float(width))
    cell = coarse.cell / 4  # with a margin of eight
    fine, capped = _grid(vertices, cell, lambda c: 8 * c, 4_000_000)
    if not (thin or capped):
        return coarse, fine, ()
    cells = f"{1000 * coarse.cell:.3g} mm and {1000 * fine.cell:.3g} mm"
    return coarse, fine, (f"very long or thin: its distance fields are coarser than usual, cells of {cells}",)


def coarse_grid(vertices: Array, diameter: float, width: float) -> tuple[Grid, bool]:
    """Returns the grid of the coarse field around vertices (k, 3) [m], and whether the limit on nodes made it coarser.

    `diameter` [m]; `width`: the smallest extent [m], 0 for a flat sheet. The grid's margin is half the diameter.
    """
    cell = diameter / 18  # and four cells along a shorter extent
    if width > 1e-6 * diameter:
        cell = min(cell, width / 4)
    return _grid(vertices, cell, lambda c: max(diameter / 2, 3 * c), 400_000)


def _grid(vertices: Array, cell: float, margin: Callable[[float], float], most: int) -> tuple[Grid, bool]:
    """Returns a grid of at most `most` nodes, and whether its cells had to be larger than `cell` [m].

    `margin(cell)`: width that the grid reaches beyond the vertices (k, 3) [m].
    """
    enlarged = False
    while True:
        shape = np.ceil((np.ptp(vertices, axis=0) + 2 * margin(cell)) / cell) + 3
        if np.prod(shape) <= most:
            return centered_grid(vertices, cell, shape), enlarged
        cell = cell * 1.1
        enlarged = True


def centered_grid(vertices: Array, cell: float, shape: Array) -> Grid:
    """Returns a grid of `shape` (3,) centred on the bounds of the vertices (k, 3) [m]."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    nx, ny, nz = (int(s) for s in shape)
    return Grid(middle - (shape - 1) / 2 * cell, float(cell), (nx, ny, nz))


def grid_fields(
    coarse: Grid,
    values: Array,
    fine: Grid,
    exact: Callable[[Indices, float], tuple[Indices, Array]],
    *,
    sheet: bool,
    blur: float = 0.0,
) -> tuple[GridField, GridField]:
    """Returns the fields on the coarse and on the fine grid.

    `values` (n,): distances at the coarse nodes [m], from which those at fine nodes far from the surface are
    interpolated. `exact(indices, distance)`: returns, of these fine nodes, at least those within that distance [m] of
    the surface, and their signed distances. `sheet`, `blur`: as in `GridField`. For a sheet, size and sign are
    interpolated separately, because the sign jumps where the size does not.
    """
    sharp = _interpolated(coarse, values, fine)
    band = 4 * fine.cell  # nodes nearer to the surface carry exact distances
    if sheet:
        sharp = np.copysign(_interpolated(coarse, np.abs(values), fine), sharp)
    # Near the surface the interpolation errs by a fraction of a coarse cell, so these nodes include the band.
    index, distance = exact(np.flatnonzero(np.abs(sharp) < band + coarse.cell / 2), band)
    sharp[index] = distance
    return coarse.field(values, sheet=sheet, blur=blur), fine.field(sharp, sheet=sheet, blur=blur)


def _interpolated(coarse: Grid, values: Array, fine: Grid) -> Array:
    """Returns values (n,) at every fine node, linear between those at the coarse nodes, which enclose them."""
    start = (fine.origin - coarse.origin) / coarse.cell
    axes = [s + np.arange(n) * (fine.cell / coarse.cell) for s, n in zip(start, fine.shape, strict=True)]
    table = values.reshape(coarse.shape)
    for k, at in enumerate(axes):
        low = np.clip(at.astype(np.int64), 0, coarse.shape[k] - 2)
        share = (at - low).reshape([-1 if j == k else 1 for j in range(3)])
        table = (1 - share) * np.take(table, low, axis=k) + share * np.take(table, low + 1, axis=k)
    return table.reshape(-1)
