"""Which grids an object's two fields are sampled on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.objects.fields.field import Field, GridField

COARSE_PER_DIAMETER = 18
COARSE_PER_WIDTH = 4
COARSE_MOST_NODES = 400_000
FINE_PER_COARSE = 4
FINE_MARGIN = 8
FINE_MOST_NODES = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A regular grid of nodes."""

    origin: Array
    """(3,) node (0, 0, 0) [m]."""
    cell: float
    """Between neighbours [m]."""
    shape: tuple[int, int, int]

    def nodes(self) -> Array:
        """(nx ny nz, 3) positions [m], z fastest."""
        return self.nodes_at(np.arange(int(np.prod(self.shape))))

    def nodes_at(self, index: NDArray[np.int64]) -> Array:
        """(n, 3) positions [m] of the nodes with these places in the flat order."""
        return np.asarray(self.origin + self.cell * np.stack(np.unravel_index(index, self.shape), axis=-1))

    def field(self, values: Array) -> GridField:
        """The smooth field of these distances (nx ny nz,) [m] at the nodes."""
        return GridField(self.origin, self.cell, values.reshape(self.shape).astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Both distance fields of a surface."""

    coarse: GridField
    fine: Field
    diameter: float
    """The largest distance between two points of the surface [m]."""
    closed: bool = True
    """Whether the surface has an inside."""
    remarks: tuple[str, ...] = ()


def grids(vertices: Array, diameter: float) -> tuple[Grid, Grid, tuple[str, ...]]:
    """The coarse and the fine grid around vertices (k, 3) [m], and a sentence if they had to be coarser."""
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    coarse, thin = coarse_grid(bounds, diameter, thinnest(vertices))
    fine, capped = fine_grid(bounds, coarse.cell)
    if not (thin or capped):
        return coarse, fine, ()
    cells = f"{1000 * coarse.cell:.3g} mm and {1000 * fine.cell:.3g} mm"
    return coarse, fine, (f"very long or thin: its distance fields are coarser than usual, cells of {cells}",)


def sampled(exact: Field, bounds: Array, diameter: float) -> GridField:
    """The coarse field of an object whose exact one is known; `bounds` (2, 3), `diameter` [m]."""
    grid, _ = coarse_grid(bounds, diameter, float((bounds[1] - bounds[0]).min()))
    return grid.field(exact.evaluate(grid.nodes()).distance)


def thinnest(vertices: Array) -> float:
    """The least extent [m] along the object's own axes or the principal ones; a sheet has about 0."""
    centered = vertices - vertices.mean(axis=0)
    principal = np.linalg.eigh(centered.T @ centered)[1]
    return float(min(np.ptp(vertices, axis=0).min(), np.ptp(centered @ principal, axis=0).min()))


def interpolated(coarse: Grid, values: Array, fine: Grid) -> Array:
    """Values (n,) at every fine node, linear between the coarse ones, which reach farther."""
    start = (fine.origin - coarse.origin) / coarse.cell
    axes = [s + np.arange(n) * (fine.cell / coarse.cell) for s, n in zip(start, fine.shape, strict=True)]
    table = values.reshape(coarse.shape)
    for k, at in enumerate(axes):
        low = np.clip(at.astype(np.int64), 0, coarse.shape[k] - 2)
        share = (at - low).reshape([-1 if j == k else 1 for j in range(3)])
        table = (1 - share) * np.take(table, low, axis=k) + share * np.take(table, low + 1, axis=k)
    return np.asarray(table.reshape(-1))


def coarse_grid(bounds: Array, diameter: float, width: float) -> tuple[Grid, bool]:
    """The grid of the smooth field, and whether it had to be coarser than the object's width asks.

    `bounds` (2, 3), `diameter`, `width` (the thinnest extent; 0: a sheet) [m]. Half the diameter of margin.
    """
    cell = diameter / COARSE_PER_DIAMETER
    if width > 1e-6 * diameter:
        cell = min(cell, width / COARSE_PER_WIDTH)
    return _grid(bounds, cell, lambda c: max(diameter / 2, 3 * c), COARSE_MOST_NODES)


def fine_grid(bounds: Array, coarse_cell: float) -> tuple[Grid, bool]:
    """The grid of the sharp field, and whether it had to be coarser than a quarter of the coarse one."""
    return _grid(bounds, coarse_cell / FINE_PER_COARSE, lambda c: FINE_MARGIN * c, FINE_MOST_NODES)


def _grid(bounds: Array, cell: float, margin: Callable[[float], float], most: int) -> tuple[Grid, bool]:
    enlarged = False
    while True:
        extent = bounds[1] - bounds[0] + 2 * margin(cell)
        shape = np.ceil(extent / cell).astype(np.int64) + 3
        if np.prod(shape.astype(float)) <= most:
            break
        cell, enlarged = cell * 1.1, True
    origin = bounds.mean(axis=0) - (shape - 1) / 2 * cell
    nx, ny, nz = (int(s) for s in shape)
    return Grid(origin, float(cell), (nx, ny, nz)), enlarged
