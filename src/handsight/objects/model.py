"""An object that a hand can hold: the geometry of its surface, its symmetries and its weight, in its own frame.

Kernels take it as a record and the nodes of its grids (`handsight._compiled.records`).
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._compiled import records
from handsight.checks import Array
from handsight.errors import InvalidInput, InvalidObject
from handsight.objects import cache, primitives
from handsight.objects.fields import FieldValues
from handsight.objects.files.read import content, shape_of
from handsight.objects.geometry import Geometry
from handsight.objects.surface import MAX_SIZE, MIN_SIZE, ObjectWarning, Triangles
from handsight.objects.symmetry import Symmetries, check_kept, kept_center, nearest
from handsight.objects.symmetry_search import check_symmetries


class ModelRecord(NamedTuple):
    """Object as kernels take it."""

    model: NDArray[np.void]  # (1,) MODEL
    nodes: NDArray[np.float32]  # the nodes of its grids, one grid after another
    symmetry_known: bool
    """Whether kernels can find the object's equivalent poses: where its symmetries are none, finitely many, or one axis
    through the origin. For others `symmetry.nearest` finds them."""


def model_record(geometry: Geometry, symmetries: Symmetries) -> ModelRecord:
    """Returns the record of an object with that geometry and those symmetries."""
    record = np.zeros(1, dtype=records.MODEL)
    row = record[0]
    spacing = geometry.sample_spacing
    diameter = geometry.diameter
    coarse = geometry.coarse.fill(row["coarse"], 0)
    nodes = [coarse, geometry.fine.fill(row["fine"], len(coarse))]
    row["coarse"]["variance_distance"] = (0.03 * geometry.coarse.cell) ** 2  # on faces
    row["coarse"]["variance_normal"] = 0.03**2  # on faces [rad²]
    row["radius"] = geometry.radius
    row["center"] = geometry.center_object
    # Facets are within the surface that they approximate, by at most so much.
    row["bounds"] = geometry.bounds_object + 0.01 * diameter * np.array([[-1.0], [1.0]])
    row["edge_curvature2"] = 1 / (0.75 * geometry.coarse.cell) ** 2  # a surface that is bent more is an edge
    error = row["error"]
    place_by_place = geometry.field_error
    # No model's surface and normals [rad] are assumed to be more exact.
    error["least_distance"] = (1e-4 * diameter) ** 2
    error["least_normal"] = 2e-3**2
    if place_by_place is not None:
        error["inverse_cell"] = 1 / place_by_place.cell
        error["origin"] = place_by_place.origin
        error["shape"] = place_by_place.values.shape[:3]
        error["nodes"] = sum(map(len, nodes))
        nodes.append(place_by_place.values.astype(np.float32).reshape(-1))
    # There is room for `MAX_ROTATIONS`.
    symmetry = row["symmetry"]
    count = len(symmetries.rotations)
    kind = records.NO_SYMMETRY if symmetries.trivial else records.DISCRETE
    for k, (point, direction) in enumerate(symmetries.axes):
        through_origin = np.abs(point - (point @ direction) * direction).max() < 1e-15
        kind = records.AXIS if len(symmetries.axes) == 1 and through_origin else records.OTHER_SYMMETRY
        symmetry["pivot"] = point
        symmetry["axis"][k] = direction
    symmetry["kind"] = kind
    symmetry["axes"] = len(symmetries.axes)
    symmetry["rotations"] = count
    symmetry["rotation"][:count] = symmetries.rotations[:, :3]
    # In the distance of a contact from a sample, a difference of 1 between unit normals counts as much as this length.
    row["normal_weight2"] = (1.3 * diameter) ** 2
    # A tangential distance within the band costs nothing; beyond it, this is its standard deviation.
    row["band"] = 1.6 * spacing
    row["tangential_weight"] = 1 / (0.32 * spacing) ** 2
    row["sample_variance_distance"] = (0.02 * spacing) ** 2  # of the surface about a sample's plane
    row["sample_variance_normal"] = geometry.sigma_normal**2
    row["samples"][:, 0] = geometry.points_object
    row["samples"][:, 1] = geometry.normals_object
    row["scan"][0] = (geometry.points_object**2).sum(axis=1)
    row["scan"][1:4] = geometry.points_object.T
    row["scan"][4:] = geometry.normals_object.T
    return ModelRecord(record, np.concatenate(nodes), kind != records.OTHER_SYMMETRY)


NONE = Symmetries()
SIGMA_FRICTION = 0.1  # standard deviation of a coefficient of friction that is given without one
SHARE_MASS = 0.03  # standard deviation of a mass that is given without one, as a share of it
USUAL_SIGMA = 2e-3  # standard deviation per axis of a centre of mass that is given without one [m]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ObjectModel(Geometry):
    """Geometry of an object's surface, with the object's name, symmetries and weight.

    It is created by `box`, `cylinder`, `sphere`, `from_file`, `from_library`, `from_mesh` or `from_points`.
    """

    name: str
    """The name shown in plots, such as a file's stem; it may be empty."""
    symmetries: Symmetries
    """The declared rotations that leave the surface in place."""
    sigma_scale: float | None = None
    """Standard deviation of its size, as a share, where its scale was measured; None where none is stated."""
    mass: float | None = None
    """[kg]; None where unknown."""
    sigma_mass: float = 0.0
    """Standard deviation of the mass [kg]."""
    center_of_mass: Array | None = None
    """(3,) in the object's frame [m]; None where unknown."""
    sigma_center_of_mass: float = USUAL_SIGMA
    """One standard deviation of the centre of mass per axis [m]."""
    friction: float | None = None
    """Coefficient of friction between fingertips and object; None where it is to be learnt."""
    sigma_friction: float = SIGMA_FRICTION
    """Standard deviation of that coefficient."""

    def __post_init__(self) -> None:
        """Raises InvalidInput where `symmetries` are of another type."""
        if not isinstance(self.symmetries, Symmetries):
            raise InvalidInput(
                f"symmetries: expected Symmetries or None, got {checks.brief(self.symmetries)}"
            )

    def __repr__(self) -> str:
        size = " × ".join(f"{1000 * side:.3g}" for side in np.ptp(self.bounds_object, axis=0))
        kind = "closed" if self.closed else "open"
        return f"<ObjectModel {self.name or 'without a name'}: {size} mm, {kind}>"

    @classmethod
    def box(cls, size: ArrayLike) -> Self:
        """Returns a box centred at the origin, sides `size` (3,) [m] along x, y, z; raises InvalidInput."""
        geometry, own = primitives.box(_lengths(size, "size", (3,)))
        return cls._from(geometry, "box", own)

    @classmethod
    def cylinder(cls, radius: float, height: float) -> Self:
        """Returns a cylinder centred at the origin, axis z, `radius` and `height` [m]; raises InvalidInput."""
        lengths = _length(radius, "radius"), _length(height, "height")
        geometry, own = primitives.cylinder(*lengths)
        return cls._from(geometry, "cylinder", own)

    @classmethod
    def sphere(cls, radius: float) -> Self:
        """Returns a ball centred at the origin, `radius` [m]; raises InvalidInput."""
        geometry, own = primitives.sphere(_length(radius, "radius"))
        return cls._from(geometry, "sphere", own)

    @classmethod
    def from_mesh(cls, vertices: ArrayLike, faces: ArrayLike) -> Self:
        """Returns the object whose surface is the triangles `faces` (m, 3) of `vertices` (k, 3) [m].

        Triangles are counterclockwise as seen from outside; inconsistent or inverted ones are turned over, and an
        `ObjectWarning` says so. An open surface is valid. Raises InvalidObject where there is no surface.
        """
        mesh = _checked_mesh(vertices, faces)
        name = cache.key("mesh", mesh.vertices, mesh.faces)
        return cls._from(cache.remembered(name, lambda: _of_mesh(mesh)), "")

    @classmethod
    def from_points(cls, points: ArrayLike, normals: ArrayLike | None = None) -> Self:
        """Returns the object whose surface goes through the points (n, 3) [m].

        `normals` (n, 3): outward, of any length; None: they are estimated. Outliers are not removed. Raises
        InvalidInput for numbers that are not finite, InvalidObject for fewer than 20 different points.
        """
        places, directions = _checked_points(points, normals)
        name = cache.key("cloud", places, np.empty((0, 3)) if directions is None else directions)
        return cls._from(cache.remembered(name, lambda: _of_points(places, directions)), "")

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], scale: float = 1.0) -> Self:
        """Returns the object in a file: a mesh or a cloud.

        Meshes are STL, OBJ, PLY, OFF and GLB, with the extra `meshes` DAE and 3MF; clouds are PLY and OFF without
        faces, and XYZ. `scale`: metres per unit of the file; GLB, DAE and 3MF state their unit, and come in metres.
        Raises InvalidFile where it cannot be read, InvalidObject where it holds no surface, MissingExtra; all start
        with the file's name.
        """
        scale = checks.positive(scale, "scale")
        file = Path(path)
        data = content(path)

        def build() -> Geometry:
            """Returns the geometry of the mesh or cloud in the file; its remarks begin with the file's name."""
            shape = shape_of(file, data)
            with np.errstate(over="ignore"):  # coordinates that are too large are refused below
                points = scale * shape.vertices
            try:
                if shape.faces is not None:
                    geometry = _of_mesh(_checked_mesh(points, shape.faces))
                else:
                    geometry = _of_points(*_checked_points(points, shape.normals))
                    if shape.sigmas is not None:
                        from handsight.objects.scans.scan import with_declared_noise

                        geometry = with_declared_noise(geometry, points, scale * shape.sigmas)
            except (InvalidObject, InvalidInput) as error:
                raise InvalidObject(f"{file.name}: {error}") from None
            remarks = tuple(f"{file.name}: {remark}" for remark in (*shape.remarks, *geometry.remarks))
            return dataclasses.replace(geometry, remarks=remarks)

        # The file's name is part of the key: remarks begin with it, and its extension selects the reader.
        name = cache.key(f"file {scale!r} {file.name}", np.frombuffer(data, dtype=np.uint8))
        return cls._from(cache.remembered(name, build), file.stem)

    @classmethod
    def from_library(cls, name: str, library: str | os.PathLike[str] | None = None) -> ObjectModel:
        """Returns the object with that name in a library, with the symmetries and the weight declared there.

        `library`: a folder or a URL; None: `$HANDSIGHT_LIBRARY`, else the user's own. Raises InvalidInput for an
        unknown name, InvalidFile where there is no library or the object's file is not the one that was added.
        """
        # At the top of the file this would be a circular import: a library builds models.
        from handsight.objects.library import Library

        return Library(library).model(name)

    @classmethod
    def _from(cls, geometry: Geometry, name: str, symmetries: Symmetries = NONE) -> Self:
        """Returns a model with these symmetries, and issues the geometry's remarks as warnings."""
        parts = {part.name: getattr(geometry, part.name) for part in dataclasses.fields(geometry)}
        for remark in geometry.remarks:
            warnings.warn(remark, ObjectWarning, stacklevel=3)
        return cls(**parts, name=name, symmetries=symmetries)

    def evaluate(self, points_object: ArrayLike, *, fine: bool = True) -> FieldValues:
        """Returns distance, gradient and Hessian at the points (n, 3) [m]; raises InvalidInput. `fine`: from the sharp
        distance field; False: from the smooth, coarse one."""
        points = checks.finite(points_object, "points_object", (None, 3))
        return (self.fine if fine else self.coarse).evaluate(points)

    @cached_property
    def record(self) -> ModelRecord:
        """The object as the record and the grid nodes that kernels take."""
        return model_record(self, self.symmetries)

    def nearest(self, T: Array, T_reference: Array) -> Array:
        """Returns, of the poses that symmetry makes equivalent to `T` (..., 4, 4), those nearest to a reference (4, 4).

        The answer is that of `symmetry.nearest`; a kernel computes it, faster, where it knows the kind of symmetry.
        """
        if self.symmetries.trivial:
            return T
        if not self.record.symmetry_known:
            return nearest(self.symmetries, T, T_reference, self.radius)
        from handsight._compiled.symmetry import equivalent  # numba's import is long

        Ts = np.array(T).reshape(-1, 4, 4)
        out = np.empty_like(Ts)
        equivalent(self.record.model, Ts, np.array(T_reference), out)
        return out.reshape(np.shape(T))

    def with_symmetries(self, symmetries: Symmetries) -> Self:
        """Returns the same object with these symmetries declared; raises InvalidInput where they move its surface.

        They move it where more than 2 % of its points end farther from it than 4 % of the diameter.
        """
        found = dataclasses.replace(self, symmetries=symmetries)
        check_symmetries(self, symmetries)
        return found

    def with_weight(
        self,
        *,
        mass: float | None = None,
        sigma_mass: float | None = None,
        center_of_mass: ArrayLike | None = None,
        sigma_center_of_mass: float | None = None,
    ) -> Self:
        """Returns the same object with this mass [kg] and this centre of mass (3,) [m]; None means unknown.

        `sigma_mass`: standard deviation of the mass [kg]; None: 3 % of it. `sigma_center_of_mass`: standard deviation
        of the centre of mass per axis [m]. Raises InvalidInput, also for a centre that the declared symmetries would
        move: an object that is heavier on one side is not symmetric to a hand that weighs it.
        """
        sigma = USUAL_SIGMA if sigma_center_of_mass is None else sigma_center_of_mass
        checks.sigma(sigma, "sigma_center_of_mass")
        center = None
        if center_of_mass is not None:
            given = checks.in_reach(center_of_mass, "center_of_mass", (3,))
            center = kept_center(self.symmetries, given)
            check_kept(center, given, 2 * sigma, "center_of_mass")
        sigma_weight = 0.0
        if mass is not None:
            mass = checks.positive(mass, "mass")
            usual = SHARE_MASS * mass
            sigma_weight = usual if sigma_mass is None else checks.positive(sigma_mass, "sigma_mass")
        return dataclasses.replace(
            self, mass=mass, sigma_mass=sigma_weight, center_of_mass=center, sigma_center_of_mass=sigma
        )

    def with_friction(self, friction: float | None, sigma: float = SIGMA_FRICTION) -> Self:
        """Returns the object with that coefficient of friction and sigma; None: to be learnt. Raises InvalidInput."""
        check_friction(friction, sigma, "friction")
        return dataclasses.replace(self, friction=friction, sigma_friction=sigma)

    @property
    def volume_centroid(self) -> Array:
        """(3,) the centroid of the volume: the centre of mass of a homogeneous object [m]. Raises InvalidObject for an
        open surface or a cloud."""
        if not self.closed or not isinstance(self.surface, Triangles):
            raise InvalidObject("object: expected a closed mesh for its volume's centroid, got none")
        return self.surface.volume_centroid


