"""Tactile surfaces: the taxels of one link, on a flat grid or on any curved surface, and what their readings say.

A reading has one number a taxel, its pressure, or three: the force on it along the taxel's own x and y, and into the
skin. Pressed taxels that touch each other are a patch. Where the surface is flat, each pressed taxel is a contact with
the surface's normal, as a face may lie on it; where it is curved, a patch is one contact, at its centre of pressure. An
untouched taxel is a point that the object does not cover. A dead, stuck or half covered taxel is no evidence.

A gel, whose readings are indentations, is a surface whose taxels are where it was pressed to, with the normals that its
slope gives them. A pad, which is touched somewhere or not, is one taxel as large as it.

Frame `grid` of a flat grid: origin in its middle, x along a row (the column's number grows), y along a column (the
row's number grows), +z out of the skin.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array, Indices, Mask
from handsight.contact.contacts import Contacts
from handsight.contact.kernels.taxel_records import (
    FAR,
    LOW,
    NEAR,
    PATCH,
    PRESSED,
    SURFACE,
    TAXEL,
    UNTOUCHED,
    WIDE,
)
from handsight.contact.soft_skin import sink
from handsight.errors import InvalidInput
from handsight.representation import short_repr

MAX_CONTACTS = 32
MAX_PATCHES = 16
"""Most contacts of a surface's flat patches, the pressed taxels that are farthest from each other; and most patches."""
CLEARANCE = 5e-4
"""Height above an untouched taxel at which there is no object, as a face that lies on the skin is at no depth in it
[m]. A can's side is that high 6 mm beside the line where it touches."""
GIVES = 2e-8
"""How much skin gives way to pressure, one standard deviation [m/Pa]: 1.5 mm of rubber 1.7e-8, 5 mm of foam 1e-7."""
MOST_TAXELS = 4096
FLAT = math.radians(3)
"""Taxels of one surface at most; the angle up to which normals are parallel [rad]."""
LARGEST_PITCH = 0.1
"""Between taxels, and the diagonal of a pad on a palm [m]."""
PIXELS = "a whole number of rows and columns of pixels for each taxel (set rows, columns and pitch by it)"
"""What an image of a gel must have."""
MOST_NEAR = 64
"""Taxels around one among which its neighbours are chosen: the 24 within 2.9 pitches of a grid, and those that face
elsewhere on a thin link."""


