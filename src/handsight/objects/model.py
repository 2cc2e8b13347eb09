"""An object's surface, in its own frame: samples, two distance fields, symmetries."""

import dataclasses
import os
import warnings
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects import primitives
from handsight.objects.fields.exact import BoxField, CylinderField, SphereField
from handsight.objects.fields.field import Field, FieldValues, GridField
from handsight.objects.fields.field_error import Roughness
from handsight.objects.geometry import LARGEST, SMALLEST, Made, ObjectWarning, measured
from handsight.objects.meshes.triangles import Faces, Rounded, Surface
from handsight.objects.symmetry import Symmetries
from handsight.objects.whole import measured_file

SAMPLES = 256
"""Surface points that phase 1 of the correction matches contacts with."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ObjectModel:
    """One object's surface; made by `box`, `cylinder`, `sphere`, `from_file`, `from_mesh`, `from_points`."""

    name: str
    """What it is called in plots; a file's stem. May be empty."""
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
    symmetries: Symmetries
    """The rotations that leave the surface the same, as far as declared."""
    sigma_point: float
    """Roughness of the fine field: one standard deviation of its distance at surface points [m]."""
    sigma_normal: float
    """One standard deviation per axis of the angle from the surface's normals to the fine field's [rad]."""
    roughness: Roughness | None
    """The same place by place; None where the fine field is exact."""
    vertices: Array
    """(k, 3) for drawing [m]; a cloud's points."""
    faces: Faces
    """(m, 3) vertex indices, counterclockwise from outside; none for a cloud."""
    remarks: tuple[str, ...]
    """What was repaired or looks odd, one sentence each; issued as `ObjectWarning` too."""
    _surface: Surface
    kept: dict[str, Any] = dataclasses.field(init=False, default_factory=dict)
    """What other rooms have computed from this model and will need again."""

    def __repr__(self) -> str:
        """Name, size and kind in a line."""
        size = " × ".join(f"{1000 * side:.3g}" for side in np.ptp(self.bounds_object, axis=0))
        return (
            f"<ObjectModel {self.name or 'without a name'}: {size} mm, {'closed' if self.closed else 'open'}>"
        )

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

    @classmethod
    def box(cls, size: ArrayLike, *, symmetries: Symmetries | None = None) -> Self:
        """A box centred at the origin, sides `size` (3,) [m] along x, y, z; raises InvalidInput."""
        sides = checks.finite(size, "size", (3,))
        if not (sides > 0).all():
            raise InvalidInput(f"size: expected 3 numbers above 0, got {checks.brief(sides)}")
        _check_range(sides, "size")
        triangles = primitives.box_triangles(sides / 2)
        made = Made("box", triangles, triangles.vertices, triangles.faces, BoxField(sides / 2))
        return cls._from(measured(made, SAMPLES), symmetries or primitives.box_symmetries(sides))

    @classmethod
    def cylinder(cls, radius: float, height: float, *, symmetries: Symmetries | None = None) -> Self:
        """A cylinder centred at the origin, axis z, `radius` and `height` [m]; raises InvalidInput."""
        radius, height = checks.positive(radius, "radius"), checks.positive(height, "height")
        _check_range(radius, "radius")
        _check_range(height, "height")
        triangles = primitives.cylinder_triangles(radius, height / 2)
        exact, area = CylinderField(radius, height / 2), 2 * np.pi * radius * (radius + height)
        made = Made("cylinder", Rounded(triangles, exact, area), triangles.vertices, triangles.faces, exact)
        return cls._from(measured(made, SAMPLES), symmetries or primitives.cylinder_symmetries())

    @classmethod
    def sphere(cls, radius: float, *, symmetries: Symmetries | None = None) -> Self:
        """A ball centred at the origin, `radius` [m]; raises InvalidInput."""
        radius = checks.positive(radius, "radius")
        _check_range(radius, "radius")
        triangles, exact = primitives.sphere_triangles(radius), SphereField(radius)
        rounded = Rounded(triangles, exact, 4 * np.pi * radius**2)
        made = Made("sphere", rounded, triangles.vertices, triangles.faces, exact)
        return cls._from(measured(made, SAMPLES), symmetries or primitives.sphere_symmetries())

    @classmethod
    def from_mesh(
        cls, vertices: ArrayLike, faces: ArrayLike, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object whose surface is the triangles `faces` (m, 3) of `vertices` (k, 3) [m].

        Counterclockwise from outside; what is inconsistent or inside out is mended and remarked. An open
        surface is valid. Raises InvalidObject where there is no surface.
        """
        from handsight.objects.build import made_of_mesh  # it brings scipy and trimesh

        return cls._from(measured(made_of_mesh(vertices, faces), SAMPLES), symmetries or Symmetries())

    @classmethod
    def from_points(
        cls, points: ArrayLike, normals: ArrayLike | None = None, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object whose surface the points (n, 3) [m] lie on.

        `normals` (n, 3): outward, of any length; where None, estimated. Outliers are not removed. Raises
        InvalidInput for numbers that are not finite, InvalidObject below 20 different points.
        """
        from handsight.objects.build import made_of_points  # as above

        return cls._from(measured(made_of_points(points, normals), SAMPLES), symmetries or Symmetries())

    @classmethod
    def from_file(
        cls, path: str | os.PathLike[str], scale: float = 1.0, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object in a file: a mesh (STL, OBJ, PLY, OFF) or a cloud (PLY or OFF without faces, PCD, XYZ).

        `scale`: metres per unit of the file. Raises InvalidFile where it cannot be read and InvalidObject
        where it holds no surface, both starting with the file's name.
        """
        scale = checks.positive(scale, "scale")
        return cls._from(measured_file(path, scale, SAMPLES), symmetries or Symmetries())

    @classmethod
    def _from(cls, values: dict[str, Any], symmetries: Symmetries) -> Self:
        _check_symmetries(symmetries)
        for remark in values["remarks"]:
            warnings.warn(remark, ObjectWarning, stacklevel=3)
        return cls(**values, symmetries=symmetries)

    def sample(self, n: int, seed: int = 0) -> tuple[Array, Array]:
        """n surface points (n, 3) [m], uniform over the area, and their outward normals (n, 3)."""
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise InvalidInput(f"n: expected a whole number above 0, got {n!r:.60}")
        return self._surface.draw(int(n), np.random.default_rng(seed))

    def evaluate(self, points_object: ArrayLike, *, fine: bool = True) -> FieldValues:
        """Distance, gradient and Hessian at the points (n, 3) [m]; raises InvalidInput."""
        points = checks.finite(points_object, "points_object", (None, 3))
        from handsight.objects.pack import evaluated, packed_field  # numba's import is long

        name = "fine" if fine else "coarse"
        if name not in self.kept:
            self.kept[name] = packed_field(getattr(self, name), 0)
        return evaluated(self.kept[name], points)

    def with_symmetries(self, symmetries: Symmetries) -> Self:
        """The same object with these symmetries declared."""
        _check_symmetries(symmetries)
        return dataclasses.replace(self, symmetries=symmetries)


def _check_range(value: ArrayLike, name: str) -> None:
    """In other units than any that were meant, squares overflow."""
    if np.min(value) < SMALLEST or np.max(value) > LARGEST:
        expected = f"expected metres between {SMALLEST:g} and {LARGEST:g}"
        raise InvalidInput(f"{name}: {expected}, got {checks.brief(np.asarray(value))}")


def _check_symmetries(symmetries: object) -> None:
    if not isinstance(symmetries, Symmetries):
        raise InvalidInput(f"symmetries: expected Symmetries or None, got {type(symmetries).__name__}")