def check_friction(friction: float | None, sigma: float, name: str) -> None:
    """Raises InvalidInput for a coefficient of friction, or its standard deviation, that no two materials have."""
    for what, value, least in ((name, friction, 0.01), (f"sigma_{name}", sigma, 1e-4)):
        if value is not None and not least <= checks.finite(value, what, ()) <= 10:
            raise InvalidInput(f"{what}: expected a number from {least:g} to 10, got {value:g}")


def _lengths(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns lengths [m] of a shape; raises InvalidInput where no mistaken unit explains how small or large one is."""
    lengths = checks.finite(value, name, shape)
    if lengths.min() < MIN_SIZE or lengths.max() > MAX_SIZE:
        came = checks.brief(lengths)
        raise InvalidInput(f"{name}: expected metres between {MIN_SIZE:g} and {MAX_SIZE:g}, got {came}")
    return lengths


def _length(value: ArrayLike, name: str) -> float:
    return float(_lengths(value, name, ()))


def _of_mesh(mesh: Triangles) -> Geometry:
    # An object from the cache does not need SciPy, which this imports.
    from handsight.objects.meshes.mesh_geometry import mesh_geometry

    return mesh_geometry(mesh)


def _of_points(points: Array, normals: Array | None) -> Geometry:
    from handsight.objects.cloud import cloud_geometry

    return cloud_geometry(points, normals)


def _checked_points(points: ArrayLike, normals: ArrayLike | None) -> tuple[Array, Array | None]:
    places = checks.finite(points, "points", (None, 3))
    return places, None if normals is None else checks.unit(normals, "normals", (len(places), 3))


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> Triangles:
    """Returns the mesh of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject for other arrays."""
    vertices = checks.unmasked(vertices, "vertices") if isinstance(vertices, np.ndarray) else vertices
    try:
        points = np.asarray(vertices, dtype=np.float64)
        triangles = np.asarray(faces)
    except (TypeError, ValueError):
        raise InvalidObject("mesh: expected numbers for vertices (k, 3) and faces (m, 3)") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InvalidObject(f"vertices: expected shape (k, 3) with k ≥ 3, got {points.shape}")
    if triangles.size == 0:
        raise InvalidObject("faces: expected at least one triangle, got none")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InvalidObject(
            f"faces: expected whole numbers of shape (m, 3), got {triangles.dtype} {triangles.shape}"
        )
    last = len(points) - 1
    if triangles.min() < 0 or triangles.max() > last:
        came = f"{triangles.min()} to {triangles.max()}"
        raise InvalidObject(f"faces: expected indices 0 to {last}, got {came}")
    return Triangles(points, triangles.astype(np.int64))
