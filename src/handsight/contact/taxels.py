"""A tactile array: a flat grid of taxels on a link, and what its readings say of the object.

Frame `grid`: origin in the middle of the grid, x along a row (the column's number grows), y along a column (the row's
number grows), +z out of the skin, towards what touches it. A taxel that is pressed is a contact with the link's
normal; one that is not is a point the object cannot cover. One that is dead, stuck or half covered says nothing.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array, Indices, Mask
from handsight.contact.contacts import Contacts
from handsight.errors import InvalidInput

MOST_TAXELS = 4096
"""Of one array."""
FINEST, COARSEST = 2e-4, 0.05
"""Pitch of an array [m]; beyond these the unit is wrong."""
COVERED = 0.5
"""A taxel that feels less than this share of what its hardest neighbour feels may be pressed at its rim alone."""
MAX_CONTACTS = 32
"""Of one array: pressed taxels as far apart as can be, for those between say nothing new."""
CLEARANCE, SIGMA_CLEARANCE = 5e-4, 3e-4
"""So far above an untouched taxel there is no object [m], for a face that lies on the skin is at no depth in it; and
how far wrong that may be: one standard deviation. A can's side is that high 6 mm beside where it touches."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TaxelArray:
    """A flat grid of taxels on a link of the hand; raises InvalidInput for what is none."""

    frame: str
    """The body of the hand's file that it is fixed to."""
    T_frame_grid: Array
    """(4, 4)."""
    rows: int
    columns: int
    pitch: float
    """From taxel to taxel, both ways [m]."""
    threshold: float
    """What a taxel reads that is touched, at least, above what it reads untouched; in the unit of its readings."""
    full_scale: float | None = None
    """The largest reading there is: as good as pressed, but a taxel at it all the time is not believed."""
    sigma_point: float = 1.5e-4
    """Of a taxel's height by itself: uneven, soft skin [m]; sideways it is known to its cell."""
    sigma_normal: float = np.deg2rad(4.0)
    """[rad]"""
    sigma_mount: float = 5e-4
    """Of the height of the whole array on its link [m]."""

    def __post_init__(self) -> None:
        se3.check(self.T_frame_grid, "T_frame_grid")
        for name in ("rows", "columns"):
            value = getattr(self, name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | np.integer)
                or not 1 <= value <= MOST_TAXELS
            ):
                raise InvalidInput(
                    f"{name}: expected a whole number from 1 to {MOST_TAXELS}, got {checks.brief(value)}"
                )
        if self.rows * self.columns > MOST_TAXELS:
            raise InvalidInput(f"rows: expected at most {MOST_TAXELS} taxels, got {self.rows * self.columns}")
        if not FINEST <= float(checks.finite(self.pitch, "pitch", ())) <= COARSEST:
            raise InvalidInput(f"pitch: expected metres from {FINEST:g} to {COARSEST:g}, got {self.pitch:g}")
        checks.positive(self.threshold, "threshold")
        if (
            self.full_scale is not None
            and not checks.positive(self.full_scale, "full_scale") > self.threshold
        ):
            raise InvalidInput(f"full_scale: expected more than the threshold, got {self.full_scale:g}")
        checks.sigma_point(self.sigma_point, "sigma_point")
        checks.sigma_normal(self.sigma_normal, "sigma_normal")
        checks.sigma_point(self.sigma_mount, "sigma_mount")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def places_grid(self) -> Array:
        """(rows, columns, 3) where the taxels are, in the grid's frame [m]."""
        x = self.pitch * (np.arange(self.columns) - (self.columns - 1) / 2)
        y = self.pitch * (np.arange(self.rows) - (self.rows - 1) / 2)
        return np.stack([*np.meshgrid(x, y), np.zeros(self.shape)], axis=2)

    def reading(self, values: ArrayLike, name: str = "reading") -> Array:
        """(rows, columns) as floats, NaN where a taxel reads nothing; raises InvalidInput for another shape."""
        try:
            array = np.asarray(values)
        except ValueError:  # ragged
            array = np.zeros(0)
        if array.dtype.kind not in "fiu" or array.shape != self.shape:
            expected = f"expected {self.rows} rows of {self.columns} numbers"
            raise InvalidInput(f"{name}: {expected}, got {checks.brief(values)} of shape {array.shape}")
        return array.astype(np.float64)

    def touch(self, values: ArrayLike, baseline: ArrayLike = 0.0) -> "SkinTouch":
        """What readings (rows, columns) say: which taxels are pressed, and which are not.

        `baseline`: what they read untouched, a number or (rows, columns); NaN there or in the readings: a taxel that
        says nothing. Nor does one at infinity. Raises InvalidInput.
        """
        reading = self.reading(values)
        if np.shape(baseline) not in ((), self.shape):
            expected = f"expected a number or {self.rows} rows of {self.columns}"
            raise InvalidInput(f"baseline: {expected}, got shape {np.shape(baseline)}")
        felt = reading - np.asarray(baseline, dtype=np.float64)
        known = np.isfinite(felt)
        felt = np.where(known, felt, 0.0)
        if self.full_scale is not None:
            felt = np.where(known & (reading >= self.full_scale), self.full_scale, felt)
        over = known & (felt >= self.threshold)
        alone = over & ~_around(over, 2).any(axis=0)
        if over.sum() > alone.sum():  # where others are pressed together it is stuck
            known, over = known & ~alone, over & ~alone
        pressed = over & (felt >= COVERED * _around(felt, 1).max(axis=0))
        return SkinTouch(self, pressed, known & ~_between(over))