class Grid(NamedTuple):
    """Layout of a flat grid of taxels."""

    T_frame_grid: Array  # (4, 4) pose of the grid in the body
    rows: int
    columns: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TactileSurface:
    """Taxels of one link of the hand; wrong fields raise InvalidInput."""

    frame: str
    """Body of the hand's file to which the taxels are fixed."""
    points: Array
    """(n, 3) positions of the taxels in the body [m]."""
    normals: Array
    """(n, 3) outward normals, of any length."""
    threshold: float
    """Least rise of a touched taxel's reading over its baseline, in the unit of the scaled readings."""
    x_axes: Array | None = None
    """(n, 3) the taxels' own x, of any length, across the normal; None: the body's x, or its y where that is along the
    normal. The taxel's y completes it to a right-handed frame."""
    components: Literal[1, 3] = 1
    """Numbers a taxel: its pressure, or its force along x, along y and into the skin."""
    indentation: bool = False
    """Whether readings are how deep the surface is pressed in [m], as images of a gel are, and no pressures."""
    area: float | None = None
    """Of a taxel [m²]; None: the square of `pitch`."""
    pitch: float = 0.0
    """Distance from taxel to taxel [m]; 0: the median distance to the third nearest taxel.

    Of a pad of one taxel it is the diagonal, which gives twice the variance of a place anywhere on it: a tilted face or
    an edge touches a pad at its rim.
    """
    full_scale: float | None = None
    """The largest scaled reading there is: such a taxel is pressed, unless it always reads that."""
    scale: ArrayLike = 1.0
    """Factor from `reading - offset` to newtons, or to the unit of the pressure: a number or one for each component."""
    offset: ArrayLike = 0.0
    """Reading of an untouched taxel, before that is measured: a number or one for each component."""
    noise: float = 0.05
    """Standard deviation of a reading, as a share of it."""
    sigma_point: float = 1.5e-4
    """Standard deviation of a taxel's height, as skin is uneven and soft [m]; sideways it is known to its cell."""
    sigma_normal: float | None = None
    """Standard deviation of a contact's normal [rad]; None: 4° on a flat surface, 0.8° on a curved one, 45° of one
    taxel, 2° by indentations, the turn of their mount included."""
    sigma_mount: float = 5e-4
    """Standard deviation of the height of the surface as a whole on its link [m]."""
    stiffness: float | None = None
    """Of the skin, pressure by depth [N/m³]: a contact of a curved surface is moved into the skin by what its force, in
    newtons, gives. None: unknown, so the contact stays on the undeformed surface, and is known the less, the harder it
    is pressed."""
    sigma_stiffness: float | None = None
    """Standard deviation of `stiffness` [N/m³]; None: half of it."""
    layout: Grid | None = None
    """The grid that the taxels are on, row by row; None: they are at any places."""
    nominal: bool = False
    """Whether the places are assumed by the number and the pitch of a product without published coordinates."""
    taxels: NDArray[np.void] = field(init=False, repr=False)
    """(n,) the taxels as records for the kernel."""
    record: NDArray[np.void] = field(init=False, repr=False)
    """(1,) the other fields as a record."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        points = checks.position(self.points, "points", (None, 3))
        n = len(points)
        if not 1 <= n <= MOST_TAXELS:
            raise InvalidInput(f"points: expected 1 to {MOST_TAXELS} taxels, got {n}")
        extent = float(np.ptp(points, axis=0).max())
        if extent > 0.5:
            raise InvalidInput(f"points: expected metres, within 0.5 m, got {extent:g} (millimetres?)")
        normals = checks.unit(self.normals, "normals", (n, 3))
        self._check_readings()
        others, distance = _nearest_taxels(points)
        if n > 1 and not distance.min() > 1e-5:
            i = int(distance.min(axis=1).argmin())
            raise InvalidInput(f"points[{i}]: expected a place of its own, got that of another taxel")
        third = np.median(distance[:, min(3, n - 1) - 1]) if n > 1 else np.inf
        pitch = checked_pitch(third if self.pitch == 0 else self.pitch)
        _check_outward(points, normals, others, distance < 1.6 * pitch)
        taxels = _records(points, self._axes(normals), others, distance, pitch)
        width = pitch + float(np.ptp(points @ taxels["axes"][0][:, :2], axis=0).min())
        flat = bool((normals @ _unit(normals.sum(axis=0)) > math.cos(FLAT)).all())
        record = self._record(pitch, width, flat)
        arrays = {"points": points, "normals": normals, "pitch": pitch, "taxels": taxels, "record": record}
        for name, array in arrays.items():
            object.__setattr__(self, name, array)

    def _check_readings(self) -> None:
        """Raises InvalidInput for fields that cannot be those of a reading, or not together."""
        if self.components not in (1, 3):
            raise InvalidInput(f"components: expected 1 or 3, got {checks.brief(self.components)}")
        if self.indentation and self.components != 1:
            raise InvalidInput("components: expected 1, as an indentation is one number, got 3")
        checks.positive(self.threshold, "threshold")
        most = self.full_scale
        if most is not None and not checks.positive(most, "full_scale") > self.threshold:
            raise InvalidInput(f"full_scale: expected more than the threshold, got {most:g}")
        if self.stiffness is None:
            return
        if self.indentation:
            raise InvalidInput("stiffness: expected none, as the indentation is measured, got one")
        checks.positive(self.stiffness, "stiffness")
        sigma = self.stiffness / 2 if self.sigma_stiffness is None else self.sigma_stiffness
        object.__setattr__(self, "sigma_stiffness", checks.positive(sigma, "sigma_stiffness"))

    def _record(self, pitch: float, width: float, flat: bool) -> NDArray[np.void]:
        """Returns what all taxels have in common (1,); raises InvalidInput. `width`: of the surface [m]."""
        record = np.ones(1, dtype=SURFACE)
        for name, value in (("scale", self.scale), ("offset", self.offset)):
            shape = (self.components,) if checks.ndim(value) else ()
            record[name][0, : self.components] = checks.finite(value, name, shape)
        if not record["scale"].all() or not 0 <= checks.finite(self.noise, "noise", ()) <= 1:
            raise InvalidInput(
                f"scale, noise: expected no 0, and a share up to 1, got {self.scale}, {self.noise}"
            )
        sigma_normal = self._usual_sigma_normal(flat) if self.sigma_normal is None else self.sigma_normal
        checks.sigma_point(self.sigma_point, "sigma_point")
        checks.sigma_point(self.sigma_mount, "sigma_mount")
        side = pitch if self.area is None else math.sqrt(checks.positive(self.area, "area"))
        record["threshold"] = self.threshold
        record["full_scale"] = np.inf if self.full_scale is None else self.full_scale
        record["pitch"] = side
        record["variance_normal"] = checks.sigma_angle(sigma_normal, "sigma_normal") ** 2
        # Two opposite sides may differ in height by the mount's error too, as soft skin gives way more where it is
        # pressed more; so the surface may also be turned. How far a gel gives way is measured.
        turns = 0.0 if self.indentation else 4 / width**2
        record["variance_mount"] = self.sigma_mount**2 * np.repeat([1.0, turns], 3)
        record["noise"] = self.noise
        record["variance_point"] = self.sigma_point**2
        record["indentation"] = self.indentation
        record["flat"] = flat
        return record

    def _usual_sigma_normal(self, flat: bool) -> float:
        """Returns the standard deviation of a contact's normal where none is given [rad]."""
        if self.is_pad:
            return math.radians(45)
        if self.indentation:
            return math.radians(2)
        return math.radians(4 if flat else 0.8)

    def _axes(self, normals: Array) -> Array:
        """Returns (n, 3, 3) the taxels' axes, in columns; raises InvalidInput for an x along the normal."""
        x = np.where(np.abs(normals[:, :1]) < 0.9, [1.0, 0, 0], [0.0, 1, 0])
        if self.x_axes is not None:
            x = checks.unit(self.x_axes, "x_axes", normals.shape)
        x = x - (x * normals).sum(axis=1)[:, None] * normals
        if (along := np.flatnonzero(np.linalg.norm(x, axis=1) < 0.05)).size:
            raise InvalidInput(
                f"x_axes[{along[0]}]: expected a direction across the normal, got one along it"
            )
        return np.stack([_unit(x), np.cross(normals, _unit(x)), normals], axis=2)

    @classmethod
    def grid(
        cls, *, frame: str, T_frame_grid: ArrayLike, rows: int, columns: int, pitch: float, **fields: Any
    ) -> Self:
        """Returns a flat grid of taxels, `pitch` apart [m]; raises InvalidInput.

        `T_frame_grid` (4, 4): pose of the grid in the body. `fields`: the other fields of a surface.
        """
        T = se3.check(T_frame_grid, "T_frame_grid")
        points = se3.apply(T, grid_places(rows, columns, pitch).reshape(-1, 3))
        x_axes, normals = (np.tile(T[:3, k], (len(points), 1)) for k in (0, 2))
        fields |= {"frame": frame, "pitch": pitch, "layout": Grid(T, int(rows), int(columns))}
        return cls(points=points, normals=normals, x_axes=x_axes, **fields)

    @property
    def is_pad(self) -> bool:
        """Whether it has one taxel, so that it is touched somewhere on it or not."""
        return len(self.points) == 1

    @property
    def is_zeroed(self) -> bool:
        """Whether a reading that is not 0 is a touch from the first one on: an indentation, or that of a pad."""
        return self.indentation or self.is_pad

    @property
    def places(self) -> tuple[int, ...]:
        """The rows and columns of a grid, or the number of taxels."""
        return (len(self.points),) if self.layout is None else self.layout[1:]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a reading: `places`, then 3 for three components."""
        return self.places if self.components == 1 else (*self.places, 3)

    def reading(self, values: ArrayLike, name: str = "reading") -> Array:
        """Returns readings of the surface's `shape` as floats, NaN for none; raises InvalidInput for another shape.

        An image of indentations may be finer than the grid: it is averaged over each taxel's block of pixels.
        """
        try:
            array = np.asarray(values)
        except ValueError:  # rows of different length
            array = np.zeros(0)
        if self.indentation and array.dtype.kind in "fiu":
            array = _means_of_blocks(array, self.shape)
        if array.dtype.kind not in "fiub" or array.shape != self.shape:
            expected = f"expected numbers of shape {self.shape}"
            if self.indentation:
                expected += f", or an image with {PIXELS}"
            raise InvalidInput(f"{name}: {expected}, got {checks.brief(values)} of shape {array.shape}")
        return array.astype(np.float64, copy=False)

    def cells(self, values: Array) -> Array:
        """Returns a checked reading as (n, components)."""
        return values.reshape(len(self.points), -1)

    def touch(self, values: ArrayLike, baseline: ArrayLike = 0.0) -> "SkinTouch":
        """Returns which taxels are pressed, which are untouched, and the patches, by readings of the surface's `shape`.

        `baseline`: the scaled readings while untouched, a number or as the readings are. A taxel with NaN or infinity
        in either is neither. Raises InvalidInput.
        """
        bases = (
            np.full(self.shape, baseline) if np.ndim(baseline) == 0 else self.reading(baseline, "baseline")
        )
        return self.sensed(self.cells(self.reading(values)), self.cells(bases))

    def sensed(self, values: Array, baseline: Array) -> "SkinTouch":
        """Returns the same as `touch`, of a checked reading and baseline (n, components)."""
        from handsight.contact.kernels.taxels import sense_taxels  # importing numba takes half a second

        n, c = values.shape
        rise = np.empty((n + 1, c))
        states = np.empty((2, n + 1), dtype=np.int64)
        patches = np.empty(MAX_PATCHES, dtype=PATCH)
        taxels = self.taxels
        if self.indentation:
            scaled = self.record["scale"][0, 0] * (values[:, 0] - self.record["offset"][0, 0])
            depth = scaled - baseline[:, 0]
            taxels = self._indented(depth)
            values = np.where(self._alone(depth), np.nan, values[:, 0])[:, None]
        count = sense_taxels(values, baseline, self.record, taxels, rise, states, patches)
        patches = patches[:count]
        sink(patches, self, GIVES)
        if self.is_zeroed:
            # A patch is one contact. A gel hangs beside an object, and a pad may bear one that it does not feel, so
            # what is not touched does not say where the object is not.
            patches["flat"] = False
            states[0][states[0] == UNTOUCHED] = FAR
        return SkinTouch(self, rise, states, patches)

    def _alone(self, depth: Array) -> Mask:
        """Returns which taxels (n,) are deep (n,) [m] without any of their neighbours being so: single wrong pixels."""
        touched = np.append(depth >= self.threshold, False)
        return np.asarray(touched[:-1] & ~touched[self.taxels["near"]].any(axis=1))

    def _indented(self, depth: Array) -> NDArray[np.void]:
        """Returns the taxels (n,) where they are pressed to by depths (n,) [m], with the normals of the surface there.

        What is beyond the layout's edge is of no interest, as places and not forces are measured.
        """
        taxels = self.taxels.copy()
        near = taxels["near"]
        known = np.append(np.isfinite(depth), False)
        depths = np.where(known, np.append(depth, 0.0), 0.0)
        around = depths[near].sum(axis=1) / known[near].sum(axis=1).clip(min=1)
        depths[:-1] = np.where(known[:-1], depths[:-1], around)
        rises = np.where(known[near], depths[near] - depths[:-1, None], 0.0)
        slopes = np.einsum("nak,nk->na", taxels["slope"], rises)
        tilts = np.einsum("nia,na->ni", taxels["axes"][:, :, :2], slopes)
        taxels["point"] -= depths[:-1, None] * self.normals
        taxels["axes"][:, :, 2] = _unit(self.normals + tilts)
        taxels["edge"] = 0.0
        return taxels


def checked_pitch(pitch: Any) -> float:
    """Returns a distance from taxel to taxel [m]; raises InvalidInput."""
    if not 2e-4 <= checks.finite(pitch, "pitch", ()) <= LARGEST_PITCH:
        raise InvalidInput(f"pitch: expected metres from 0.0002 to {LARGEST_PITCH:g}, got {pitch:g}")
    return float(pitch)


def grid_places(rows: int, columns: int, pitch: float) -> Array:
    """Returns (rows, columns, 3) positions about the middle of a flat grid, in its frame [m]; raises InvalidInput."""
    for name, value in (("rows", rows), ("columns", columns)):
        checks.integer(value, name, MOST_TAXELS, 1)
    if rows * columns > MOST_TAXELS:
        raise InvalidInput(f"rows: expected at most {MOST_TAXELS} taxels, got {rows * columns}")
    x, y = (checked_pitch(pitch) * (np.arange(count) - (count - 1) / 2) for count in (columns, rows))
    return np.stack([*np.meshgrid(x, y), np.zeros((rows, columns))], axis=2)


def block(sizes: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, int] | None:
    """Returns the pixels (rows, columns) that a taxel of a grid has in an image; None where they are no whole numbers.

    `sizes`: of the image; `shape`: rows and columns of the grid.
    """
    if len(sizes) != 2 or len(shape) != 2:
        return None
    rows, rest_of_rows = divmod(sizes[0], shape[0])
    columns, rest_of_columns = divmod(sizes[1], shape[1])
    if rest_of_rows or rest_of_columns or not rows or not columns:
        return None
    return rows, columns


def _means_of_blocks(image: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Returns means of an image over blocks of pixels, NaN where less than half of a block is known.

    What is no image of the grid, of this `shape`, is returned as it is.
    """
    sides = block(image.shape, shape)
    if sides is None or sides == (1, 1):
        return image
    blocks = image.reshape(shape[0], sides[0], shape[1], sides[1])
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    return np.where(2 * count >= math.prod(sides), total / count.clip(min=1), np.nan)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True).clip(min=1e-12))


