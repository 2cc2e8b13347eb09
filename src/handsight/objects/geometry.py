"""The geometry of an object: samples of its surface, distance fields, sizes and errors, whatever it was built from."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from handsight import checks
from handsight.checks import Array, Indices
from handsight.objects.fields import Field, FieldError, Grid, GridField, centered_grid
from handsight.objects.surface import Surface

MOST_SAMPLES = 10**9  # that a caller may draw
SAMPLES = 256  # surface points with which phase 1 of a correction matches contacts
MIN_EXTENT = 0.005  # of an object in a hand; a smaller one has another unit [m]
MAX_EXTENT = 2.0  # and a larger one [m]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Geometry:
    """Object's surface in its own frame: samples, two distance fields, and their errors."""

    coarse: GridField
    """Smooth distance field with cells of an 18th of the diameter; on it descents converge from farther away."""
    fine: Field
    """Sharp distance field: exact for box, cylinder, sphere; else a grid of a quarter of the coarse cell."""
    points_object: Array
    """(256, 3) surface points, evenly spread [m]."""
    normals_object: Array
    """(256, 3) their unit outward normals."""
    area: float
    """Area of the surface [m²]."""
    diameter: float
    """Largest distance between two surface points [m]."""
    bounds_object: Array
    """(2, 3) least and largest coordinates [m]."""
    closed: bool
    """Whether the surface encloses a volume. The distance to an open one is negative behind it, where the nearest point
    is within the surface and not on its rim."""
    sigma_point: float
    """Error of the fine field: one standard deviation of its distance at surface points [m]."""
    sigma_normal: float
    """One standard deviation per axis of the angle from the surface's normals to the fine field's [rad]."""
    field_error: FieldError | None
    """Both errors as a function of place; None where the fine field is exact."""
    remarks: tuple[str, ...]
    """A sentence for each thing that was repaired or is unusual; also issued as `ObjectWarning`."""
    surface: Surface
    """The surface that `sample` draws points from."""

    @property
    def vertices(self) -> Array:
        """(k, 3) of the mesh, or the points of the cloud [m]."""
        return self.surface.vertices

    @property
    def faces(self) -> Indices:
        """(m, 3) vertex indices, counterclockwise seen from outside; (0, 3) for a cloud."""
        return self.surface.faces

    @property
    def radius(self) -> float:
        """Half the diameter [m], by which rotations [rad] are compared with translations [m]."""
        return self.diameter / 2

    @property
    def center_object(self) -> Array:
        """(3,) the middle of the bounds [m]."""
        return np.asarray((self.bounds_object[0] + self.bounds_object[1]) / 2)

    def sample(self, n: int, seed: int = 0) -> tuple[Array, Array]:
        """Returns n random surface points (n, 3) [m], uniform over the area, and their outward normals (n, 3)."""
        return self.surface.draw(checks.integer(n, "n", MOST_SAMPLES, 1), np.random.default_rng(seed))

    @property
    def sample_spacing(self) -> float:
        """√(area / 256): the typical distance between `points_object` [m]."""
        return float(np.sqrt(self.area / SAMPLES))


@dataclass(frozen=True, slots=True, eq=False)
class Roughness:
    """Error of a scanned surface at points of it."""

    points: Array  # (m, 3) on the surface [m]
    variances: Array  # (m, 4) variances, as in `FieldError`
    weights: Array  # (m,) weight of each point in the mean over neighbours