def _between(touched: Mask) -> Mask:
    """(rows, columns) those that are touched, or between two that are, in a row or a column.

    What lies on the skin covers them: they are dead, or lower than the others.
    """
    found = np.zeros_like(touched)
    for axis in (0, 1):
        before = np.maximum.accumulate(touched, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(touched, axis), axis=axis), axis)
        found |= before & after
    return found


def _around(values: NDArray[Any], reach: int) -> NDArray[Any]:
    """(n, rows, columns) the values of each taxel's neighbours up to so many taxels away, 0 beyond the rim."""
    rows, columns = values.shape
    wide, size = np.pad(values, reach), 2 * reach + 1
    steps = [(i, j) for i in range(size) for j in range(size) if (i, j) != (reach, reach)]
    return np.stack([wide[i : i + rows, j : j + columns] for i, j in steps])


@dataclass(frozen=True, slots=True, eq=False)
class SkinTouch:
    """Where an array is touched at one instant."""

    array: TaxelArray = field(repr=False)
    pressed: Mask
    """(rows, columns)"""
    untouched: Mask
    """(rows, columns); what is neither, says nothing."""

    def contacts(self, T_palm_frame: ArrayLike) -> Contacts | None:
        """The pressed taxels as contacts, at most MOST_CONTACTS; None where there is none.

        `T_palm_frame` (4, 4): where the link is. How well they are known among themselves: where the whole array is
        wrong, all are alike, which `handsight.correction.Outside.of_skin` knows.
        """
        array, T_palm_grid = self.array, self._T_palm_grid(T_palm_frame)
        places = array.places_grid[self.pressed]
        if not len(places):
            return None
        points, R = se3.apply(T_palm_grid, places[_apart(places, MAX_CONTACTS)]), T_palm_grid[:3, :3]
        sideways = array.pitch**2 / 12
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = R @ np.diag([sideways, sideways, array.sigma_point**2]) @ R.T
        covariance[3:, 3:] = array.sigma_normal**2 * np.eye(3)
        n = len(points)
        return Contacts(points, np.tile(-R[:, 2], (n, 1)), covariance=np.tile(covariance, (n, 1, 1)))

    def outside(self, T_palm_frame: ArrayLike) -> Array:
        """(m, 3) points in the palm that cannot be inside the object: RAISED above the untouched taxels [m]."""
        places = self.array.places_grid[self.untouched] + [0.0, 0.0, CLEARANCE]
        return se3.apply(self._T_palm_grid(T_palm_frame), places)

    def _T_palm_grid(self, T_palm_frame: ArrayLike) -> Array:
        return np.asarray(se3.check(T_palm_frame, "T_palm_frame") @ self.array.T_frame_grid)


def _apart(places: Array, count: int) -> Indices:
    """At most `count` of places (n, 3), each next one farthest from those before: the rim first."""
    if len(places) <= count:
        return np.arange(len(places))
    chosen = [int(np.argmax(((places - places.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = np.full(len(places), np.inf)
    for _ in range(count - 1):
        nearest = np.minimum(nearest, ((places - places[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.array(chosen)
