"""Tactile surfaces: the taxels of one link, on a flat grid or on any curved surface, and what their readings say.

A reading has one number a taxel, its pressure, or three: the force on it along the taxel's own x and y, and into the
skin. Pressed taxels that touch each other are a patch. Where the surface is flat, each pressed taxel is a contact with
the surface's normal, as a face may lie on it; where it is curved, a patch is one contact, at its centre of pressure. An
untouched taxel is a point that the object does not cover. A dead, stuck or half covered taxel is no evidence.

Frame `grid` of a flat grid: origin in its middle, x along a row (the column's number grows), y along a column (the
row's number grows), +z out of the skin.
"""

import math
import warnings
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.touch.taxels import (
    NEAR,
    PATCH,
    PRESSED,
    RIM,
    SURFACE,
    TAXEL,
    UNTOUCHED,
    WIDE,
    sense_taxels,
)
from handsight.checks import Array, Indices, Mask
from handsight.contact.contacts import Contacts
from handsight.errors import InvalidInput
from handsight.representation import short_repr

MAX_CONTACTS = 32
"""Contacts of one surface at most: the pressed taxels that are farthest from each other."""
MAX_PATCHES = 16
"""Patches of one surface at most."""
CLEARANCE, SIGMA_CLEARANCE = 5e-4, 3e-4
"""Height above an untouched taxel at which there is no object, as a face that lies on the skin is at no depth in it,
and its standard deviation [m]. A can's side is that high 6 mm beside the line where it touches."""
MOST_TAXELS = 4096


