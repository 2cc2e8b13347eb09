"""Which grids an object's two fields are sampled on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from handsight.checks import Array, Indices
from handsight.objects.fields.field import GridField

COARSE_PER_DIAMETER = 18
COARSE_PER_WIDTH = 4
COARSE_MOST_NODES = 400_000
FINE_PER_COARSE = 4
FINE_MARGIN = 8
FINE_MOST_NODES = 4_000_000
BAND = 4
"""Fine nodes within this many cells of the surface carry exact distances."""


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

    def nodes_at(self, index: Indices) -> Array:
        """(n, 3) positions [m] of the nodes with these places in the flat order."""
        return np.asarray(self.origin + self.cell * np.stack(np.unravel_index(index, self.shape), axis=-1))

    def field(self, values: Array) -> GridField:
        """The smooth field of these distances (nx ny nz,) [m] at the nodes."""
        return GridField(self.origin, self.cell, values.reshape(self.shape).astype(np.float32))


def grids(vertices: Array, diameter: float) -> tuple[Grid, Grid, tuple[str, ...]]:
    """The coarse and the fine grid around vertices (k, 3) [m], and a sentence if they had to be coarser."""
    centered = vertices - vertices.mean(axis=0)
    principal = np.linalg.eigh(centered.T @ centered)[1]
    width = min(np.ptp(vertices, axis=0).min(), np.ptp(centered @ principal, axis=0).min())
    coarse, thin = coarse_grid(vertices, diameter, float(width))
    cell = coarse.cell / FINE_PER_COARSE
    fine, capped = _grid(vertices, cell, lambda c: FINE_MARGIN * c, FINE_MOST_NODES)
    if not (thin or capped):
        return coarse, fine, ()
    cells = f"{1000 * coarse.cell:.3g} mm and {1000 * fine.cell:.3g} mm"
    return coarse, fine, (f"very long or thin: its distance fields are coarser than usual, cells of {cells}",)


def coarse_grid(vertices: Array, diameter: float, width: float) -> tuple[Grid, bool]:
    """The grid of the smooth field, and whether it had to be coarser than the object's width asks.

    `diameter`, `width` (the thinnest extent; 0: a sheet) [m]. Half the diameter of margin.
    """
    cell = diameter / COARSE_PER_DIAMETER
    if width > 1e-6 * diameter:
        cell = min(cell, width / COARSE_PER_WIDTH)
    return _grid(vertices, cell, lambda c: max(diameter / 2, 3 * c), COARSE_MOST_NODES)


def _grid(vertices: Array, cell: float, margin: Callable[[float], float], most: int) -> tuple[Grid, bool]:
    enlarged = False
    while True:
        shape = np.ceil((np.ptp(vertices, axis=0) + 2 * margin(cell)) / cell) + 3
        if np.prod(shape) <= most:
            return centered_grid(vertices, cell, shape), enlarged
        cell, enlarged = cell * 1.1, True


def centered_grid(vertices: Array, cell: float, shape: Array) -> Grid:
    """A grid of `shape` (3,) whose middle is that of the vertices (k, 3) [m]."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    nx, ny, nz = (int(s) for s in shape)
    return Grid(middle - (shape - 1) / 2 * cell, float(cell), (nx, ny, nz))


def sharpened(
    coarse: Grid, values: Array, fine: Grid, exact: Callable[[Indices, float], tuple[Indices, Array]]
) -> Array:
    """Distances at every fine node: exact near the surface, elsewhere between the coarse ones, `values` (n,) [m].

    `exact` tells which of these nodes are within a distance [m] of the surface, or more of them, and their distances.
    """
    sharp = _interpolated(coarse, values, fine)
    band = BAND * fine.cell
    # Near the surface the interpolation is off by a fraction of a coarse cell: these are all in the band.
    index, distance = exact(np.flatnonzero(np.abs(sharp) < band + coarse.cell / 2), band)
    sharp[index] = distance
    return sharp


def _interpolated(coarse: Grid, values: Array, fine: Grid) -> Array:
    """Values (n,) at every fine node, linear between the coarse ones, which reach farther."""
    start = (fine.origin - coarse.origin) / coarse.cell
    axes = [s + np.arange(n) * (fine.cell / coarse.cell) for s, n in zip(start, fine.shape, strict=True)]
    table = values.reshape(coarse.shape)
    for k, at in enumerate(axes):
        low = np.clip(at.astype(np.int64), 0, coarse.shape[k] - 2)
        share = (at - low).reshape([-1 if j == k else 1 for j in range(3)])
        table = (1 - share) * np.take(table, low, axis=k) + share * np.take(table, low + 1, axis=k)
    return np.asarray(table.reshape(-1))
