"""What every object model measures on its surface, whatever the surface came from."""

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.objects.fields.field import Field, GridField
from handsight.objects.fields.field_error import roughness
from handsight.objects.fields.grids import coarse_grid
from handsight.objects.meshes.triangles import Faces, Surface, spread

SMALLEST, LARGEST = 1e-6, 1e6
"""Sizes outside these [m] are refused."""
SMALL, LARGE = 0.005, 2.0
"""A hand-held object's largest extent lies between these [m]; beyond them the unit is suspect."""
ROUGHNESS_SAMPLES = 2000
MOST_COMPARED = 2000
"""Points whose distances are all taken."""
# The median of |x| over a standard deviation, and of the length of a vector of two such.
_MEDIAN_1, _MEDIAN_2 = 0.6745, 1.1774


def check_extent(points: Array, name: str) -> float:
    """The largest extent [m] of points (n, 3) along an axis; raises InvalidObject where it is no size."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(points, axis=0).max())
    if extent == 0:
        raise InvalidObject(f"{name}: expected an object with a size, got all points in one place")
    if not SMALLEST <= extent <= LARGEST or np.abs(points).max() > LARGEST:
        raise InvalidObject(f"{name}: expected a size of {SMALLEST:g} to {LARGEST:g} m, got {extent:.4g}")
    return extent


class ObjectWarning(UserWarning):
    """Something about an object was repaired, or looks odd."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A surface and its fields, before anything is measured on it."""

    name: str
    surface: Surface
    vertices: Array
    """(k, 3) [m]."""
    faces: Faces
    """(m, 3)"""
    fine: Field
    coarse: GridField | None = None
    """None: sampled from the fine field."""
    closed: bool = True
    remarks: tuple[str, ...] = ()
    diameter: float | None = None
    """[m], where it is known already."""


def measured(made: Made, samples: int) -> dict[str, Any]:
    """Every field of an ObjectModel but its symmetries."""
    bounds = np.stack([made.vertices.min(axis=0), made.vertices.max(axis=0)])
    size = made.diameter or diameter(made.vertices)
    points, normals = spread(made.surface, samples)
    sigma_point, sigma_normal = typical_roughness(made.surface, made.fine)
    coarse = made.coarse or sampled(made.fine, bounds, size)
    return {
        "name": made.name,
        "coarse": coarse,
        "fine": made.fine,
        "points_object": frozen(points),
        "normals_object": frozen(normals),
        "area": made.surface.area,
        "diameter": size,
        "bounds_object": frozen(bounds),
        "closed": made.closed,
        "sigma_point": sigma_point,
        "sigma_normal": sigma_normal,
        "roughness": roughness(made.surface, made.fine, bounds, coarse.cell) if made.coarse else None,
        "vertices": frozen(made.vertices),
        "faces": made.faces,
        "remarks": (*made.remarks, *unit_remarks(bounds)),
        "_surface": made.surface,
    }


def frozen(array: Array) -> Array:
    """A copy that cannot be written to."""
    array = np.array(array)
    array.flags.writeable = False
    return array


def sampled(exact: Field, bounds: Array, size: float) -> GridField:
    """The coarse field of an object whose exact one is known."""
    grid, _ = coarse_grid(bounds, size, float((bounds[1] - bounds[0]).min()))
    distance = exact.evaluate(grid.nodes()).distance
    return GridField(grid.origin, grid.cell, distance.reshape(grid.shape).astype(np.float32))


def diameter(points: Array) -> float:
    """The largest distance between two of the points (n, 3) [m]."""
    from scipy.spatial import ConvexHull, QhullError  # an object that is kept whole needs no scipy
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


def typical_roughness(surface: Surface, fine: Field) -> tuple[float, float]:
    """Standard deviations of the fine field on the surface: distance [m] and normal per axis [rad].

    By medians, so that edges, which the field rounds off, do not speak for the faces.
    """
    from handsight.objects.pack import looked_up  # numba's import is long

    points, normals = surface.draw(ROUGHNESS_SAMPLES, np.random.default_rng(1))
    distance, gradient, _ = looked_up(fine, points)
    sine = np.linalg.norm(np.cross(gradient, normals), axis=1)
    angle = np.arctan2(sine, (gradient * normals).sum(axis=1))
    return float(np.median(np.abs(distance)) / _MEDIAN_1), float(np.median(angle) / _MEDIAN_2)


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
