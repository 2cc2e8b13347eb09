"""The contacts of one grasp in the palm frame: what correction uses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.records import CONTACT
from handsight.checks import Array, Mask
from handsight.contact.contact import Contact, symmetric
from handsight.errors import InvalidInput


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Contacts:
    """Where the hand touches the object, with or without normals, and how well that is known."""

    points_palm: Array
    """(n, 3), n ≥ 1 [m]."""
    normals_palm: Array
    """(n, 3) unit, the object's outward normals; rows of zeros where `has_normal` is False."""
    has_normal: Mask
    """(n,)"""
    covariance: Array
    """(n, 6, 6) of (point [m], normal) along the palm's axes. A unit normal varies in its
    tangent plane only, so nothing is kept along it, and nothing at all where there is no normal."""
    of_residual: Mask
    """(n,) whether the covariance is of the residuals, the model's share in it already."""
    record: NDArray[np.void]
    """(n,) the same as kernels take it."""

    def __init__(
        self,
        points_palm: ArrayLike,
        normals_palm: ArrayLike | Sequence[ArrayLike | None] | None = None,
        sigma_point: ArrayLike = 1e-3,
        sigma_normal: ArrayLike = 0.1,
        covariance: ArrayLike | None = None,
        *,
        of_residual: ArrayLike = False,
    ) -> None:
        """`points_palm` (n, 3) [m]; `normals_palm` (n, 3), any length, None for a contact without one.

        `sigma_point` [m] and `sigma_normal` [rad], a number or (n,), are one standard deviation per axis (of
        a point's x; of a normal's angle about each of two tangent axes). `covariance` (n, 6, 6), positive
        semidefinite, replaces both. They are of the finger: `correct_pose` adds how far the model is off its surface,
        and what the surface's bend makes of the point's noise. `of_residual` (a truth value or (n,)): they are of all
        that parts a measured contact from the model instead, as compared with a known pose, and nothing is added; then
        no direction may be known exactly. Raises InvalidInput naming the entry.
        """
        points = _points(points_palm)
        normals, has_normal = _normals(normals_palm, len(points))
        if covariance is None:
            sigmas = ((sigma_point, "sigma_point"), (sigma_normal, "sigma_normal"))
            variances = np.stack([_sigmas(sigma, name, len(points)) ** 2 for sigma, name in sigmas], axis=1)
            covariance_palm = np.repeat(variances, 3, axis=1)[:, :, None] * np.eye(6)
        else:
            covariance_palm = _by_row(checks.covariance, covariance, "covariance", (6, 6))
            _same_length(covariance_palm, "covariance", len(points))
        covariance_palm = _tangent(covariance_palm, normals, has_normal)
        flags = _of_residual(of_residual, normals, has_normal, covariance_palm)
        _fill(self, points, normals, has_normal, covariance_palm, flags)

    @classmethod
    def from_tips(
        cls, contacts: Sequence[Contact], *, sigma_point: ArrayLike = 1e-3, sigma_normal: ArrayLike = 0.1
    ) -> "Contacts":
        """Contacts sensed by fingertips, already `moved` into the palm frame.

        The sigmas (one standard deviation per axis, a number or (n,)) stand for what the force sensor's noise
        does not cover: joint angles, calibration, soft tips. They are added to each contact's own covariance,
        which alone is singular: it knows no error across the tip's surface.
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
    def trusted(cls, points_palm: Array, normals_palm: Array, covariance: Array) -> "Contacts":
        """Contacts from what is clean already; not checked.

        float64, finite, unit normals, covariances positive semidefinite and with nothing along the normals. For loops
        at control rate whose own inputs were checked; the arrays are kept and made read-only.
        """
        has_normal, of_residual = _usual_flags(len(points_palm))
        return _made(points_palm, normals_palm, has_normal, covariance, of_residual)

    def __len__(self) -> int:
        return len(self.points_palm)

    def moved(self, T_new_palm: ArrayLike) -> "Contacts":
        """The same contacts in another frame; `T_new_palm` (4, 4) maps palm coordinates to it."""
        T = se3.check(T_new_palm, "T_new_palm")
        R = T[:3, :3]
        covariance = symmetric(se3.rotate_covariance(R, self.covariance))
        points, normals = se3.apply(T, self.points_palm), self.normals_palm @ R.T
        return _made(points, normals, self.has_normal, covariance, self.of_residual)

    def joined(self, other: "Contacts") -> "Contacts":
        """These contacts and then the other ones."""
        return _made(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in _GIVEN))

    def select(self, mask_or_indices: ArrayLike) -> "Contacts":
        """Some of the contacts: a mask (n,) bool, or indices, which may reorder and repeat; at least one."""
        chosen, n = np.asarray(mask_or_indices), len(self)
        if chosen.dtype == np.bool_ and chosen.shape == (n,):
            chosen = np.flatnonzero(chosen)
        if chosen.size == 0:
            raise InvalidInput("select: expected at least one contact, got none")
        if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or not ((chosen >= -n) & (chosen < n)).all():
            came = checks.brief(mask_or_indices)
            raise InvalidInput(f"select: expected a mask of {n} or indices below {n}, got {came}")
        return _made(*(getattr(self, name)[chosen] for name in _GIVEN))


_GIVEN = ("points_palm", "normals_palm", "has_normal", "covariance", "of_residual")
_LEAST_SHARE = 1e-9
"""Of a residual's covariance, scaled to a correlation: a smaller eigenvalue is rounding's."""
_RECORDED = ("point", "normal", "has_normal", "covariance", "of_residual")


@lru_cache
def _usual_flags(n: int) -> tuple[Mask, Mask]:
    """(n,) that there are normals, and that no covariance is of residuals."""
    return np.ones(n, dtype=bool), np.zeros(n, dtype=bool)


def _made(*arrays: NDArray[Any]) -> Contacts:
    """Contacts of points, normals, which have one, covariances and whose these are, clean already."""
    contacts = object.__new__(Contacts)
    _fill(contacts, *arrays)
    return contacts


def _fill(contacts: Contacts, *arrays: NDArray[Any]) -> None:
    record = np.empty(len(arrays[0]), dtype=CONTACT)
    for name, field, array in zip(_GIVEN, _RECORDED, arrays, strict=True):
        array.flags.writeable = False
        object.__setattr__(contacts, name, array)
        record[field] = array
    record["used"] = True
    object.__setattr__(contacts, "record", record)


def _tangent(covariance: Array, normals: Array, has_normal: Mask) -> Array:
    """`covariance` without the part along the normals, and without any where there is none."""
    B = np.zeros((len(normals), 6, 6))
    B[:, :3, :3] = np.eye(3)
    B[:, 3:, 3:] = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    B[~has_normal, 3:, 3:] = 0.0
    return symmetric(B @ covariance @ B.swapaxes(-1, -2))


def _of_residual(value: ArrayLike, normals: Array, has_normal: Mask, covariance: Array) -> Mask:
    """(n,) flags; raises InvalidInput where a residual's covariance, clean already, knows something exactly."""
    n, flags = len(normals), np.asarray(value)
    if flags.dtype != np.bool_ or flags.shape not in ((), (n,)):
        raise InvalidInput(f"of_residual: expected true or false, or {n} of these, got {checks.brief(value)}")
    flags = np.array(np.broadcast_to(flags, n))
    if not flags.any():
        return flags
    # Nothing is kept along a normal, and where there is none: there it need not be uncertain.
    size = np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2) / 2
    free = np.where(has_normal[:, None, None], normals[:, :, None] * normals[:, None, :], np.eye(3))
    whole = covariance.copy()
    whole[:, 3:, 3:] += np.where(has_normal, size, 1.0)[:, None, None] * free
    deviation = np.sqrt(np.einsum("nii->ni", whole))
    scaled = whole / np.maximum(deviation[:, :, None] * deviation[:, None, :], 1e-300)
    exact = flags & (np.linalg.eigvalsh(scaled).min(axis=1) < _LEAST_SHARE)
    if exact.any():
        i = int(np.flatnonzero(exact)[0])
        raise InvalidInput(
            f"covariance[{i}]: expected a residual's, uncertain in every direction, got one that is exact in some"
        )
    return flags