def _nearest_taxels(points: Array) -> tuple[Indices, Array]:
    """Returns the nearest others of each taxel (n, k), nearest first, and their distances (n, k) [m]."""
    from scipy.spatial import cKDTree  # its import is long

    n = len(points)
    _, found = cKDTree(points).query(points, k=min(n, MOST_NEAR + 1))
    others = found.reshape(n, -1)
    distance = np.linalg.norm(points[:, None] - points[others], axis=2)
    distance[others == np.arange(n)[:, None]] = -1.0  # itself, which goes first
    order = np.lexsort((others, distance), axis=1)[:, 1:]  # equally far ones by their number
    return np.take_along_axis(others, order, axis=1), np.take_along_axis(distance, order, axis=1)


def _check_outward(points: Array, normals: Array, others: Indices, near: Mask) -> None:
    """Raises InvalidInput for normals that point into the link. `near`: which of the `others` are neighbours (n, k)."""
    cosines = np.einsum("nkj,nj->nk", normals[others], normals)
    wrong = np.flatnonzero((near * cosines).sum(axis=1) < -0.5 * near.sum(axis=1).clip(min=1))
    if len(wrong):
        raise InvalidInput(
            f"normals[{wrong[0]}]: expected one that points out of the link, got one against its neighbours'"
        )
    # A surface whose normals point outward is the wider, the farther out it is; a palm may be a little hollow.
    arms = points - points.mean(axis=0)
    if (normals * arms).sum() < -0.3 * np.linalg.norm(arms, axis=1).sum():
        raise InvalidInput("normals: expected ones that point out of the link, got ones that point into it")


