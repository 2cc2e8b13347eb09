"""How far a fine field is off the surface it was made of: on the whole, and place by place.

A grid rounds off edges and irons out facets; near a rim its normal may be wrong by tens of degrees where on a face it
is right to one. A contact is only as good as the model where it touches.
"""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.objects.fields.field import Field
from handsight.objects.surface import Surface

TYPICAL_SAMPLES = 2000
SAMPLES, NEIGHBOURS = 8000, 12
"""Surface points compared with the field, and how many of them speak for a place."""
# The median of |x| over a standard deviation, and of the length of a vector of two such.
_MEDIAN_1, _MEDIAN_2 = 0.6745, 1.1774


@dataclass(frozen=True, slots=True, eq=False)
class FieldError:
    """Variances of the fine field's distance and normal, on a grid over the object."""

    origin: Array
    """(3,) the first node [m]."""
    cell: float
    """Spacing of the nodes [m]."""
    values: Array
    """(nx, ny, nz, 2): variance of the distance [m²] and of the normal per axis [rad²]."""


def typical_error(surface: Surface, fine: Field) -> tuple[float, float]:
    """Standard deviations of the fine field on the surface: distance [m] and normal per axis [rad].

    By medians, so that edges, which the field rounds off, do not speak for the faces.
    """
    _, distance, angle = _errors(surface, fine, TYPICAL_SAMPLES, seed=1)
    return float(np.median(distance) / _MEDIAN_1), float(np.median(angle) / _MEDIAN_2)


def field_error(surface: Surface, fine: Field, bounds: Array, cell: float) -> FieldError:
    """The error of a fine field, from samples of the surface within about half a cell [m] of each node."""
    import numba  # an object from the cache needs neither numba nor scipy
    from scipy.spatial import cKDTree

    points, distance, angle = _errors(surface, fine, SAMPLES, seed=2)
    # Mean magnitudes, of a Gaussian's √(2/π) and √(π/2) deviations: a rim's few do not speak for its neighbours.
    lengths = np.stack([distance * np.sqrt(np.pi / 2), angle * np.sqrt(2 / np.pi)], axis=1)
    shape = np.ceil((bounds[1] - bounds[0]) / cell).astype(np.int64) + 2
    origin = bounds.mean(axis=0) - (shape - 1) / 2 * cell
    nodes = origin + cell * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    threads = numba.config.NUMBA_NUM_THREADS
    near = cKDTree(points).query(nodes.reshape(-1, 3), k=NEIGHBOURS, workers=threads)[1]
    return FieldError(origin, cell, (lengths[near].mean(axis=1) ** 2).reshape(*shape, 2))


def _errors(surface: Surface, fine: Field, count: int, seed: int) -> tuple[Array, Array, Array]:
    """Surface points (count, 3) [m], how far the field is off there (count,) [m] and its normals (count,) [rad]."""
    points, normals = surface.draw(count, np.random.default_rng(seed))
    distance, gradient, _ = fine.evaluate(points)
    sine = np.linalg.norm(np.cross(gradient, normals), axis=1)
    return points, np.abs(distance), np.arctan2(sine, (gradient * normals).sum(axis=1))
