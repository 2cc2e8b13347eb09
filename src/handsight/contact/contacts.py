"""The contacts of one grasp in the palm frame, as pose correction takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._compiled.records import CONTACT
from handsight.checks import Array, Indices, Mask
from handsight.contact.contact import Contact, symmetric
from handsight.errors import InvalidInput
from handsight.representation import short_repr

SIGMA_POINT = 1e-3
SIGMA_NORMAL = 0.1
"""Standard deviations of contacts that are given without [m], [rad]."""


@dataclass(frozen=True, init=False, eq=False)
class Contacts:
    """Points where the hand touches the object, with or without normals, and their covariances."""

    points_palm: Array
    """(n, 3) positions, n ≥ 1 [m]."""
    normals_palm: Array
    """(n, 3) unit outward normals of the object; zeros where `has_normal` is False."""
    has_normal: Mask
    """(n,) whether each contact has a normal."""
    covariance: Array
    """(n, 6, 6) covariance of (point [m], normal) along the palm's axes. It is zero along the normal, as a unit normal
    varies in its tangent plane only, and in the whole normal block where there is no normal."""
    group: Indices
    """(n,) the number of the group whose error each contact shares, an index of `shared_covariance`; -1: of none."""
    shared_covariance: Array
    """(g, 6, 6) covariance, along the palm's axes, of each group's shift [m] and turn [rad] about its centroid."""

    __repr__ = short_repr

    def __init__(
        self,
        points_palm: ArrayLike,
        normals_palm: ArrayLike | Sequence[ArrayLike | None] | None = None,
        sigma_point: ArrayLike = SIGMA_POINT,
        sigma_normal: ArrayLike = SIGMA_NORMAL,
        covariance: ArrayLike | None = None,
        *,
        group: ArrayLike | None = None,
        shared_covariance: ArrayLike | None = None,
    ) -> None:
        """`points_palm` (n, 3) [m]; `normals_palm` (n, 3), any length, None for a contact without one.

        `sigma_point` [m] and `sigma_normal` [rad], a number or (n,), are one standard deviation per axis (of
        a point's x; of a normal's angle about each of two tangent axes). `covariance` (n, 6, 6), positive
        semidefinite, replaces both. They are errors of the finger: `correct_pose` adds the errors of the model's
        surface, and the change of its normal with the error of the point.

        `group` (n,), whole numbers from 0, or -1: contacts with the same number are on one link, or were probed by one
        tool, whose placement is in error by a shift and a turn of all of them. `shared_covariance` (6, 6), or (g, 6, 6)
        for the groups 0 to g - 1, is the covariance of that, beside the errors of each contact. However many contacts
        a group has, they do not tell more about the pose than this allows. Raises an InvalidInput that names the entry.
        """
        if checks.ndim(points_palm) and not len(points_palm):  # type: ignore[arg-type]
            raise InvalidInput("points_palm: expected at least one contact, got no contacts")
        points = _by_row(checks.in_reach, points_palm, "points_palm", (3,))
        normals, has_normal = _normals(normals_palm, len(points))
        if covariance is None:
            position = _sigmas(sigma_point, "sigma_point", len(points))
            angle = _sigmas(sigma_normal, "sigma_normal", len(points))
            variances = np.stack([position, position, position, angle, angle, angle], axis=1) ** 2
            covariance_palm = variances[:, :, None] * np.eye(6)
        else:
            covariance_palm = _by_row(checks.covariance, covariance, "covariance", (6, 6))
            _check_length(covariance_palm, "covariance", len(points))
        # Projected to the normals' tangent planes, and to nothing where there is no normal.
        B = np.zeros((len(normals), 6, 6))
        B[:, :3, :3] = np.eye(3)
        B[:, 3:, 3:] = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        B[~has_normal, 3:, 3:] = 0.0
        covariance_palm = symmetric(B @ covariance_palm @ B.swapaxes(-1, -2))
        groups = _groups(group, shared_covariance, len(points))
        _fill(self, points, normals, has_normal, covariance_palm, *groups)

    @classmethod
    def from_tips(
        cls,
        contacts: Sequence[Contact],
        *,
        sigma_point: ArrayLike = SIGMA_POINT,
        sigma_normal: ArrayLike = SIGMA_NORMAL,
    ) -> Contacts:
        """Returns contacts that fingertips sensed, already `moved` into the palm frame.

        The sigmas (one standard deviation per axis, a number or (n,)) are of errors beside the force sensor's noise:
        joint angles, calibration, soft tips. They are added to each contact's own covariance, which alone is singular,
        as it has no error across the tip's surface.
        """
        if not len(contacts):
            raise InvalidInput("contacts: expected at least one contact, got none")
        for i, contact in enumerate(contacts):
            if not isinstance(contact, Contact):
                raise InvalidInput(f"contacts[{i}]: expected a Contact, got {checks.brief(contact)}")
        points = np.array([contact.point for contact in contacts])
        normals = np.array([contact.normal for contact in contacts])
        rest = cls(points, normals, sigma_point, sigma_normal)
        sensed = np.array([contact.covariance for contact in contacts])
        return cls(points, normals, covariance=sensed + rest.covariance)

    @classmethod
    def trusted(cls, points_palm: Array, normals_palm: Array, covariance: Array) -> Contacts:
        """Returns contacts of arrays that are not checked, for loops at control rate.

        The arrays must be float64 and finite, the normals unit, the covariances positive semidefinite and zero along
        the normals. The arrays are kept and made read-only.
        """
        n = len(points_palm)
        return _unchecked(
            points_palm, normals_palm, np.ones(n, dtype=bool), covariance, np.full(n, -1), NO_GROUP
        )

    @cached_property
    def record(self) -> NDArray[np.void]:
        """(n,) CONTACT: the same values as records for the kernels, without the groups."""
        records = np.zeros(len(self), dtype=CONTACT)
        records["point"] = self.points_palm
        records["normal"] = self.normals_palm
        records["has_normal"] = self.has_normal
        records["used"] = True
        records["covariance"] = self.covariance
        return records

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restores a copy or a pickle, whose arrays NumPy makes writable: for kernels these are of another type."""
        _fill(self, *(state[name] for name in _ARRAYS))

    def __len__(self) -> int:
        return len(self.points_palm)

    def moved(self, T_new_palm: ArrayLike) -> Contacts:
        """Returns the same contacts in another frame; `T_new_palm` (4, 4) maps palm coordinates to the new ones."""
        T = se3.check(T_new_palm, "T_new_palm")
        R = T[:3, :3]
        covariance = symmetric(se3.rotate_covariance(R, self.covariance))
        points = se3.apply(T, self.points_palm)
        normals = self.normals_palm @ R.T
        shared = se3.rotate_covariance(R, self.shared_covariance)
        return _unchecked(points, normals, self.has_normal, covariance, self.group, shared)

    def with_own_errors(self) -> Contacts:
        """Returns the contacts without groups, each with the error that it shares as if that were its own."""
        if not len(self.shared_covariance):
            return self
        covariance = self.covariance.copy()
        for g, shared in enumerate(self.shared_covariance):
            own = np.flatnonzero(self.group == g)
            by_error = np.zeros((len(own), 6, 6))
            by_error[:, :3, :3] = np.eye(3)
            if len(own):
                by_error[:, :3, 3:] = -se3.skew(self.points_palm[own] - self.points_palm[own].mean(axis=0))
            by_error[:, 3:, 3:] = -se3.skew(self.normals_palm[own])
            covariance[own] += by_error @ shared @ by_error.swapaxes(1, 2)
        places = self.points_palm, self.normals_palm, self.has_normal
        return _unchecked(*places, symmetric(covariance), np.full(len(self), -1), NO_GROUP)

    def negated(self) -> Contacts:
        """Returns the contacts with their normals the other way round."""
        signs = np.repeat([1.0, -1.0], 3)
        covariance = self.covariance * np.outer(signs, signs)
        places = self.points_palm, -self.normals_palm, self.has_normal
        return _unchecked(*places, covariance, self.group, self.shared_covariance)

    def joined(self, other: Contacts) -> Contacts:
        """Returns these contacts followed by the other ones."""
        arrays = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in _ARRAYS]
        arrays[-2][len(self) :][other.group >= 0] += len(self.shared_covariance)
        return _unchecked(*arrays)

    def select(self, mask_or_indices: ArrayLike) -> Contacts:
        """Returns the contacts of a mask (n,) bool, or of indices, which may reorder and repeat; at least one."""
        chosen = np.asarray(mask_or_indices)
        n = len(self)
        if chosen.dtype == np.bool_ and chosen.shape == (n,):
            chosen = np.flatnonzero(chosen)
        if chosen.size == 0:
            raise InvalidInput("select: expected at least one contact, got none")
        if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or not ((chosen >= -n) & (chosen < n)).all():
            raise InvalidInput(
                f"select: expected a mask of {n} or indices below {n}, got {checks.brief(mask_or_indices)}"
            )
        arrays = [getattr(self, name)[chosen] for name in (*_EACH, "group")]
        return _unchecked(*arrays, self.shared_covariance)