def _slope_weights(taxels: NDArray[np.void], pitch: float) -> Array:
    """Returns (n, 2, 8) the weights of the neighbours' rises over a taxel in the slope along its x and y.

    The slope is that of least squares, with a weak pull to none; on a grid it is a central difference.
    """
    near = taxels["near"]
    there = near < len(taxels)
    points = np.append(taxels["point"], np.zeros((1, 3)), axis=0)
    arms = (points[near] - taxels["point"][:, None]) @ taxels["axes"][:, :, :2]
    arms[~there] = 0.0
    transposed = arms.swapaxes(1, 2)
    return np.linalg.solve(transposed @ arms + 1e-2 * pitch**2 * np.eye(2), transposed)


def _records(points: Array, axes: Array, others: Indices, distance: Array, pitch: float) -> NDArray[np.void]:
    """Returns TAXEL records (n,), with their neighbours among the `others`; those that face elsewhere do not count."""
    n = len(points)
    normals = axes[:, :, 2]
    records = np.zeros(n, dtype=TAXEL)
    records["point"] = points
    records["axes"] = axes
    records["beside"] = n
    facing = np.einsum("nkj,nj->nk", normals[others], normals) > 0.3
    for name, reach, most in (("near", 1.5, NEAR), ("wide", 2.9, WIDE)):
        reached = np.where(facing & (distance < reach * pitch), distance, np.inf)
        order = np.argsort(reached, axis=1, kind="stable")[:, :most]
        chosen = np.take_along_axis(others, order, axis=1)
        known = np.isfinite(np.take_along_axis(reached, order, axis=1))
        records[name] = n
        records[name][:, : chosen.shape[1]] = np.where(known, chosen, n)
    for i, row in enumerate(records):
        near = row["near"][row["near"] < n]
        if not len(near):
            continue
        row["edge"] = _unit(points[near] - points[i]).mean(axis=0)
        arms = (points[near] - points[i]) @ axes[i][:, :2]
        for k, along in enumerate((-arms[:, 0], arms[:, 0], -arms[:, 1], arms[:, 1])):
            cosine = along / np.linalg.norm(arms, axis=1).clip(min=1e-12)
            row["beside"][k] = near[cosine.argmax()] if cosine.max() > 0.85 else n
    records["slope"] = _slope_weights(records, pitch)
    records["bend"] = _bends(records)
    return records


