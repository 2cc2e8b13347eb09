"""An object's surface, in its own frame: samples, two distance fields, symmetries."""

import dataclasses
import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects import build, primitives
from handsight.objects.fields.field import FieldValues
from handsight.objects.geometry import Geometry
from handsight.objects.surface import LARGEST, SMALLEST, ObjectWarning
from handsight.objects.symmetry import Symmetries

if TYPE_CHECKING:
    from handsight.objects.record import ModelRecord


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ObjectModel(Geometry):
    """One object's surface; made by `box`, `cylinder`, `sphere`, `from_file`, `from_mesh`, `from_points`."""

    name: str
    """What it is called in plots; a file's stem. May be empty."""
    symmetries: Symmetries
    """The rotations that leave the surface the same, as far as declared."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for symmetries that are none."""
        if not isinstance(self.symmetries, Symmetries):
            came = type(self.symmetries).__name__
            raise InvalidInput(f"symmetries: expected Symmetries or None, got {came}")

    def __repr__(self) -> str:
        """Name, size and kind in a line."""
        size = " × ".join(f"{1000 * side:.3g}" for side in np.ptp(self.bounds_object, axis=0))
        return (
            f"<ObjectModel {self.name or 'without a name'}: {size} mm, {'closed' if self.closed else 'open'}>"
        )

    @classmethod
    def box(cls, size: ArrayLike, *, symmetries: Symmetries | None = None) -> Self:
        """A box centred at the origin, sides `size` (3,) [m] along x, y, z; raises InvalidInput."""
        sides = checks.finite(size, "size", (3,))
        if not (sides > 0).all():
            raise InvalidInput(f"size: expected 3 numbers above 0, got {checks.brief(sides)}")
        _check_range(sides, "size")
        return cls._from(primitives.box(sides / 2), "box", symmetries or primitives.box_symmetries(sides))

    @classmethod
    def cylinder(cls, radius: float, height: float, *, symmetries: Symmetries | None = None) -> Self:
        """A cylinder centred at the origin, axis z, `radius` and `height` [m]; raises InvalidInput."""
        radius, height = _length(radius, "radius"), _length(height, "height")
        shape = primitives.cylinder(radius, height / 2)
        return cls._from(shape, "cylinder", symmetries or primitives.cylinder_symmetries())

    @classmethod
    def sphere(cls, radius: float, *, symmetries: Symmetries | None = None) -> Self:
        """A ball centred at the origin, `radius` [m]; raises InvalidInput."""
        radius = _length(radius, "radius")
        return cls._from(primitives.sphere(radius), "sphere", symmetries or primitives.sphere_symmetries())

    @classmethod
    def from_mesh(
        cls, vertices: ArrayLike, faces: ArrayLike, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object whose surface is the triangles `faces` (m, 3) of `vertices` (k, 3) [m].

        Counterclockwise from outside; what is inconsistent or inside out is mended and remarked. An open
        surface is valid. Raises InvalidObject where there is no surface.
        """
        return cls._from(build.of_mesh(vertices, faces), "", symmetries or Symmetries())

    @classmethod
    def from_points(
        cls, points: ArrayLike, normals: ArrayLike | None = None, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object whose surface the points (n, 3) [m] lie on.

        `normals` (n, 3): outward, of any length; where None, estimated. Outliers are not removed. Raises
        InvalidInput for numbers that are not finite, InvalidObject below 20 different points.
        """
        return cls._from(build.of_points(points, normals), "", symmetries or Symmetries())

    @classmethod
    def from_file(
        cls, path: str | os.PathLike[str], scale: float = 1.0, *, symmetries: Symmetries | None = None
    ) -> Self:
        """The object in a file: a mesh (STL, OBJ, PLY, OFF) or a cloud (PLY or OFF without faces, PCD, XYZ).

        `scale`: metres per unit of the file. Raises InvalidFile where it cannot be read and InvalidObject
        where it holds no surface, both starting with the file's name.
        """
        scale = checks.positive(scale, "scale")
        return cls._from(build.of_file(path, scale), Path(path).stem, symmetries or Symmetries())

    @classmethod
    def _from(cls, geometry: Geometry, name: str, symmetries: Symmetries) -> Self:
        measured = {part.name: getattr(geometry, part.name) for part in dataclasses.fields(geometry)}
        model = cls(**measured, name=name, symmetries=symmetries)
        for remark in geometry.remarks:
            warnings.warn(remark, ObjectWarning, stacklevel=3)
        return model

    def sample(self, n: int, seed: int = 0) -> tuple[Array, Array]:
        """n surface points (n, 3) [m], uniform over the area, and their outward normals (n, 3)."""
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise InvalidInput(f"n: expected a whole number above 0, got {n!r:.60}")
        return self.surface.draw(int(n), np.random.default_rng(seed))

    def evaluate(self, points_object: ArrayLike, *, fine: bool = True) -> FieldValues:
        """Distance, gradient and Hessian at the points (n, 3) [m]; raises InvalidInput."""
        points = checks.finite(points_object, "points_object", (None, 3))
        return (self.fine if fine else self.coarse).evaluate(points)

    @cached_property
    def record(self) -> "ModelRecord":
        """The same as kernels take it."""
        from handsight.objects.record import model_record  # numba's import is long

        return model_record(self)

    def with_symmetries(self, symmetries: Symmetries) -> Self:
        """The same object with these symmetries declared."""
        return dataclasses.replace(self, symmetries=symmetries)


def _length(value: float, name: str) -> float:
    length = checks.positive(value, name)
    _check_range(length, name)
    return length


def _check_range(value: ArrayLike, name: str) -> None:
    """In other units than any that were meant, squares overflow."""
    if np.min(value) < SMALLEST or np.max(value) > LARGEST:
        expected = f"expected metres between {SMALLEST:g} and {LARGEST:g}"
        raise InvalidInput(f"{name}: {expected}, got {checks.brief(np.asarray(value))}")
