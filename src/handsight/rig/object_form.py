"""An object as a rig file has it: what it looks like, and what it weighs."""

from pathlib import Path
from typing import ClassVar, Literal

from handsight.rig.form_parts import Form, Positive, Text
from handsight.rig.rig import LARGEST_HELD, ObjectEntry

HEAVIEST_HELD = 100.0
"""Of what a hand holds [kg]."""


class CylinderForm(Form):
    LONGEST: ClassVar = {"radius": LARGEST_HELD, "height": LARGEST_HELD}

    radius: Positive
    height: Positive


class ObjectForm(Form):
    LONGEST: ClassVar = {
        "box": LARGEST_HELD,
        "center_of_mass": LARGEST_HELD,
        "sigma_center_of_mass": LARGEST_HELD,
    }

    box: tuple[Positive, Positive, Positive] | None = None
    cylinder: CylinderForm | None = None
    mesh: Text | None = None
    """A path from the rig file on."""
    scale: Positive | None = None
    """Metres of a unit of the mesh."""
    name: Text | None = None
    """In the object library."""
    mass: Positive | None = None
    """[kg]"""
    center_of_mass: tuple[float, float, float] | Literal["homogeneous"] | None = None
    """In the object's frame [m], or that of its volume."""
    sigma_center_of_mass: Positive | None = None
    """[m]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mass is not None and self.mass > HEAVIEST_HELD:
            raise ValueError(f"mass: expected kilograms, got {self.mass:g} (grams?)")
        if self.sigma_center_of_mass is not None and self.center_of_mass is None:
            raise ValueError("sigma_center_of_mass: expected beside center_of_mass only, got it alone")
        kinds = ("box", "cylinder", "mesh", "name")
        said = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(said) != 1:
            raise ValueError(f"expected one of {', '.join(kinds)}, got {' and '.join(said) or 'none'}")
        if self.scale is not None and self.mesh is None:
            raise ValueError(f"scale: expected beside mesh only, got it beside {said[0]}")

    def entry(self, folder: Path) -> ObjectEntry:
        """The part of the rig, its mesh beside a file of the folder."""
        return ObjectEntry(
            box=self.box,
            cylinder=None if self.cylinder is None else (self.cylinder.radius, self.cylinder.height),
            mesh=None if self.mesh is None else folder / self.mesh,
            scale=1.0 if self.scale is None else self.scale,
            name=self.name,
            mass=self.mass,
            center_of_mass=self.center_of_mass,
            sigma_center_of_mass=self.sigma_center_of_mass,
        )
