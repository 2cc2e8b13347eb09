"""What cannot be inside the object, checked, as kernels take it: points of the hand, and planes such as a table."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.records import OUTSIDE
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction.problem import check_number
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

POINT_SIGMA = (1.5, 1e-3)
"""Of a point of the hand: in sigmas of the contacts' points, and at least this [diameters]. It is as uncertain as the
contacts, through the same kinematics, and the points of one link are wrong together, hence more than that."""
MOST_POINTS, MOST_PLANES = 10_000, 100
"""Of one correction: each costs as much as the one before it."""
NO_OUTSIDE = np.empty(0, dtype=OUTSIDE)


@dataclass(frozen=True)
class Plane:
    """A plane that the object cannot cross."""

    point_palm: Array
    """(3,) any point of it [m]."""
    normal_palm: Array
    """(3,) to the side where the object is; of any length."""
    sigma: float
    """One standard deviation of where it is along its normal [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_palm", checks.position(self.point_palm, "plane.point_palm", (3,)))
        object.__setattr__(self, "normal_palm", checks.unit(self.normal_palm, "plane.normal_palm", (3,)))
        object.__setattr__(self, "sigma", checks.sigma(self.sigma, "plane.sigma"))


@dataclass(frozen=True)
class Outside:
    """What cannot be inside the object."""

    points_palm: ArrayLike = ()
    """(m, 3) of the hand's surface [m]."""
    planes: Sequence[Plane] = ()
    """With all that is behind them."""

    def __post_init__(self) -> None:
        if not isinstance(self.planes, list | tuple) or not all(isinstance(p, Plane) for p in self.planes):
            raise InvalidInput(f"outside.planes: expected a list of Planes, got {checks.brief(self.planes)}")


def outside_records(
    model: ObjectModel, contacts: Contacts, outside: ArrayLike | Outside | None
) -> NDArray[Any]:
    """(m,) OUTSIDE. Points say nothing of an object that has no inside."""
    if outside is None:
        return NO_OUTSIDE
    given = outside if isinstance(outside, Outside) else Outside(outside)
    points = np.empty((0, 3))
    if not (isinstance(given.points_palm, np.ndarray | list | tuple) and not len(given.points_palm)):
        points = checks.position(given.points_palm, "outside", (None, 3))
    check_number(len(points), MOST_POINTS, "outside", "points")
    check_number(len(given.planes), MOST_PLANES, "outside.planes", "planes")
    if not model.closed:
        points = points[:0]
    rows = np.zeros(len(points) + len(given.planes), dtype=OUTSIDE)
    sigmas = np.sort(np.sqrt(np.einsum("nii->n", contacts.covariance[:, :3, :3]) / 3))
    # np.median takes longer than all the rest.
    median = (sigmas[(len(sigmas) - 1) // 2] + sigmas[len(sigmas) // 2]) / 2
    rows["point"][: len(points)] = points
    rows["sigma"] = POINT_SIGMA[0] * max(median, POINT_SIGMA[1] * model.diameter)
    for row, plane in zip(rows[len(points) :], given.planes, strict=True):
        row["is_plane"], row["sigma"] = True, plane.sigma
        row["point"], row["normal"] = plane.point_palm, plane.normal_palm
    return rows
