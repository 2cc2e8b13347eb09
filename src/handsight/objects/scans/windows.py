"""Quadrics through noisy points, in windows that widen."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._kernels.mesh import quadrics as kernel
from handsight._kernels.mesh.patches import PATCH
from handsight._kernels.runtime.threads import in_parts
from handsight.checks import Array, Indices

Patches = NDArray[np.void]
"""(m,) PATCH."""


class WindowOptions(NamedTuple):
    """`WindowOptions` say how points are gathered in windows."""

    thinned: int = 300  # points to about which a window is thinned: more say little more
    neighbours: int = 8  # points by which the spacing is measured
    sampled: int = 2000  # points at which it is
    max_windows: int = 20  # sizes of windows
    serial: int = 64  # patches that are not enough for another thread


WINDOWS = WindowOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """`Points` are noisy points of a surface in a random order, with their normals or none yet."""

    places: Array
    """(n, 3) [m]."""
    normals: Array
    """(n, 3) unit, outward; NaN where they are not known."""
    spacing: float
    """Between neighbours [m]."""
    diameter: float
    """Of the object [m]."""


@dataclass(frozen=True, slots=True)
class Noise:
    """A `Noise` is what a scan's points are off by, along the surface's normal."""

    sigma: float
    """One standard deviation [m]."""
    together: float = 1.0
    """How many neighbouring points share it: 1 where each has its own."""
    is_shape: bool = False
    """Whether it is what the object's shape leaves over: noise, if there is any, is less."""


def started(places: Array, normals: Array) -> Patches:
    """Returns a patch at each place (m, 3) [m], flat, with the normal (m, 3)."""
    patches = np.zeros(len(places), dtype=PATCH)
    patches["point"], patches["normal"] = places, normals
    least = np.abs(normals).argmin(axis=1)
    a = np.cross(normals, np.eye(3)[least])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    patches["along"][:, 0], patches["along"][:, 1] = a, np.cross(normals, a)
    return patches


def spacing_of(places: Array, least: float = 0.0) -> float:
    """Returns about how far points (n, 3) in a random order are apart [m] along their surface.

    Of as few of them as are `least` [m] apart: closer than their noise is thick they do not tell.
    """
    from scipy.spatial import cKDTree  # an object from the cache needs none

    share = 1.0
    while True:
        some = places[: max(int(share * len(places)), 4 * WINDOWS.neighbours)]
        reach = cKDTree(some).query(some[: WINDOWS.sampled], k=WINDOWS.neighbours + 1)[0][:, -1]
        # A disc holds its neighbours and half the one on its rim.
        spacing = float(np.sqrt(np.median(np.pi * reach**2) / (WINDOWS.neighbours + 0.5)))
        if spacing >= least or len(some) < 8 * WINDOWS.neighbours:
            return spacing * float(np.sqrt(len(some) / len(places)))
        share /= 2


def widths(least: float, most: float, ratio: float) -> Array:
    """Returns radii of windows [m], from the least to the most."""
    count = int(np.log(max(most / least, 1.0)) / np.log(ratio)) + 1
    return np.asarray(least * ratio ** np.arange(max(count - WINDOWS.max_windows, 0), count))


def widened(points: Points, patches: Patches, windows: Array, **level: Any) -> Array:
    """Returns what each window (k,) [m] told of each patch, (m, k, WINDOW_VALUES); fits the patches in place."""
    fitted = np.full((len(patches), len(windows), kernel.WINDOW_VALUES), np.nan)
    for place, window in enumerate(windows):
        given = np.zeros(1, dtype=kernel.LEVEL)
        for name, value in {**level, "window": window, "place": place}.items():
            given[name] = value
        cloud, keys = _in_cells(points, given, patches)
        in_parts(partial(kernel.widen, cloud, keys, given), (patches, fitted), WINDOWS.serial)
    return fitted


def _in_cells(points: Points, level: NDArray[np.void], patches: Patches) -> tuple[Array, Indices]:
    """Returns as many of the points as a window needs, (n, 6) with their normals, in the order of cells as wide as
    it."""
    window = float(level["window"][0])
    share = WINDOWS.thinned / (np.pi * (window / points.spacing) ** 2)
    count = max(int(min(share, 1.0) * len(points.places)), min(len(points.places), WINDOWS.thinned))
    places = points.places[:count]
    low = np.minimum(places.min(axis=0), patches["point"].min(axis=0))
    high = np.maximum(places.max(axis=0), patches["point"].max(axis=0))
    # A ring of empty cells around: no row of them runs into the next.
    level["origin"], level["shape"] = low - 2 * window, np.ceil((high - low) / window) + 5
    cell = ((places - level["origin"]) / window).astype(np.int64)
    keys = np.ravel_multi_index(tuple(cell.T), tuple(level["shape"][0]))
    order = np.argsort(keys, kind="stable")
    return np.hstack([places, points.normals[:count]])[order], keys[order]