NO_GROUP = np.empty((0, 6, 6))
MOST_GROUPS = 1000
_EACH = "points_palm", "normals_palm", "has_normal", "covariance"
_ARRAYS = (*_EACH, "group", "shared_covariance")


def _unchecked(*arrays: Any) -> Contacts:
    """Returns contacts of clean arrays, in the order of `_ARRAYS`."""
    contacts = object.__new__(Contacts)
    _fill(contacts, *arrays)
    return contacts


def _fill(contacts: Contacts, *arrays: Any) -> None:
    """Sets the fields of contacts to arrays, in the order of `_ARRAYS`, and makes these read-only."""
    for name, array in zip(_ARRAYS, arrays, strict=True):
        array.setflags(write=False)
        object.__setattr__(contacts, name, array)


def _groups(group: ArrayLike | None, shared_covariance: ArrayLike | None, n: int) -> tuple[Indices, Array]:
    """Returns the contacts' groups (n,) and the covariances of these (g, 6, 6); raises InvalidInput."""
    if (group is None) != (shared_covariance is None):
        raise InvalidInput("group, shared_covariance: expected both or neither, got one of them")
    if group is None or shared_covariance is None:
        return np.full(n, -1), NO_GROUP
    given = checks.finite(group, "group", (n,))
    numbers = given.astype(np.int64)
    if (numbers != given).any() or not -1 <= numbers.min() <= numbers.max() < n:
        raise InvalidInput(f"group: expected whole numbers from -1 to {n - 1}, got {checks.brief(group)}")
    count = int(numbers.max()) + 1
    if count > MOST_GROUPS:
        raise InvalidInput(f"group: expected at most {MOST_GROUPS} groups, got {count}")
    if checks.ndim(shared_covariance) == 2:
        covariance = checks.covariance(shared_covariance, "shared_covariance", (6, 6))
        return numbers, np.repeat(covariance[None], count, axis=0)
    covariance = _by_row(checks.covariance, shared_covariance, "shared_covariance", (6, 6))
    if len(covariance) < count:
        raise InvalidInput(
            f"shared_covariance: expected one for each of {count} groups, got {len(covariance)}"
        )
    return numbers, covariance