class Grid(NamedTuple):
    """A `Grid` is the layout of a flat grid of taxels."""

    T_frame_grid: Array
    """(4, 4) pose of the grid in the body."""
    rows: int
    columns: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TactileSurface:
    """A `TactileSurface` has the taxels of one link of the hand; wrong fields raise InvalidInput."""

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
    area: float | None = None
    """Of a taxel [m²]; None: the square of `pitch`."""
    pitch: float | None = None
    """Distance from taxel to taxel [m]; None: the median of those to the nearest neighbour."""
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
    """Standard deviation of a contact's normal [rad]; None: 4° on a flat surface, 1° on a curved one."""
    sigma_mount: float = 5e-4
    """Standard deviation of the height of the surface as a whole on its link [m]."""
    layout: Grid | None = None
    """The grid that the taxels are on, row by row; None: they are at any places."""
    nominal: bool = False
    """Whether the places are built from counts and pitch, as the maker has published no coordinates."""
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
        if (extent := float(np.ptp(points, axis=0).max())) > 0.5:
            raise InvalidInput(
                f"points: expected metres within 0.5 of each other, got {extent:g} (millimetres?)"
            )
        if self.normals is None or len(self.normals) != n:
            came = "none" if self.normals is None else len(self.normals)
            raise InvalidInput(f"normals: expected one for each of {n} taxels, got {came}")
        normals = checks.unit(self.normals, "normals", (n, 3))
        if self.components not in (1, 3):
            raise InvalidInput(f"components: expected 1 or 3, got {checks.brief(self.components)}")
        distance = np.linalg.norm(points[:, None] - points, axis=2)
        np.fill_diagonal(distance, np.inf)
        if n > 1 and not distance.min() > 1e-5:
            i = int(distance.min(axis=1).argmin())
            raise InvalidInput(f"points[{i}]: expected a place of its own, got that of another taxel")
        pitch = self.pitch
        if pitch is None:
            if n == 1:
                raise InvalidInput("pitch: expected metres for a single taxel, got none")
            pitch = float(np.median(distance.min(axis=1)))
        if not 2e-4 <= float(checks.finite(pitch, "pitch", ())) <= 0.05:
            raise InvalidInput(f"pitch: expected metres from 0.0002 to 0.05, got {pitch:g}")
        _check_outward(points, normals, distance < 1.6 * pitch)
        checks.positive(self.threshold, "threshold")
        most = self.full_scale
        if most is not None and not checks.positive(most, "full_scale") > self.threshold:
            raise InvalidInput(f"full_scale: expected more than the threshold, got {most:g}")
        area = pitch**2 if self.area is None else checks.positive(self.area, "area")
        if not area < 2.5e-3:
            raise InvalidInput(f"area: expected square metres below 0.0025, got {area:g}")
        numbers = {
            name: _by_component(getattr(self, name), name, self.components) for name in ("scale", "offset")
        }
        if not numbers["scale"].all():
            raise InvalidInput("scale: expected numbers other than 0, got 0")
        noise = checks.finite(self.noise, "noise", ())
        if not 0 <= noise <= 1:
            raise InvalidInput(f"noise: expected a share from 0 to 1, got {noise:g}")
        checks.sigma_point(self.sigma_point, "sigma_point")
        flat = bool((normals @ _unit(normals.sum(axis=0)) > math.cos(math.radians(3.0))).all())
        sigma_normal = math.radians(4.0 if flat else 1.0) if self.sigma_normal is None else self.sigma_normal
        checks.sigma_normal(sigma_normal, "sigma_normal")
        checks.sigma_point(self.sigma_mount, "sigma_mount")
        taxels = _taxel_records(points, _axes(normals, self.x_axes), distance, pitch)
        record = np.zeros(1, dtype=SURFACE)
        for name, value in (numbers | {"threshold": self.threshold, "noise": noise, "cell": area}).items():
            record[name] = value
        record["full_scale"] = np.inf if most is None else most
        record["variance_point"], record["variance_normal"] = self.sigma_point**2, sigma_normal**2
        # Two opposite sides may differ in height by the mount's error too, as soft skin gives way more where it is
        # pressed more; so the surface may also be turned.
        along = np.ptp(points @ taxels["axes"][0][:, :2], axis=0)
        turn = 2 * self.sigma_mount / (pitch + float(along.min()))
        record["variance_mount"] = np.repeat([self.sigma_mount**2, turn**2], 3)
        record["flat"] = flat
        values = {"points": points, "normals": normals, "pitch": pitch, "taxels": taxels, "record": record}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def grid(
        cls, *, frame: str, T_frame_grid: ArrayLike, rows: int, columns: int, pitch: float, **fields: object
    ) -> "TactileSurface":
        """Returns a flat grid of taxels, `pitch` apart [m]; raises InvalidInput.

        `T_frame_grid` (4, 4): pose of the grid in the body. `fields`: the other fields of a surface.
        """
        T = se3.check(T_frame_grid, "T_frame_grid")
        places_grid = grid_points(rows, columns, pitch).reshape(-1, 3)
        n = len(places_grid)
        return cls(
            frame=frame,
            points=se3.apply(T, places_grid),
            normals=np.tile(T[:3, 2], (n, 1)),
            x_axes=np.tile(T[:3, 0], (n, 1)),
            pitch=pitch,
            layout=Grid(T, int(rows), int(columns)),
            **fields,  # type: ignore[arg-type]
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a reading: rows and columns, or the number of taxels; then 3 for three components."""
        places = (len(self.points),) if self.layout is None else self.layout[1:]
        return places if self.components == 1 else (*places, 3)

    @property
    def T_frame_grid(self) -> Array:
        """(4, 4) pose of the grid in the body; raises InvalidInput where the taxels are on none."""
        return self._grid().T_frame_grid

    @property
    def places_grid(self) -> Array:
        """(rows, columns, 3) positions of the taxels in the grid's frame [m]; raises InvalidInput as `T_frame_grid`."""
        rows, columns = self._grid()[1:]
        return grid_points(rows, columns, self.pitch or 0.0)

    @property
    def size_text(self) -> str:
        """The number of taxels and their distance, for a person."""
        places = " x ".join(map(str, self.shape[:2] if self.layout else self.shape[:1]))
        kind = f"{'three-axis ' if self.components == 3 else ''}taxels{' (nominal places)' if self.nominal else ''}"
        return f"{places} {kind}, {1e3 * (self.pitch or 0.0):.3g} mm apart"

    def _grid(self) -> Grid:
        if self.layout is None:
            raise InvalidInput("layout: expected a grid, got taxels at any places")
        return self.layout

    def reading(self, values: ArrayLike, name: str = "reading") -> Array:
        """Returns readings of the surface's `shape` as floats, NaN for none; raises InvalidInput for another shape."""
        try:
            array = np.asarray(values)
        except ValueError:  # rows of different length
            array = np.zeros(0)
        if array.dtype.kind not in "fiu" or array.shape != self.shape:
            came = f"got {checks.brief(values)} of shape {array.shape}"
            raise InvalidInput(f"{name}: expected {self._shape_text()}, {came}")
        return array.astype(np.float64)

    def _shape_text(self) -> str:
        each = "numbers" if self.components == 1 else "times 3 numbers"
        if self.layout is None:
            return f"{len(self.points)} {each}"
        return f"{self.layout.rows} rows of {self.layout.columns} {each}"

    def touch(self, values: ArrayLike, baseline: ArrayLike = 0.0) -> "SkinTouch":
        """Returns which taxels are pressed, which are untouched, and the patches, by readings of the surface's `shape`.

        `baseline`: the scaled readings while untouched, a number or of that shape. A taxel with NaN or infinity in
        either is neither. Raises InvalidInput.
        """
        if np.shape(baseline) not in ((), self.shape):
            expected = f"expected a number or {self._shape_text().removesuffix(' numbers')}"
            raise InvalidInput(f"baseline: {expected}, got shape {np.shape(baseline)}")
        n = len(self.points)
        bases = np.broadcast_to(np.asarray(baseline, dtype=np.float64), self.shape).reshape(n, -1)
        return self.sensed(self.reading(values).reshape(n, -1), bases)

    def sensed(self, values: Array, baseline: Array) -> "SkinTouch":
        """Returns the same as `touch`, of a checked reading and baseline (n, components)."""
        rise, states = np.empty_like(values), np.empty((2, len(values)), dtype=np.int64)
        patches = np.empty(MAX_PATCHES, dtype=PATCH)
        count = sense_taxels(values, baseline, self.record, self.taxels, rise, states, patches)
        return SkinTouch(self, rise, states, patches[:count])


def TaxelArray(**fields: object) -> TactileSurface:
    """Returns a flat grid of taxels. Deprecated: it is `TactileSurface.grid`."""
    warnings.warn("TaxelArray is now TactileSurface.grid", DeprecationWarning, 2)
    return TactileSurface.grid(**fields)  # type: ignore[arg-type]


def grid_points(rows: int, columns: int, pitch: float) -> Array:
    """Returns (rows, columns, 3) positions about the middle of a flat grid, in its frame [m]; raises InvalidInput."""
    for name, value in (("rows", rows), ("columns", columns)):
        integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not integer or not 1 <= value <= MOST_TAXELS:
            expected = f"expected a whole number from 1 to {MOST_TAXELS}"
            raise InvalidInput(f"{name}: {expected}, got {checks.brief(value)}")
    if rows * columns > MOST_TAXELS:
        raise InvalidInput(f"rows: expected at most {MOST_TAXELS} taxels, got {rows * columns}")
    if not 2e-4 <= float(checks.finite(pitch, "pitch", ())) <= 0.05:
        raise InvalidInput(f"pitch: expected metres from 0.0002 to 0.05, got {pitch:g}")
    x, y = (pitch * (np.arange(count) - (count - 1) / 2) for count in (columns, rows))
    return np.stack([*np.meshgrid(x, y), np.zeros((rows, columns))], axis=2)


def _by_component(value: ArrayLike, name: str, components: int) -> Array:
    """Returns three numbers, of which the first `components` count; raises InvalidInput."""
    numbers = checks.finite(value, name, () if checks.ndim(value) == 0 else (components,))
    out = np.ones(3)
    out[:components] = numbers
    return out


def _check_outward(points: Array, normals: Array, near: Mask) -> None:
    """Raises InvalidInput where a normal is opposite to those of its neighbours, or where all point inward.

    A surface whose normals point outward is the wider, the farther out it is; a palm may be a little hollow.
    """
    around = near @ normals
    wrong = np.flatnonzero((around * normals).sum(axis=1) < -0.5 * near.sum(axis=1).clip(min=1))
    if len(wrong):
        came = f"{checks.brief(normals[wrong[0]].round(3).tolist())}, against its neighbours'"
        raise InvalidInput(f"normals[{wrong[0]}]: expected one that points out of the link, got {came}")
    arms = points - points.mean(axis=0)
    if (normals * arms).sum() < -0.3 * np.linalg.norm(arms, axis=1).sum():
        raise InvalidInput(
            "normals: expected normals that point out of the link, got normals that point into it"
        )


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True).clip(min=1e-12))


