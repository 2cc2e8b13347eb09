"""Tactile arrays: a flat grid of taxels on a link, and the evidence of its readings on the object's pose.

Frame `grid`: origin in the middle of the grid, x along a row (the column's number grows), y along a column (the row's
number grows), +z out of the skin, towards what touches the skin. A pressed taxel is a contact with the link's normal;
an untouched one is a point that the object does not cover. A dead, stuck or half covered taxel is no evidence.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array, Indices, Mask
from handsight.contact.contacts import Contacts
from handsight.errors import InvalidInput
from handsight.representation import short_repr

MAX_CONTACTS = 32
"""Contacts of one array at most: the pressed taxels that are farthest from each other."""
CLEARANCE, SIGMA_CLEARANCE = 5e-4, 3e-4
"""Height above an untouched taxel at which there is no object, as a face that lies on the skin is at no depth in it,
and its standard deviation [m]. A can's side is that high 6 mm beside the line where it touches."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TaxelArray:
    """A `TaxelArray` is a flat grid of taxels on a link of the hand; wrong fields raise InvalidInput."""

    frame: str
    """Body of the hand's file to which the array is fixed."""
    T_frame_grid: Array
    """(4, 4) pose of the grid in the body."""
    rows: int
    columns: int
    pitch: float
    """Distance from taxel to taxel, along rows and columns [m]."""
    threshold: float
    """Least rise of a touched taxel's reading over its baseline, in the unit of the readings."""
    full_scale: float | None = None
    """The largest reading there is: such a taxel is pressed, unless it always reads that."""
    sigma_point: float = 1.5e-4
    """Standard deviation of a taxel's height, as skin is uneven and soft [m]; sideways it is known to its cell."""
    sigma_normal: float = np.deg2rad(4.0)
    """Standard deviation of a contact's normal [rad]."""
    sigma_mount: float = 5e-4
    """Standard deviation of the height of the array as a whole on its link [m]."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        se3.check(self.T_frame_grid, "T_frame_grid")
        most = 4096  # taxels
        for name in ("rows", "columns"):
            value = getattr(self, name)
            integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not integer or not 1 <= value <= most:
                expected = f"expected a whole number from 1 to {most}"
                raise InvalidInput(f"{name}: {expected}, got {checks.brief(value)}")
        if self.rows * self.columns > most:
            raise InvalidInput(f"rows: expected at most {most} taxels, got {self.rows * self.columns}")
        if not 2e-4 <= float(checks.finite(self.pitch, "pitch", ())) <= 0.05:
            raise InvalidInput(f"pitch: expected metres from 0.0002 to 0.05, got {self.pitch:g}")
        checks.positive(self.threshold, "threshold")
        most_read = self.full_scale
        if most_read is not None and not checks.positive(most_read, "full_scale") > self.threshold:
            raise InvalidInput(f"full_scale: expected more than the threshold, got {most_read:g}")
        checks.sigma_point(self.sigma_point, "sigma_point")
        checks.sigma_normal(self.sigma_normal, "sigma_normal")
        checks.sigma_point(self.sigma_mount, "sigma_mount")

    @property
    def shape(self) -> tuple[int, int]:
        """The number of rows and of columns."""
        return self.rows, self.columns

    @property
    def places_grid(self) -> Array:
        """(rows, columns, 3) positions of the taxels in the grid's frame [m]."""
        x = self.pitch * (np.arange(self.columns) - (self.columns - 1) / 2)
        y = self.pitch * (np.arange(self.rows) - (self.rows - 1) / 2)
        return np.stack([*np.meshgrid(x, y), np.zeros(self.shape)], axis=2)

    def reading(self, values: ArrayLike, name: str = "reading") -> Array:
        """Returns readings (rows, columns) as floats, NaN for none; raises InvalidInput for another shape."""
        try:
            array = np.asarray(values)
        except ValueError:  # rows of different length
            array = np.zeros(0)
        if array.dtype.kind not in "fiu" or array.shape != self.shape:
            expected = f"expected {self.rows} rows of {self.columns} numbers"
            raise InvalidInput(f"{name}: {expected}, got {checks.brief(values)} of shape {array.shape}")
        return array.astype(np.float64)

    def touch(self, values: ArrayLike, baseline: ArrayLike = 0.0) -> "SkinTouch":
        """Returns which taxels are pressed, and which are untouched, by their readings (rows, columns).

        `baseline`: their readings while untouched, a number or (rows, columns). A taxel with NaN or infinity in either
        is neither. Raises InvalidInput.
        """
        reading = self.reading(values)
        if np.shape(baseline) not in ((), self.shape):
            expected = f"expected a number or {self.rows} rows of {self.columns}"
            raise InvalidInput(f"baseline: {expected}, got shape {np.shape(baseline)}")
        rise = reading - np.asarray(baseline, dtype=np.float64)
        known = np.isfinite(rise)
        rise = np.where(known, rise, 0.0)
        if self.full_scale is not None:
            rise = np.where(known & (reading >= self.full_scale), self.full_scale, rise)
        touched = known & (rise >= self.threshold)
        isolated = touched & ~_neighbours(touched, 2).any(axis=0)
        if touched.sum() > isolated.sum():  # while others are touched together, an isolated one is stuck
            known, touched = known & ~isolated, touched & ~isolated
        # With less than half of its strongest neighbour's rise, a taxel may be touched at its rim only.
        pressed = touched & (rise >= 0.5 * _neighbours(rise, 1).max(axis=0))
        # Taxels between touched ones are covered too: they are dead, or lower than the others.
        covered = np.zeros_like(touched)
        for axis in (0, 1):
            before = np.maximum.accumulate(touched, axis=axis)
            after = np.flip(np.maximum.accumulate(np.flip(touched, axis), axis=axis), axis)
            covered |= before & after
        return SkinTouch(self, pressed, known & ~covered)