def _points(points_palm: Any) -> Array:
    if checks.ndim(points_palm) and not len(points_palm):
        raise InvalidInput("points_palm: expected at least one contact, got no contacts")
    return _by_row(checks.in_reach, points_palm, "points_palm", (3,))


def _normals(normals_palm: Any, n: int) -> tuple[Array, Mask]:
    """(n, 3) unit or zero, and which are there."""
    normals, has_normal = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    if normals_palm is None:
        return normals, has_normal
    if not isinstance(normals_palm, np.ndarray | Sequence) or isinstance(normals_palm, str):
        raise InvalidInput(f"normals_palm: expected {n} normals, got {checks.brief(normals_palm)}")
    _same_length(normals_palm, "normals_palm", n)
    for i, normal in enumerate(normals_palm):
        if normal is not None:
            normals[i] = checks.unit(normal, f"normals_palm[{i}]", (3,))
            has_normal[i] = True
    return normals, has_normal


def _sigmas(value: ArrayLike, name: str, n: int) -> Array:
    """(n,) positive, and no larger than what they are sigmas of."""
    check = checks.sigma_point if name == "sigma_point" else checks.sigma_normal
    if checks.ndim(value) == 0:
        return np.full(n, check(value, name))
    sigmas = checks.finite(value, name, (None,))
    _same_length(sigmas, name, n)
    for i in np.flatnonzero(~((sigmas >= checks.MIN_SIGMA) & (sigmas <= np.pi))):
        check(sigmas[i], f"{name}[{i}]")
    return sigmas


def _by_row(check: Callable[..., Array], value: Any, name: str, shape: tuple[int, ...]) -> Array:
    """`check` of the whole; where it fails, the message names the row at fault if one is."""
    try:
        return check(value, name, (None, *shape))
    except InvalidInput:
        for i, row in enumerate(value if checks.ndim(value) else ()):
            check(row, f"{name}[{i}]", shape)
        raise


def _same_length(value: Sequence[object] | Array, name: str, n: int) -> None:
    if len(value) != n:
        raise InvalidInput(f"{name}: expected as many as points_palm ({n}), got {len(value)}")
