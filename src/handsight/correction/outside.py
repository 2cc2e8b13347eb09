"""What cannot be inside the object, checked, as kernels take it: points of the hand, and planes such as a table."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.records import OUTSIDE
from handsight.checks import Array, Indices
from handsight.contact import Contacts
from handsight.contact.taxels import SIGMA_CLEARANCE, SkinTouch
from handsight.correction.problem import check_number
from handsight.correction.skin import SkinEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.representation import short_repr

MOST_POINTS, MOST_PLANES = 10_000, 100
"""Of one correction."""
NO_OUTSIDE, NO_POINTS = np.empty(0, dtype=OUTSIDE), np.empty((0, 3))
_EACH = np.arange(MOST_POINTS)


@dataclass(frozen=True)
class Plane:
    """A `Plane` is a plane that the object cannot cross."""

    point_palm: Array
    """(3,) any point of it [m]."""
    normal_palm: Array
    """(3,) to the side where the object is; of any length."""
    sigma: float
    """One standard deviation of where it is along its normal [m]."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_palm", checks.position(self.point_palm, "plane.point_palm", (3,)))
        object.__setattr__(self, "normal_palm", checks.unit(self.normal_palm, "plane.normal_palm", (3,)))
        object.__setattr__(self, "sigma", checks.sigma(self.sigma, "plane.sigma"))


@dataclass(frozen=True)
class Outside:
    """An `Outside` is what cannot be inside the object."""

    points_palm: ArrayLike = ()
    """(m, 3) of the hand's surface [m]."""
    planes: Sequence[Plane] = ()
    """With all that is behind them."""
    sigmas: ArrayLike | None = None
    """One for all points or (m,): one standard deviation per axis [m]; None: 1.5 times the median contact's."""
    links: ArrayLike | None = None
    """(m,) whole numbers: the points of one link are wrong together, and count as the deepest of them does; None: each
    point by itself."""
    slacks: ArrayLike | None = None
    """One for all points or (m,): how deep inside a point may be, where a link is smaller than its shape [m]."""

    skin: ArrayLike | None = None
    """Deprecated: `correct_pose(skin=SkinEvidence(...))` takes a tactile array. These are its `sigmas` (6,)."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not isinstance(self.planes, list | tuple) or not all(isinstance(p, Plane) for p in self.planes):
            raise InvalidInput(f"outside.planes: expected a list of Planes, got {checks.brief(self.planes)}")
        points = np.array(_points(self.points_palm))  # the caller may change its own
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
        """Returns the untouched taxels of an array. Deprecated: `SkinEvidence.of` has the pressed ones as well."""
        skin = SkinEvidence.of(touch, T_palm_frame, by_error)
        return cls(skin.untouched_palm, sigmas=SIGMA_CLEARANCE, skin=skin.sigmas)

    def joined(self, other: Outside) -> Outside:
        """Returns the evidence of both; each must have sigmas of its own."""
        counts = [len(np.asarray(each.points_palm)) for each in (self, other)]

        def both(name: str, usual: float) -> Array:
            """Returns the values of all points, where one may be given for all, or none."""
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
        """Returns points of links from arrays that are not checked, and kept, for loops at control rate."""
        outside = object.__new__(cls)
        given: dict[str, Any] = {"points_palm": points_palm, "planes": (), "sigmas": sigmas, "links": links}
        given |= {"slacks": slacks, "skin": None}
        for name, value in given.items():
            object.__setattr__(outside, name, value)
        return outside


def _points(value: ArrayLike) -> Array:
    """Returns (m, 3), or none; raises InvalidInput."""
    if isinstance(value, np.ndarray | list | tuple) and not len(value):
        return np.empty((0, 3))
    usual = isinstance(value, np.ndarray) and value.dtype == np.float64 and value.shape[1:] == (3,)
    # Only where this quick test fails are the numbers checked one by one; it fails for NaN too.
    if not (usual and value.min() >= -checks.MAX_DISTANCE and value.max() <= checks.MAX_DISTANCE):  # type: ignore[union-attr]
        value = checks.position(value, "outside", (None, 3))
    check_number(len(value), MOST_POINTS, "outside", "points")  # type: ignore[arg-type]
    return value  # type: ignore[return-value]


def _each(value: ArrayLike, name: str, n: int, limits: tuple[float, float]) -> Array:
    """Returns () or (n,) between limits; raises InvalidInput."""
    numbers = checks.finite(value, name, (n,) if checks.ndim(value) else ())
    if numbers.size and not limits[0] <= numbers.min() <= numbers.max() <= limits[1]:
        low, high = limits
        raise InvalidInput(f"{name}: expected numbers from {low:g} to {high:g}, got {checks.brief(value)}")
    return numbers


def _links(value: ArrayLike, n: int) -> Indices:
    """Returns (n,) whole; raises InvalidInput."""
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
    """Returns (m,) OUTSIDE: points, those of a link in a row, then untouched taxels, each a link by itself, and planes.

    Points are no evidence about an object that has no inside.
    """
    if outside is None and skin is None:
        return NO_OUTSIDE
    given: Any = outside if isinstance(outside, Outside) else None
    places: Any = (
        outside.points_palm if isinstance(outside, Outside) else _points(() if outside is None else outside)
    )
    planes: Sequence[Plane] = () if given is None else given.planes
    untouched = NO_POINTS if skin is None else skin.untouched_palm
    n, m = (len(places), len(untouched)) if model.closed else (0, 0)
    rows = np.zeros(n + m + len(planes), dtype=OUTSIDE)
    if n:
        points = rows[:n] if len(rows) > n else rows
        points["point"], points["link"] = places, _EACH[:n]
        if given is None or given.sigmas is None:
            points["sigma"] = _usual_sigma(model, contacts)
        if given is not None:
            for name, values in (("sigma", given.sigmas), ("slack", given.slacks), ("link", given.links)):
                if values is not None:
                    points[name] = values
            if given.links is not None and (given.links[1:] < given.links[:-1]).any():
                points[:] = points[np.argsort(given.links, kind="stable")]
    if m:
        taxels = rows[n : n + m]
        taxels["point"], taxels["sigma"] = untouched, SIGMA_CLEARANCE
        taxels["link"] = np.arange(m) + (rows["link"][:n].max() + 1 if n else 0)
    for row, plane in zip(rows[n + m :], planes, strict=True):
        row["is_plane"], row["sigma"] = True, plane.sigma
        row["point"], row["normal"] = plane.point_palm, plane.normal_palm
    return rows


def _usual_sigma(model: ObjectModel, contacts: Contacts) -> float:
    """Returns sigma [m] of points for which none is given: 1.5 times that of the median contact, and at least a
    thousandth of that part of the object's diameter.

    A point is as uncertain as the contacts, through the same kinematics, and more, as others beside it are wrong with
    it.
    """
    covariance = contacts.covariance
    variances = sorted((covariance[:, 0, 0] + covariance[:, 1, 1] + covariance[:, 2, 2]).tolist())
    # np.median takes longer than all the rest.
    middle = variances[(len(variances) - 1) // 2], variances[len(variances) // 2]
    median = (math.sqrt(middle[0] / 3) + math.sqrt(middle[1] / 3)) / 2
    return 1.5 * max(median, 1e-3 * model.diameter)