def _axes(normals: Array, x_axes: Array | None) -> Array:
    """Returns (n, 3, 3) the taxels' axes, in columns; raises InvalidInput for an x along the normal."""
    n = len(normals)
    if x_axes is None:
        given = np.where(np.abs(normals[:, :1]) < 0.9, [1.0, 0, 0], [0.0, 1, 0])
    else:
        given = checks.unit(x_axes, "x_axes", (n, 3))
    x = given - (given * normals).sum(axis=1)[:, None] * normals
    if (along := np.flatnonzero(np.linalg.norm(x, axis=1) < 0.05)).size:
        raise InvalidInput(f"x_axes[{along[0]}]: expected a direction across the normal, got one along it")
    x = _unit(x)
    return np.stack([x, np.cross(normals, x), normals], axis=2)


def _taxel_records(points: Array, axes: Array, distance: Array, pitch: float) -> NDArray[np.void]:
    """Returns TAXEL records (n,): neighbours by `distance` (n, n), of which those that face elsewhere do not count."""
    records, normals = np.zeros(len(points), dtype=TAXEL), axes[:, :, 2]
    records["point"], records["axes"] = points, axes
    facing = normals @ normals.T > 0.3
    for name, reach, most in (("near", 1.5, NEAR), ("wide", 2.9, WIDE)):
        records[name] = -1
        reached = np.where(facing & (distance < reach * pitch), distance, np.inf)
        order = np.argsort(reached, axis=1, kind="stable")[:, :most]
        chosen = np.where(np.isfinite(np.take_along_axis(reached, order, axis=1)), order, -1)
        records[name][:, : chosen.shape[1]] = chosen
    records["beside"] = -1
    for i, row in enumerate(records):
        near = row["near"][row["near"] >= 0]
        arms = (points[near] - points[i]) @ axes[i]
        for k in range(4):
            along = arms[:, k // 2] * (1 if k % 2 else -1)
            if len(near) and (along > 0.85 * np.linalg.norm(arms[:, :2], axis=1)).any():
                row["beside"][k] = near[np.argmax(along / np.linalg.norm(arms[:, :2], axis=1))]
        if len(near):
            row["edge"] = _unit(points[near] - points[i]).mean(axis=0)
        if len(near):  # least squares, across the normal, with a weak pull to a flat surface
            tangent = arms[:, :2]
            turned = (normals[near] - normals[i]) @ axes[i][:, :2]
            K = np.linalg.solve(tangent.T @ tangent + 1e-2 * pitch**2 * np.eye(2), tangent.T @ turned)
            row["bend"] = axes[i][:, :2] @ K.T @ axes[i][:, :2].T
    return records


@dataclass(frozen=True, slots=True, eq=False)
class SkinTouch:
    """A `SkinTouch` says which taxels of a surface are touched at one instant."""

    surface: TactileSurface = field(repr=False)
    rise: Array = field(repr=False)
    """(n, components) scaled readings over the baseline, 0 where unknown; those of dead taxels within a patch are the
    mean of their neighbours'."""
    states: Indices = field(repr=False)
    """(2, n) what each taxel says, and the number of its patch, -1 for none (`_kernels/touch/taxels.py`)."""
    patches: NDArray[np.void] = field(repr=False)
    """(p,) records PATCH of taxels that touch each other, in the link."""

    @property
    def pressed(self) -> Mask:
        """(rows, columns) or (n,) taxels that are contacts, by themselves or as a part of a patch."""
        return self._mask(self.states[0] == PRESSED)

    @property
    def untouched(self) -> Mask:
        """The taxels that nothing covers; those that are neither are no evidence."""
        return self._mask(self.states[0] >= UNTOUCHED)

    def _mask(self, values: Mask) -> Mask:
        surface = self.surface
        return values.reshape(surface.shape[:2] if surface.layout else surface.shape[:1])

    @property
    def spread(self) -> Mask:
        """(n,) pressed taxels of flat patches, each of which is a contact by itself."""
        flat = np.append(self.patches["flat"], False)  # the last one is of taxels without a patch
        return (self.states[0] == PRESSED) & flat[self.states[1]]

    @property
    def strongest(self) -> int | None:
        """The number of the patch that bears most; None without a patch."""
        if len(self.patches) < 2:  # the usual case, and the search takes long
            return 0 if len(self.patches) else None
        return int(self.patches["total"].argmax())

    def without(self, patch: int) -> "SkinTouch":
        """Returns the same without the contacts of one patch, whose taxels are then no evidence."""
        states, flat = self.states.copy(), self.patches.copy()
        states[0, (states[1] == patch) & (states[0] == PRESSED)] = RIM
        kept = np.arange(len(flat)) != patch
        states[1, ~np.isin(states[1], np.flatnonzero(kept))] = -1
        states[1, states[1] > patch] -= 1
        return SkinTouch(self.surface, self.rise, states, flat[kept])

    def contacts(self, T_palm_frame: ArrayLike, by_error: ArrayLike | None = None) -> Contacts | None:
        """Returns the contacts in the palm; None without a pressed taxel.

        Of flat patches they are at most `MAX_CONTACTS` pressed taxels, of the others their centres of pressure.
        `T_palm_frame` (4, 4): the pose of the link. `by_error` (6, j): the shift [m] and the turn [rad] of the link by
        one standard deviation of each of j joint errors. The covariances of flat patches are without the error that
        the taxels have in common (`sigmas_common`), which `handsight.SkinEvidence.of` adds.
        """
        surface, T = self.surface, se3.check(T_palm_frame, "T_palm_frame")
        chosen, patches = np.flatnonzero(self.spread), self.patches[~self.patches["flat"]]
        if not len(chosen) and not len(patches):
            return None
        chosen = chosen[_farthest_points(surface.points[chosen], MAX_CONTACTS)]
        taxels, record = surface.taxels[chosen], surface.record[0]
        C = np.zeros((len(chosen) + len(patches), 6, 6))
        variances = np.array([record["cell"] / 12, record["cell"] / 12, record["variance_point"]])
        C[: len(chosen), :3, :3] = taxels["axes"] * variances @ taxels["axes"].swapaxes(1, 2)
        C[: len(chosen), 3:, 3:] = record["variance_normal"] * np.eye(3)
        C[len(chosen) :] = patches["covariance"]
        C[len(chosen) :] += np.diag(record["variance_mount"])
        points = se3.apply(T, np.concatenate([taxels["point"], patches["point"]]))
        normals = np.concatenate([-taxels["axes"][:, :, 2], patches["normal"]]) @ T[:3, :3].T
        C = se3.rotate_covariance(T[:3, :3], C)
        if by_error is not None:
            for i in range(len(chosen), len(points)):
                J = np.array(by_error, dtype=np.float64)
                J[:3] = (se3.point_jacobian(points[i] - T[:3, 3]) @ J)[:3]
                J[3:] = -se3.skew(normals[i]) @ J[3:]
                C[i] += J @ J.T
        return Contacts(points, normals, covariance=C)

    def sigmas_common(self, by_error: ArrayLike | None = None) -> Array:
        """Returns (6,) one standard deviation per axis of the common error of contacts of flat patches, shift [m] and
        turn [rad]; zeros where there is none. `by_error`: as in `contacts`."""
        if not self.spread.any():
            return np.zeros(6)
        variance = self.surface.record[0]["variance_mount"]
        return np.sqrt(variance if by_error is None else variance + (np.asarray(by_error) ** 2).sum(axis=1))

    def outside(self, T_palm_frame: ArrayLike) -> Array:
        """Returns points (m, 3) in the palm that are not in the object: `CLEARANCE` above untouched taxels [m].

        Of a curved surface they are of taxels beside a patch only, as the object is near nowhere else.
        """
        taxels = self.surface.taxels[self.states[0] == UNTOUCHED]
        points = taxels["point"] + CLEARANCE * taxels["axes"][:, :, 2]
        return se3.apply(se3.check(T_palm_frame, "T_palm_frame"), points)


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
