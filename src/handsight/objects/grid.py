"""Which grids an object's two fields are sampled on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array

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
