"""Surfaces, whatever they are made of: points drawn from them and spread over them, and how large they are."""

import contextlib
from typing import Protocol

import numpy as np

from handsight.checks import Array, Indices
from handsight.errors import InvalidObject

SMALLEST, LARGEST = 1e-6, 1e6
"""Sizes outside these [m] are refused."""
SMALL, LARGE = 0.005, 2.0
"""A hand-held object's largest extent lies between these [m]; beyond them the unit is suspect."""
LLOYD_STEPS = 12
CROWD = 20
"""Points drawn for each that is kept."""
MOST_COMPARED = 2000
"""Points whose distances are all taken."""
_SAME_POINT = 1e-9
"""Points closer than this part of the extent are one."""


class ObjectWarning(UserWarning):
    """Something about an object was repaired, or looks odd."""


class Surface(Protocol):
    """Something with an area from which points can be drawn."""

    @property
    def vertices(self) -> Array:
        """(k, 3) points that bound it [m]."""
        ...

    @property
    def faces(self) -> Indices:
        """(m, 3) vertex indices of triangles, counterclockwise from outside; none of a cloud."""
        ...

    @property
    def area(self) -> float:
        """Total [m²]."""
        ...

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """n points (n, 3) [m], uniform over the area, and their unit outward normals (n, 3)."""
        ...


def spread(surface: Surface, n: int, seed: int = 0) -> tuple[Array, Array]:
    """n points (n, 3) [m] with normals (n, 3), evenly apart and each for about the same area.

    The farthest of many draws, one after another, then Lloyd's steps, in which each point moves to the middle
    of those it stands for. Normals count too, so that the two sides of a thin wall are kept apart.
    """
    from handsight._kernels.spreading import snapped, spread_out  # numba's import is long

    points, normals = surface.draw(CROWD * n, np.random.default_rng(seed))
    features = np.hstack([points, np.sqrt(surface.area / n) * normals])
    # Back to draws, each once: a middle lies off a curved surface.
    index = snapped(features, spread_out(features, n, LLOYD_STEPS))
    return points[index], normals[index]


def drawn_by_area(areas: Array, n: int, rng: np.random.Generator) -> Indices:
    """n indices (n,) of parts, each as often as its share of the `areas` (m,)."""
    # One draw per n-th of the area spreads better than n free draws, and is as uniform.
    at = (np.arange(n) + rng.random(n)) / max(n, 1)
    return np.asarray(np.searchsorted(np.cumsum(areas) / areas.sum(), at).clip(max=len(areas) - 1))


def check_extent(points: Array, name: str) -> float:
    """The largest extent [m] of points (n, 3) along an axis; raises InvalidObject where it is no size."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(points, axis=0).max())
    if extent == 0:
        raise InvalidObject(f"{name}: expected an object with a size, got all points in one place")
    if not SMALLEST <= extent <= LARGEST or np.abs(points).max() > LARGEST:
        raise InvalidObject(f"{name}: expected a size of {SMALLEST:g} to {LARGEST:g} m, got {extent:.4g}")
    return extent


def distinct(points: Array, extent: float) -> tuple[Indices, Indices]:
    """Which (k,) of the points (n, 3) differ, in the order they came, and which (n,) of those each one is."""
    keys = np.round((points - points.min(axis=0)) / (_SAME_POINT * extent)).astype(np.int64)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.sort(first), rank[which.reshape(-1)]


def diameter(points: Array) -> float:
    """The largest distance between two of the points (n, 3) [m]."""
    from scipy.spatial import ConvexHull, QhullError  # an object from the cache needs no scipy
    from scipy.spatial.distance import pdist

    points = _outermost(points)
    if len(points) > MOST_COMPARED:
        with contextlib.suppress(QhullError):  # flat
            points = points[ConvexHull(points).vertices]
    if len(points) > MOST_COMPARED:  # a ball: extremes along many directions miss by less than a thousandth
        direction = np.random.default_rng(0).normal(size=(1000, 3))
        along = (direction / np.linalg.norm(direction, axis=1, keepdims=True)) @ points.T
        points = points[np.unique(np.concatenate([along.argmin(axis=1), along.argmax(axis=1)]))]
    return float(pdist(points).max())


def _outermost(points: Array) -> Array:
    """Those of the points (n, 3) that may be one of the two farthest apart: of most objects a few."""
    one = points[((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax()]
    for _ in range(3):
        other = one
        one = points[((points - other) ** 2).sum(axis=1).argmax()]
    least = float(np.linalg.norm(one - other))
    # Two that are farther apart than these are together at least as far from the middle between these.
    gap = np.linalg.norm(points - (one + other) / 2, axis=1)
    return np.asarray(points[gap >= (1 - 1e-9) * least - gap.max()])


def unit_remarks(bounds: Array) -> tuple[str, ...]:
    """A sentence if the size suggests another unit than metres."""
    extent = float((bounds[1] - bounds[0]).max())
    if SMALL <= extent <= LARGE:
        return ()
    for unit, scale in (
        ("millimetres", 0.001),
        ("centimetres", 0.01),
        ("inches", 0.0254),
        ("metres, scaled down twice", 1000.0),
    ):
        if SMALL < extent * scale < LARGE / 4:
            return (f"largest extent {extent:.4g} m: looks like {unit}; try scale={scale:g}",)
    return (f"largest extent {extent:.4g} m: not the size of an object in a hand; is the unit right?",)
