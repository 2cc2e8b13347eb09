"""What is measured on an object's surface, whatever the surface came from."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array, Indices
from handsight.objects.fields.field import Field, GridField
from handsight.objects.fields.field_error import FieldError, field_error, typical_error
from handsight.objects.fields.grids import Fields
from handsight.objects.surface import Surface, spread, unit_remarks

SAMPLES = 256
"""Surface points that phase 1 of the correction matches contacts with."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Geometry:
    """An object's surface in its own frame: samples, two distance fields, and how well these describe it."""

    coarse: GridField
    """Smooth distance field, cells of an 18th of the diameter: from far away it leads further."""
    fine: Field
    """Sharp distance field: exact for box, cylinder, sphere; else a grid of a quarter of the coarse cell."""
    points_object: Array
    """(256, 3) surface points, evenly spread [m]."""
    normals_object: Array
    """(256, 3) their unit outward normals."""
    area: float
    """Of the surface [m²]."""
    diameter: float
    """Largest distance between two surface points [m]."""
    bounds_object: Array
    """(2, 3) least and largest coordinates [m]."""
    closed: bool
    """Whether the surface has an inside; an open one has a distance only, negative behind it near by."""
    sigma_point: float
    """Error of the fine field: one standard deviation of its distance at surface points [m]."""
    sigma_normal: float
    """One standard deviation per axis of the angle from the surface's normals to the fine field's [rad]."""
    field_error: FieldError | None
    """The same place by place; None where the fine field is exact."""
    vertices: Array
    """(k, 3) for drawing [m]; a cloud's points."""
    faces: Indices
    """(m, 3) vertex indices, counterclockwise from outside; none for a cloud."""
    remarks: tuple[str, ...]
    """What was repaired or looks odd, one sentence each; issued as `ObjectWarning` too."""
    surface: Surface
    """What `sample` draws from."""

    @property
    def radius(self) -> float:
        """Half the diameter [m]: what a radian of rotation weighs in metres."""
        return self.diameter / 2

    @property
    def center_object(self) -> Array:
        """(3,) the middle of the bounds [m]."""
        return np.asarray(self.bounds_object.mean(axis=0))

    @property
    def sample_spacing(self) -> float:
        """√(area / 256): about how far apart `points_object` are [m]."""
        return float(np.sqrt(self.area / SAMPLES))


def measured(surface: Surface, fields: Fields) -> Geometry:
    """What is to be known of a surface whose distance fields are these."""
    vertices = surface.vertices
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    points, normals = spread(surface, SAMPLES)
    sigma_point, sigma_normal = typical_error(surface, fields.fine)
    error = None
    if isinstance(fields.fine, GridField):
        error = field_error(surface, fields.fine, bounds, fields.coarse.cell)
    return Geometry(
        coarse=fields.coarse,
        fine=fields.fine,
        points_object=frozen(points),
        normals_object=frozen(normals),
        area=surface.area,
        diameter=fields.diameter,
        bounds_object=frozen(bounds),
        closed=fields.closed,
        sigma_point=sigma_point,
        sigma_normal=sigma_normal,
        field_error=error,
        vertices=frozen(vertices),
        faces=frozen(surface.faces),
        remarks=(*fields.remarks, *unit_remarks(bounds)),
        surface=surface,
    )


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A copy that cannot be written to."""
    array = np.array(array)
    array.flags.writeable = False
    return array
