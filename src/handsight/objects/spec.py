"""An object as a rig file or a problem specifies it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from handsight import checks
from handsight.errors import InvalidInput
from handsight.objects.library import Library, NoLibrary
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry_search import propose_symmetries


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectSpec:
    """One of box, cylinder, mesh and name, and the declared weight and friction of the object."""

    box: tuple[float, float, float] | None = None
    """Sides [m]."""
    cylinder: tuple[float, float] | None = None
    """Radius and height [m]."""
    mesh: Path | None = None
    """File of a mesh or a point cloud."""
    scale: float = 1.0
    """Metres per unit of that file."""
    name: str | None = None
    """Name in the library, as `Library.model` takes it."""
    symmetries: Literal["find"] | None = None
    """`find`: rotations that keep the shape are symmetries (`propose_symmetries`), even if a print tells them apart."""
    mass: float | None = None
    """Mass [kg]; it replaces that of an object in the library."""
    sigma_mass: float | None = None
    """Standard deviation of the mass [kg]; None: 3 % of it."""
    center_of_mass: tuple[float, float, float] | Literal["homogeneous"] | None = None
    """Centre of mass in the object's frame [m]; `homogeneous`: the centroid of its volume."""
    sigma_center_of_mass: float | None = None
    """Standard deviation of the centre of mass per axis [m]."""
    friction: float | None = None
    """Coefficient of friction between fingertips and object."""
    sigma_friction: float | None = None
    """Standard deviation of that coefficient."""
    label: str | None = None
    """What a detector calls it (`class_id`), or its number in mask images; None: its name."""

    def model(self) -> ObjectModel:
        """Returns the object with its weight; raises a HandsightError."""
        if self.box is not None:
            model = ObjectModel.box(self.box)
        elif self.cylinder is not None:
            model = ObjectModel.cylinder(*self.cylinder)
        elif self.name is not None:
            model = Library().model(self.name)
        elif self.mesh is not None:
            model = ObjectModel.from_file(self.mesh, scale=self.scale)
        else:
            raise InvalidInput("object: expected one of box, cylinder, mesh, name, got none")
        if self.symmetries is not None:
            model = model.with_symmetries(propose_symmetries(model))
        if self.friction is not None:
            sigma_friction = model.sigma_friction if self.sigma_friction is None else self.sigma_friction
            model = model.with_friction(self.friction, sigma_friction)
        if self.mass is None and self.center_of_mass is None:
            return model
        center = model.volume_centroid if self.center_of_mass == "homogeneous" else self.center_of_mass
        sigma = self.sigma_center_of_mass
        if center is None:
            center = model.center_of_mass
            sigma = model.sigma_center_of_mass
        mass = self.mass
        sigma_mass = self.sigma_mass
        if mass is None:
            mass = model.mass
            sigma_mass = model.sigma_mass or None
        return model.with_weight(
            mass=mass, sigma_mass=sigma_mass, center_of_mass=center, sigma_center_of_mass=sigma
        )


def find_model(
    name: str,
    objects: Mapping[str, ObjectSpec],
    place: str,
    *,
    library: Library,
    scale: float = 1.0,
    argument: str = "object",
) -> ObjectModel:
    """Returns the model of a rig's object of that name, else of the mesh file at that path, else of a library's object.

    `objects`: the rig's, by name; `place`: what a message calls the rig, empty where there is none; `scale`: metres per
    unit of the mesh file. Raises InvalidInput with `argument` in front where there is no such object, and the errors of
    reading the one that was found.
    """
    if name in objects:
        return replace(objects[name].model(), name=name)
    if Path(name).is_file():
        return ObjectModel.from_file(name, scale=scale)
    try:
        known = library.entries()
    except NoLibrary:  # a library is optional
        known = ()
    for entry in known:
        if entry.is_called(name):
            return library.model(entry.name)
    in_library = f"the library {library.place}" if known else f"a library (there is none at {library.place})"
    near = checks.suggestion(name, {*objects, *(entry.name for entry in known)})
    raise InvalidInput(
        f"{argument}: expected a name of {place or in_library} or a mesh file, got {checks.brief(name)!r}{near}"
    )