def _normals(normals_palm: object, n: int) -> tuple[Array, Mask]:
    """Returns normals (n, 3), unit or zero, and whether each exists (n,)."""
    normals = np.zeros((n, 3))
    has_normal = np.zeros(n, dtype=bool)
    if normals_palm is None:
        return normals, has_normal
    if not isinstance(normals_palm, np.ndarray | Sequence) or isinstance(normals_palm, str):
        raise InvalidInput(f"normals_palm: expected {n} normals, got {checks.brief(normals_palm)}")
    _check_length(normals_palm, "normals_palm", n)
    if isinstance(normals_palm, np.ndarray) and normals_palm.dtype.kind == "f":
        return _by_row(checks.unit, normals_palm, "normals_palm", (3,)), np.ones(n, dtype=bool)
    for i, normal in enumerate(normals_palm):
        if normal is not None:
            normals[i] = checks.unit(normal, f"normals_palm[{i}]", (3,))
            has_normal[i] = True
    return normals, has_normal


def _sigmas(value: ArrayLike, name: str, n: int) -> Array:
    """Returns standard deviations (n,) of points or normals."""
    check = checks.sigma_point if name == "sigma_point" else checks.sigma_angle
    if checks.ndim(value) == 0:
        return np.full(n, check(value, name))
    sigmas = checks.finite(value, name, (None,))
    _check_length(sigmas, name, n)
    for i in np.flatnonzero(~((sigmas >= checks.MIN_SIGMA) & (sigmas <= np.pi))):
        check(sigmas[i], f"{name}[{i}]")
    return sigmas


def _by_row(check: Callable[..., Array], value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Returns `check` of all rows (n, *shape); where that fails for one row, the message names the row."""
    try:
        return check(value, name, (None, *shape))
    except InvalidInput:
        for i, row in enumerate(value if checks.ndim(value) else ()):  # type: ignore[arg-type]
            check(row, f"{name}[{i}]", shape)
        raise


def _check_length(value: Sequence[object] | Array, name: str, n: int) -> None:
    if len(value) != n:
        raise InvalidInput(f"{name}: expected as many as points_palm ({n}), got {len(value)}")