def _neighbours(values: Array | Mask, distance: int) -> Array:
    """Returns (n, rows, columns) the values of each taxel's neighbours within `distance` taxels, 0 beyond the rim."""
    rows, columns = values.shape
    padded, size = np.pad(values, distance), 2 * distance + 1
    shifts = [(i, j) for i in range(size) for j in range(size) if (i, j) != (distance, distance)]
    return np.stack([padded[i : i + rows, j : j + columns] for i, j in shifts])


@dataclass(frozen=True, slots=True, eq=False)
class SkinTouch:
    """A `SkinTouch` says which taxels of an array are touched at one instant."""

    array: TaxelArray = field(repr=False)
    pressed: Mask
    """(rows, columns) taxels that are contacts."""
    untouched: Mask
    """(rows, columns) taxels that nothing covers; those that are neither are no evidence."""

    def contacts(self, T_palm_frame: ArrayLike) -> Contacts | None:
        """Returns the pressed taxels as contacts in the palm, at most `MAX_CONTACTS`; None without a pressed one.

        `T_palm_frame` (4, 4): the pose of the link. Their covariances are without the array's common error
        `sigma_mount`, which `handsight.SkinEvidence.of` adds.
        """
        array, T_palm_grid = self.array, self._T_palm_grid(T_palm_frame)
        places = array.places_grid[self.pressed]
        if not len(places):
            return None
        points = se3.apply(T_palm_grid, places[_farthest_points(places, MAX_CONTACTS)])
        R = T_palm_grid[:3, :3]
        sideways = array.pitch**2 / 12
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = R @ np.diag([sideways, sideways, array.sigma_point**2]) @ R.T
        covariance[3:, 3:] = array.sigma_normal**2 * np.eye(3)
        n = len(points)
        return Contacts(points, np.tile(-R[:, 2], (n, 1)), covariance=np.tile(covariance, (n, 1, 1)))

    def outside(self, T_palm_frame: ArrayLike) -> Array:
        """Returns points (m, 3) in the palm that are not in the object: `CLEARANCE` above untouched taxels [m]."""
        places = self.array.places_grid[self.untouched] + [0.0, 0.0, CLEARANCE]
        return se3.apply(self._T_palm_grid(T_palm_frame), places)

    def _T_palm_grid(self, T_palm_frame: ArrayLike) -> Array:
        return np.asarray(se3.check(T_palm_frame, "T_palm_frame") @ self.array.T_frame_grid)


def _farthest_points(places: Array, count: int) -> Indices:
    """Returns at most `count` of n places (n, 3), each farthest from those before (farthest-point sampling)."""
    if len(places) <= count:
        return np.arange(len(places))
    chosen = [int(np.argmax(((places - places.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = np.full(len(places), np.inf)
    for _ in range(count - 1):
        nearest = np.minimum(nearest, ((places - places[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.array(chosen)
