"""What the mappings of a `rig.yaml` have in common: kinds of numbers, lengths in metres, poses."""

from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from handsight import checks, se3
from handsight.checks import Array
from handsight.rig.rig import FARTHEST, LONGEST_LINK

Positive = Annotated[float, Meta(gt=0)]
AtLeastZero = Annotated[float, Meta(ge=0)]
Angle = Annotated[float, Meta(ge=0, le=180)]
"""A sigma [degrees]."""
Pixels = Annotated[float, Meta(gt=0, le=1e5)]
Load = Annotated[float, Meta(gt=0, le=checks.MAX_LOAD)]
Text = Annotated[str, Meta(pattern=r"\S")]
Vector = tuple[float, float, float]


class Form(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One mapping of the file."""

    LONGEST: ClassVar[dict[str, float]] = {}
    """By field: the longest that its lengths can be [m]; beyond it the unit is wrong."""

    def __post_init__(self) -> None:
        for item in msgspec.structs.fields(self):
            value, most = getattr(self, item.name), self.LONGEST.get(item.name)
            if value is None or most is None or isinstance(value, str):
                continue
            if np.abs(value).max() > most:
                came = checks.metres_text(value, most)
                raise ValueError(f"{item.encode_name}: expected metres within {most:g}, got {came}")

    def given(self) -> dict[str, Any]:
        """What is said, by the names that the parts have for it; degrees as radians."""
        return {
            item.name: float(np.deg2rad(value)) if item.encode_name.endswith("_deg") else value
            for item in msgspec.structs.fields(self)
            if (value := getattr(self, item.name)) is not None
        }

    def sigmas(self) -> dict[str, float]:
        """Of what is said, the standard deviations."""
        return {name: value for name, value in self.given().items() if name.startswith("sigma")}


class PoseForm(Form):
    LONGEST: ClassVar = {"position": FARTHEST}

    position: Vector = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.matrix()

    def matrix(self) -> Array:
        """(4, 4); raises InvalidInput where the quaternion is zero."""
        return se3.from_position_quaternion(self.position, self.quaternion_xyzw)


class LinkPoseForm(PoseForm):
    """On a link of a finger."""

    LONGEST: ClassVar = {"position": LONGEST_LINK}