def _bends(taxels: NDArray[np.void]) -> Array:
    """Returns (n, 3, 3) the change of the normal by that of the point, across the normal [1/m]."""
    near = taxels["near"]
    across = taxels["axes"][:, :, :2]
    normals = np.append(taxels["axes"][:, :, 2], np.zeros((1, 3)), axis=0)
    turns = (normals[near] - normals[:-1, None]) @ across
    K = taxels["slope"] @ turns
    return np.asarray(across @ K.swapaxes(1, 2) @ across.swapaxes(1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class SkinTouch:
    """Which taxels of a surface are touched at one instant."""

    surface: TactileSurface = field(repr=False)
    rise: Array = field(repr=False)
    """(n + 1, components) scaled readings over the baseline, 0 where unknown and in the last row; those of dead taxels
    within a patch are estimated from their neighbours'."""
    states: Indices = field(repr=False)
    """(2, n + 1) what each taxel says, and the number of its patch, -1 for none (`kernels/taxel_records.py`)."""
    patches: NDArray[np.void] = field(repr=False)
    """(p,) records PATCH of taxels that touch each other, in the link."""

    @property
    def pressed(self) -> Mask:
        """(rows, columns) or (n,) taxels that are contacts, by themselves or as a part of a patch."""
        return np.reshape(self.states[0, :-1] == PRESSED, self.surface.places)

    @property
    def untouched(self) -> Mask:
        """The taxels that nothing covers; those that are neither are no evidence."""
        return np.reshape(self.states[0, :-1] >= UNTOUCHED, self.surface.places)

    @property
    def strongest(self) -> int:
        """The number of the patch that bears most."""
        return int(self.patches["total"].argmax()) if len(self.patches) > 1 else 0

    @property
    def wrench(self) -> Array:
        """(6,) force [N] of the object on the surface, and its torque about the link's origin [N m], in the link.

        They are NaN where what is pressed measures no force: pressure alone, or taxels at their full scale.
        """
        return np.asarray(self.patches["wrench"].sum(axis=0)) if len(self.patches) else np.zeros(6)

    def contacts(
        self, T_palm_frame: ArrayLike, by_error: ArrayLike | None = None, without: int = -1
    ) -> Contacts | None:
        """Returns the contacts in the palm; None without a pressed taxel.

        Of flat patches they are at most `MAX_CONTACTS` pressed taxels, of the others their centres of pressure.
        `T_palm_frame` (4, 4): the pose of the link. `by_error` (6, j): the shift [m] and the turn [rad] of the link by
        one standard deviation of each of j joint errors. `without`: the number of a patch to leave out. The covariances
        of flat patches are without the error that the taxels have in common (`sigmas_common`), but for its turn.
        """
        surface = self.surface
        T = se3.check(T_palm_frame, "T_palm_frame")
        chosen = np.flatnonzero(self._spread(without))
        patches = self.patches[~self.patches["flat"] & (np.arange(len(self.patches)) != without)]
        if not len(chosen) and not len(patches):
            return None
        chosen = chosen[_farthest_points(surface.points[chosen], MAX_CONTACTS)]
        record = surface.record[0]
        n = len(chosen)
        C = np.zeros((n + len(patches), 6, 6))
        if n:
            C[:n] = self._covariances(chosen)
        C[n:] = patches["covariance"] + np.diag(record["variance_mount"])
        points = se3.apply(T, np.concatenate([surface.points[chosen], patches["point"]]))
        normals = np.concatenate([-surface.normals[chosen], patches["normal"]]) @ T[:3, :3].T
        C = se3.rotate_covariance(T[:3, :3], C)
        if by_error is None:
            return Contacts(points, normals, covariance=C)
        for k in range(n, len(C)):
            J = np.array(by_error)
            J[:3] -= se3.skew(points[k] - T[:3, 3]) @ J[3:]
            J[3:] = -se3.skew(normals[k]) @ J[3:]
            C[k] += J @ J.T
        return Contacts(points, normals, covariance=C)

    def _covariances(self, chosen: Indices) -> Array:
        """Returns covariances (n, 6, 6) of pressed taxels of flat patches as contacts, in the link.

        The surface may be turned, and a body that is turned into it is deeper where it presses more, by as much as the
        skin gives way. Contacts have either error as often as there are contacts, as together they do not average it.
        """
        taxels = self.surface.taxels[chosen]
        record = self.surface.record[0]
        n = len(chosen)
        height, turn = record["variance_mount"][[0, 3]]
        arms = taxels["point"] - taxels["point"].mean(axis=0)
        stronger = arms @ np.linalg.lstsq(arms, self.rise[chosen, -1], rcond=1e-6)[0]  # than the mean, evenly
        deeper = np.minimum((GIVES * stronger / record["pitch"] ** 2) ** 2, height)
        variances = np.full((n, 1, 3), record["pitch"] ** 2 / 12)
        C = np.zeros((n, 6, 6))
        variances[:, 0, 2] = record["variance_point"] + n * deeper
        C[:, :3, :3] = (taxels["axes"] * variances) @ taxels["axes"].swapaxes(1, 2)
        C[:, 3:, 3:] = (record["variance_normal"] + n * turn) * np.eye(3)
        return C

    def _spread(self, without: int = -1) -> Mask:
        """Returns the taxels (n + 1,) that are contacts by themselves: the pressed ones of flat patches."""
        flat = np.append(self.patches["flat"], False)  # the last one is of taxels without a patch
        flat[without] = False
        return np.asarray((self.states[0] == PRESSED) & flat[self.states[1]])

    def sigmas_common(self, by_error: ArrayLike | None = None, without: int = -1) -> Array:
        """Returns (6,) one standard deviation per axis of the common error of contacts of flat patches, shift [m] and
        turn [rad]; zeros where there is none. The arguments are those of `contacts`."""
        if not self._spread(without).any():
            return np.zeros(6)
        variance = self.surface.record[0]["variance_mount"]
        more = 0.0 if by_error is None else (np.asarray(by_error) ** 2).sum(axis=1)
        return np.asarray(np.sqrt(variance + more))

    @property
    def sigma_clearance(self) -> float:
        """The standard deviation of `CLEARANCE` [m], by which a face that lies on an untouched taxel is as improbable
        as that a covered taxel is not touched, being lower than others: by the share of such ones between touched
        ones, to which one in four is added. It is 0.3 mm where none is touched."""
        state = self.states[0]
        share = ((state == LOW).sum() + 1) / (((state >= LOW) & (state < UNTOUCHED)).sum() + 4)
        return float(CLEARANCE / math.sqrt(-2 * math.log(share)))

    def outside(self, T_palm_frame: ArrayLike) -> Array:
        """Returns points (m, 3) in the palm that are not in the object: `CLEARANCE` above untouched taxels [m].

        Of a curved surface they are of taxels beside a patch only, as the object is near nowhere else.
        """
        taxels = self.surface.taxels[np.flatnonzero(self.states[0, :-1] == UNTOUCHED)]
        points = taxels["point"] + CLEARANCE * taxels["axes"][:, :, 2]
        return se3.apply(se3.check(T_palm_frame, "T_palm_frame"), points)


def _farthest_points(places: Array, count: int) -> Indices:
    """Returns at most `count` of n places (n, 3), each farthest from those before (farthest-point sampling)."""
    from handsight._compiled.spreading import snapped, spread_out  # importing numba takes half a second

    if len(places) <= count:
        return np.arange(len(places))
    features = np.hstack([places, np.zeros_like(places)])
    return np.asarray(snapped(features, spread_out(features, count, 0)))