def geometry_of(
    surface: Surface,
    coarse: GridField,
    fine: Field,
    *,
    diameter: float,
    closed: bool = True,
    remarks: tuple[str, ...] = (),
) -> Geometry:
    """Returns the geometry of a surface with these distance fields: its samples, sizes and errors; `diameter` [m]."""
    from handsight._compiled.spreading import snapped, spread_out  # numba's import is long

    vertices = frozen(surface.vertices)
    _ = frozen(surface.faces)
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    # The samples are chosen from twenty times as many random points, each the farthest from those before it, and then
    # moved by twelve of Lloyd's steps, each to the random point nearest to the middle of its own. Distances include
    # normals, so that the two sides of a thin wall are separate.
    n = SAMPLES
    points, normals = surface.draw(20 * n, np.random.default_rng(0))
    features = np.hstack([points, np.sqrt(surface.area / n) * normals])
    chosen = snapped(features, spread_out(features, n, 12))
    _, distance, angle = _errors(surface, fine, 2000, seed=1)  # typical ones, wherever they are
    field_error = None
    if isinstance(fine, GridField):  # at each node of a grid, from the samples of the surface nearest to it
        places, *off = _errors(surface, fine, 8000, seed=2)
        # From mean magnitudes, √(2/π) and √(π/2) of a Gaussian's deviation, because squares would let a few samples at
        # an edge dominate their neighbours.
        lengths = np.stack([off[0] * np.sqrt(np.pi / 2), off[1] * np.sqrt(2 / np.pi)], axis=1)
        grid = centered_grid(vertices, coarse.cell, np.ceil(np.ptp(vertices, axis=0) / coarse.cell) + 2)
        values = np.zeros((*grid.shape, 4))
        values[..., :2] = _mean_of_nearest(places, lengths, grid.nodes()).reshape(*grid.shape, 2) ** 2
        field_error = FieldError(grid.origin, coarse.cell, values)
    return Geometry(
        coarse=coarse,
        fine=fine,
        points_object=frozen(points[chosen]),
        normals_object=frozen(normals[chosen]),
        area=surface.area,
        diameter=diameter,
        bounds_object=frozen(bounds),
        closed=closed,
        # From medians, because edges, which the field rounds off, do not represent the faces: .6745 is the median of
        # |x| for a standard deviation of 1, and 1.1774 that of the length of two such numbers.
        sigma_point=float(np.median(distance) / 0.6745),
        sigma_normal=float(np.median(angle) / 1.1774),
        field_error=field_error,
        remarks=(*remarks, *unit_remarks(float((bounds[1] - bounds[0]).max()))),
        surface=surface,
    )


def roughened(geometry: Geometry, roughness: Roughness) -> Geometry:
    """Returns the geometry with its errors increased by the error of the scanned surface that it was built from."""
    weights = roughness.weights[:, None]
    given = np.hstack([weights * roughness.variances, weights])

    def at(nodes: Array) -> Array:
        mean = _mean_of_nearest(roughness.points, given, nodes)
        return mean[:, :4] / mean[:, 4:]

    point, normal = np.sqrt(np.median(roughness.variances[:, :2], axis=0))
    return replace(
        with_error(geometry, at),
        sigma_point=float(np.hypot(geometry.sigma_point, point)),
        sigma_normal=float(np.hypot(geometry.sigma_normal, normal)),
    )


def with_error(geometry: Geometry, variances_at: Callable[[Array], Array]) -> Geometry:
    """Returns the geometry with its errors increased by variances (n, 4), as in `FieldError`, at places (n, 3)."""
    error = geometry.field_error
    if error is None:
        return geometry
    nodes = Grid(error.origin, error.cell, error.values.shape[:3]).nodes()
    values = error.values + variances_at(nodes).reshape(error.values.shape)
    return replace(geometry, field_error=FieldError(error.origin, error.cell, values))


Number = TypeVar("Number", bound=np.generic)


def frozen(array: NDArray[Number]) -> NDArray[Number]:
    """Returns the same array, made read-only."""
    array.flags.writeable = False
    return array


def _mean_of_nearest(points: Array, values: Array, nodes: Array) -> Array:
    """Returns the mean (n, k) of the values (m, k) at the twelve points (m, 3) nearest to each of the nodes (n, 3)."""
    import numba  # an object from the cache needs neither numba nor scipy
    from scipy.spatial import cKDTree

    threads = numba.config.NUMBA_NUM_THREADS
    near = cKDTree(points).query(nodes, k=min(12, len(points)), workers=threads)[1]
    return np.asarray(values[near].mean(axis=1))


def _errors(surface: Surface, fine: Field, count: int, seed: int) -> tuple[Array, Array, Array]:
    """Returns random surface points (count, 3) [m], and the field's errors there: of distance [m], of normal [rad]."""
    points, normals = surface.draw(count, np.random.default_rng(seed))
    distance, gradient, _ = fine.evaluate(points)
    sine = np.linalg.norm(np.cross(gradient, normals), axis=1)
    return points, np.abs(distance), np.arctan2(sine, (gradient * normals).sum(axis=1))


def unit_remarks(extent: float) -> tuple[str, ...]:
    """Returns a remark where the largest extent [m] suggests another unit than metres."""
    if MIN_EXTENT <= extent <= MAX_EXTENT:
        return ()
    units = {
        "millimetres": 0.001,
        "centimetres": 0.01,
        "inches": 0.0254,
        "metres, stated to be millimetres": 1000,
    }
    for unit, scale in units.items():
        if MIN_EXTENT < extent * scale < MAX_EXTENT / 4:
            return (f"largest extent {extent:.4g} m: looks like {unit}; try scale={scale:g}",)
    return (f"largest extent {extent:.4g} m: not the size of an object in a hand; is the unit right?",)
