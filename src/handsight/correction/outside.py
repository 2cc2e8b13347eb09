"""Evidence of what is outside the object: points of the hand, and planes such as a table; checked, and as records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._compiled.records import OUTSIDE
from handsight.checks import Array, Indices
from handsight.contact import Contacts
from handsight.correction.kernels.outside_term import load_points
from handsight.correction.problem import check_number
from handsight.correction.skin import SkinEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.representation import short_repr

MOST_POINTS = 10_000
MOST_PLANES = 100
"""Points and planes of one correction."""
NO_OUTSIDE = np.empty(0, dtype=OUTSIDE)


@dataclass(frozen=True)
class Plane:
    """A plane that the object cannot cross."""

    point_palm: Array
    """(3,) any point of the plane [m]."""
    normal_palm: Array
    """(3,) normal of any length, to the side of the plane on which the object is."""
    sigma: float
    """One standard deviation of the plane's position along its normal [m]."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_palm", checks.position(self.point_palm, "plane.point_palm", (3,)))
        object.__setattr__(self, "normal_palm", checks.unit(self.normal_palm, "plane.normal_palm", (3,)))
        object.__setattr__(self, "sigma", checks.sigma(self.sigma, "plane.sigma"))


@dataclass(frozen=True)
class Outside:
    """Points and planes of which the object cannot contain any point."""

    points_palm: ArrayLike = ()
    """(m, 3) points of the hand's surface in the palm frame [m]."""
    planes: Sequence[Plane] = ()
    """Planes that the object cannot cross: it is on the side to which each normal leads."""
    sigmas: ArrayLike | None = None
    """One standard deviation per axis of a point [m], one for all points or (m,); None: 1.5 times that of the median
    contact."""
    links: ArrayLike | None = None
    """(m,) whole numbers, the link of each point: the points of a link have one common error, so together they count
    about as the deepest of them; None: each point counts by itself."""
    slacks: ArrayLike | None = None
    """How deep in the object a point may be at no cost [m], as a link may be smaller than its shape; one for all points
    or (m,). None: 0."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not isinstance(self.planes, list | tuple) or not all(isinstance(p, Plane) for p in self.planes):
            raise InvalidInput(f"outside.planes: expected a list of Planes, got {checks.brief(self.planes)}")
        points = _points(self.points_palm)
        n = len(points)
        check_number(len(self.planes), MOST_PLANES, "outside.planes", "planes")
        object.__setattr__(self, "points_palm", points)
        if self.links is not None:
            object.__setattr__(self, "links", _links(self.links, n))
        if self.sigmas is not None:
            object.__setattr__(self, "sigmas", _each(self.sigmas, "outside.sigmas", n, checks.MIN_SIGMA))
        if self.slacks is not None:
            object.__setattr__(self, "slacks", _each(self.slacks, "outside.slacks", n, 0.0))

    @classmethod
    def trusted(
        cls, points_palm: Array, sigmas: Array | None = None, links: Indices | None = None
    ) -> Outside:
        """Returns points of links, whose arrays are neither checked nor copied; for control loops."""
        outside = object.__new__(cls)
        outside.__dict__.update(points_palm=points_palm, sigmas=sigmas, links=links)
        return outside


def _points(value: ArrayLike) -> Array:
    """Returns a copy of points (m, 3) [m], of which there may be none; raises InvalidInput."""
    empty = isinstance(value, np.ndarray | list | tuple) and checks.ndim(value) and not len(value)
    points = np.empty((0, 3)) if empty else checks.position(value, "outside", (None, 3))
    check_number(len(points), MOST_POINTS, "outside", "points")
    return points


def _each(value: ArrayLike, name: str, n: int, least: float) -> Array:
    """Returns one number () or n numbers (n,), from `least` to MAX_DISTANCE; raises InvalidInput."""
    most = checks.MAX_DISTANCE
    numbers = checks.finite(value, name, (n,) if checks.ndim(value) else ())
    if ((numbers < least) | (numbers > most)).any():
        raise InvalidInput(f"{name}: expected numbers from {least:g} to {most:g}, got {checks.brief(value)}")
    return numbers


def _links(value: ArrayLike, n: int) -> Indices:
    """Returns the links' numbers (n,) as integers; raises InvalidInput."""
    numbers = checks.finite(value, "outside.links", (n,))
    if (numbers != np.rint(numbers)).any() or np.abs(numbers).max(initial=0.0) > 2**31:
        raise InvalidInput(f"outside.links: expected whole numbers, got {checks.brief(value)}")
    return numbers.astype(np.int64)


def outside_records(
    model: ObjectModel,
    contacts: Contacts,
    outside: ArrayLike | Outside | None,
    skin: SkinEvidence | None = None,
) -> NDArray[np.void]:
    """Returns OUTSIDE records (m,): first points, sorted by link, then untouched taxels, each a link by itself, then
    planes; raises InvalidInput.

    Points and taxels are left out for an object that has no inside.
    """
    if outside is None and skin is None:
        return NO_OUTSIDE
    given: Any = outside
    if not isinstance(outside, Outside):
        # A usual array is checked as its numbers become records, which takes half the time of all other checks.
        usual = type(outside) is np.ndarray and outside.dtype == np.float64 and outside.shape[1:] == (3,)
        trusted = usual and len(given) <= MOST_POINTS
        given = Outside.trusted(given) if trusted else Outside(() if outside is None else outside)
    n = len(given.points_palm)
    m = 0 if skin is None else len(skin.untouched_palm)
    rows = np.zeros(n + m + len(given.planes), dtype=OUTSIDE)
    if n and not load_points(given.points_palm, contacts.record, model.diameter, rows):
        _points(given.points_palm)  # raises InvalidInput
    links = given.links
    for name, values in (("sigma", given.sigmas), ("slack", given.slacks), ("link", links)):
        if values is not None:
            rows[name][:n] = values
    if links is not None and (links[1:] < links[:-1]).any():
        rows[:n] = rows.take(np.argsort(links, kind="stable"))
    if skin is not None:
        taxels = rows[n : n + m]
        taxels["point"] = skin.untouched_palm
        taxels["sigma"] = skin.sigma_untouched
        taxels["link"] = np.arange(m) + rows["link"][:n].max(initial=-1) + 1
    for row, plane in zip(rows[n + m :], given.planes, strict=True):
        row["is_plane"] = True
        row["sigma"] = plane.sigma
        row["point"] = plane.point_palm
        row["normal"] = plane.normal_palm
    return rows if model.closed else rows[n + m :]
