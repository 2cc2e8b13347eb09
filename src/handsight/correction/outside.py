"""Evidence of what is outside the object: points of the hand, and planes such as a table; checked, and as records."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.evidence.outside_term import load_points
from handsight._kernels.records import OUTSIDE
from handsight.checks import Array, Indices
from handsight.contact import Contacts
from handsight.contact.taxels import SkinTouch
from handsight.correction.problem import check_number
from handsight.correction.skin import SkinEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.representation import short_repr

MOST_POINTS, MOST_PLANES = 10_000, 100
"""Points and planes of one correction."""
NO_OUTSIDE = np.empty(0, dtype=OUTSIDE)


@dataclass(frozen=True)
class Plane:
    """A `Plane` is a plane that the object cannot cross."""

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
    """An `Outside` has points and planes of which the object cannot contain any point."""

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

    skin: ArrayLike | None = None
    """Deprecated: the `sigmas` (6,) of a tactile array, which is now `correct_pose(skin=SkinEvidence(...))`."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not isinstance(self.planes, list | tuple) or not all(isinstance(p, Plane) for p in self.planes):
            raise InvalidInput(f"outside.planes: expected a list of Planes, got {checks.brief(self.planes)}")
        points = _points(self.points_palm)
        check_number(len(self.planes), MOST_PLANES, "outside.planes", "planes")
        object.__setattr__(self, "points_palm", points)
        if self.links is not None:
            object.__setattr__(self, "links", _links(self.links, len(points)))
        for name, least in (("sigmas", checks.MIN_SIGMA), ("slacks", 0.0)):
            if getattr(self, name) is not None:
                limits = least, checks.MAX_DISTANCE
                numbers = _each(getattr(self, name), f"outside.{name}", len(points), limits)
                object.__setattr__(self, name, numbers)
        if self.skin is not None:
            warnings.warn("Outside.skin is now SkinEvidence, for correct_pose(skin=)", DeprecationWarning, 3)
            object.__setattr__(self, "skin", checks.finite(self.skin, "outside.skin", (6,)))

    @classmethod
    def of_skin(cls, touch: SkinTouch, T_palm_frame: ArrayLike, by_error: ArrayLike | None = None) -> Outside:
        """Returns the untouched taxels of an array. Deprecated: `SkinEvidence.of` has the pressed taxels as well."""
        skin = SkinEvidence.of(touch, T_palm_frame, by_error)
        return cls(skin.untouched_palm, sigmas=skin.sigma_untouched, skin=skin.sigmas)

    def joined(self, other: Outside) -> Outside:
        """Returns the points and planes of both; points that have no sigmas get NaN, so each must have its own."""
        counts = [len(np.asarray(each.points_palm)) for each in (self, other)]

        def both(name: str, usual: float) -> Array:
            """Returns a field of all points (m,), with the usual value where one of the two does not state it."""
            given = [getattr(each, name) for each in (self, other)]
            return np.concatenate(
                [np.broadcast_to(usual if v is None else v, n) for v, n in zip(given, counts, strict=True)]
            )

        mine, theirs = (
            np.arange(n) if each.links is None else np.asarray(each.links)
            for each, n in zip((self, other), counts, strict=True)
        )
        skins = [np.asarray(each.skin) for each in (self, other) if each.skin is not None]
        return Outside(
            np.concatenate([np.reshape(each.points_palm, (-1, 3)) for each in (self, other)]),
            [*self.planes, *other.planes],
            sigmas=both("sigmas", np.nan),
            links=np.concatenate([mine, theirs + (mine.max(initial=-1) + 1 - theirs.min(initial=0))]),
            slacks=both("slacks", 0.0),
            skin=np.max(skins, axis=0) if skins else None,
        )

    @classmethod
    def trusted(
        cls, points_palm: Array, sigmas: Array, links: Indices, slacks: Array | None = None
    ) -> Outside:
        """Returns points of links, whose arrays are neither checked nor copied; for control loops."""
        outside = object.__new__(cls)
        given: dict[str, Any] = {"points_palm": points_palm, "planes": (), "sigmas": sigmas, "links": links}
        given |= {"slacks": slacks, "skin": None}
        for name, value in given.items():
            object.__setattr__(outside, name, value)
        return outside


def _points(value: ArrayLike) -> Array:
    """Returns a copy of points (m, 3) [m], of which there may be none; raises InvalidInput."""
    empty = isinstance(value, np.ndarray | list | tuple) and checks.ndim(value) and not len(value)
    points = np.empty((0, 3)) if empty else checks.position(value, "outside", (None, 3))
    check_number(len(points), MOST_POINTS, "outside", "points")
    return points


def _each(value: ArrayLike, name: str, n: int, limits: tuple[float, float]) -> Array:
    """Returns one number () or n numbers (n,) between limits; raises InvalidInput."""
    numbers = checks.finite(value, name, (n,) if checks.ndim(value) else ())
    if numbers.size and not limits[0] <= numbers.min() <= numbers.max() <= limits[1]:
        low, high = limits
        raise InvalidInput(f"{name}: expected numbers from {low:g} to {high:g}, got {checks.brief(value)}")
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
    given: Any = outside if isinstance(outside, Outside) else None
    planes: Sequence[Plane] = () if given is None else given.planes
    places: Any = outside if given is None else given.points_palm
    # The numbers in a usual array are checked as they become records: every call saved here is some per cent of all.
    usual = type(places) is np.ndarray and places.dtype == np.float64 and places.shape[1:] == (3,)
    if not usual or len(places) > MOST_POINTS:
        places = _points(() if places is None else places)
    untouched = () if skin is None else skin.untouched_palm
    n, m = len(places), len(untouched)
    count = n + m + len(planes)
    # Of bytes: np.zeros would read more from memory.
    rows = np.ndarray(count, OUTSIDE, bytearray(count * OUTSIDE.itemsize))
    if n and not load_points(places, contacts.record, model.diameter, rows):
        _points(places)  # raises InvalidInput
    if given is not None:
        for name, values in (("sigma", given.sigmas), ("slack", given.slacks), ("link", given.links)):
            if values is not None:
                rows[name][:n] = values
        if given.links is not None and (given.links[1:] < given.links[:-1]).any():
            rows[:n] = rows[np.argsort(given.links, kind="stable")]
    if m and skin is not None:
        taxels = rows[n : n + m]
        taxels["point"], taxels["sigma"] = untouched, skin.sigma_untouched
        taxels["link"] = np.arange(m) + (rows["link"][:n].max() + 1 if n else 0)
    for i, plane in enumerate(planes, n + m):
        row = rows[i]
        row["is_plane"], row["sigma"] = True, plane.sigma
        row["point"], row["normal"] = plane.point_palm, plane.normal_palm
    return rows if model.closed else rows[n + m :]
