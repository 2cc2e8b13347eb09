"""Symmetries that an object's geometry suggests; whether its print breaks them is for a person to say."""

from typing import NamedTuple

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import Symmetries, about

ORDERS = (8, 6, 5, 4, 3, 2)


class SymmetrySearchOptions(NamedTuple):
    """`SymmetrySearchOptions` say how symmetries are found."""

    tolerance: float = 0.01  # of the diameter
    samples: int = 400  # surface points that are compared
    max_start_error: float = 0.06
    """Of the diameter: a root mean square distance from which no refinement leads to a symmetry."""
    equal_moments: float = 0.15
    """Principal moments within this part of each other leave the axes between them open."""
    steps: int = 6  # of a refinement
    directions: int = 150  # directions tried on the half sphere where no axis is distinguished
    percentile: int = 98
    """Per cent of the samples must be within the tolerance: the field rounds off what few see."""


SEARCH = SymmetrySearchOptions()

_SPINS = 2 * np.pi * np.modf(0.381966 * np.arange(1, 12))[0]


class _Axis(NamedTuple):
    point: Array
    direction: Array
    order: int


def propose_symmetries(model: ObjectModel, tolerance: float | None = None) -> Symmetries:
    """Returns the rotations that take the surface onto itself to within `tolerance` [m] nearly everywhere.

    Default tolerance: 1 % of the diameter. Tried are rotations of order 2, 3, 4, 5, 6, 8 and any angle about
    the axes of inertia and, where those are not unique, about axes between them; found are the cyclic and
    dihedral groups, those of the tetrahedron and the cube, the cylinder and the ball. This declares nothing:
    `model.with_symmetries(...)` does. Raises InvalidInput for a tolerance that is not positive.
    """
    limit = (
        SEARCH.tolerance * model.diameter if tolerance is None else checks.positive(tolerance, "tolerance")
    )
    judge = _Judge(model, limit)
    directions = judge.directions()
    for direction in directions:
        line = judge.continuous(direction)
        if line is not None:
            return judge.of_revolution(*line)
    axes: list[_Axis] = []
    for direction in directions:
        if any(abs(direction @ axis.direction) > 0.999 for axis in axes):
            continue
        found = judge.finite(direction)
        if found is not None and not any(abs(found.direction @ axis.direction) > 0.98 for axis in axes):
            axes.append(found)
    return judge.group(axes)


class _Judge:
    """Turns the object's samples and looks how far they end from its surface."""

    def __init__(self, model: ObjectModel, tolerance: float) -> None:
        self.points, _ = model.sample(SEARCH.samples)
        many, _ = model.sample(4000, seed=1)
        self.center = many.mean(axis=0)
        self.moments, self.principal = np.linalg.eigh(np.cov((many - self.center).T))
        self.field, self.size = model.fine, model.diameter
        self.limit = tolerance + self.worst(np.eye(4))

    def worst(self, T: Array) -> float:
        """Returns the distance [m] that nearly all samples keep to after `T`."""
        return float(
            np.percentile(np.abs(self.field.evaluate(se3.apply(T, self.points)).distance), SEARCH.percentile)
        )

    def directions(self) -> Array:
        """Returns directions (k, 3) that an axis may have: principal ones, the object's own, and those between."""
        sure = np.vstack([self.principal.T[::-1], np.eye(3)])
        low, middle, high = self.moments
        if low > (1 - SEARCH.equal_moments) * high:
            k = np.arange(SEARCH.directions) + 0.5
            z, angle = k / SEARCH.directions, np.pi * (1 + np.sqrt(5)) * k
            r = np.sqrt(1 - z * z)
            return np.vstack([sure, np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)])
        for i, j, alike in (
            (0, 1, low > (1 - SEARCH.equal_moments) * middle),
            (1, 2, middle > (1 - SEARCH.equal_moments) * high),
        ):
            if alike:
                angle = np.pi * np.arange(48)[:, None] / 48
                between = np.cos(angle) * self.principal[:, i] + np.sin(angle) * self.principal[:, j]
                sure = np.vstack([sure, between])
        return sure

    def refined(self, T: Array) -> Array | None:
        """Returns `T` moved to lay the samples best on the surface; None where they are far from it."""
        for step in range(SEARCH.steps):
            moved = se3.apply(T, self.points)
            distance, gradient, _ = self.field.evaluate(moved)
            if step in (0, 3) and np.sqrt((distance**2).mean()) > SEARCH.max_start_error * self.size / (
                1 + step
            ):
                return None
            arm = (moved - T[:3, 3]) / self.size
            rows = np.hstack([gradient, np.cross(arm, gradient)])
            # What the surface leaves open stays where it is.
            normal = rows.T @ rows + 1e-3 * len(rows) * np.diag([0.01] * 3 + [0.001] * 3)
            change = -np.linalg.solve(normal, rows.T @ distance) / np.repeat([1.0, self.size], 3)
            T = se3.moved(T, change)
        return T

    def line(self, T: Array) -> tuple[Array, Array]:
        """Returns the axis of a rotation: its point nearest to the centre, and its direction."""
        vector = se3.rotation_log(T[:3, :3])
        direction = vector / np.linalg.norm(vector)
        offset = se3.apply(T, self.center[None])[0] - self.center
        across = offset - (offset @ direction) * direction
        point, *_ = np.linalg.lstsq(np.eye(3) - T[:3, :3], across, rcond=1e-6)
        return self.center + point, direction

    def continuous(self, direction: Array) -> tuple[Array, Array] | None:
        """Returns the axis near that direction about which any turn keeps the surface, if there is one."""
        T = self.refined(about(self.center, _SPINS[0] * direction))
        if T is None:
            return None
        point, axis = self.line(T)
        if all(self.worst(about(point, angle * axis)) < self.limit for angle in _SPINS):
            return point, axis * np.sign(axis @ direction)
        return None

    def finite(self, direction: Array) -> _Axis | None:
        """Returns the axis near that direction with the highest order that keeps the surface, if there is one."""
        for order in ORDERS:
            T = self.refined(about(self.center, 2 * np.pi / order * direction))
            if T is None:
                continue
            vector = se3.rotation_log(T[:3, :3])
            if abs(np.linalg.norm(vector) - 2 * np.pi / order) > 0.2 / order:
                continue
            point, axis = self.line(T)
            if self.worst(about(point, 2 * np.pi / order * axis)) < self.limit:
                return _Axis(point, axis, order)
        return None

    def of_revolution(self, point: Array, axis: Array) -> Symmetries:
        """Returns symmetries about a continuous axis: a ball's, or with the half turn that swaps its ends, or
        without."""
        side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        side /= np.linalg.norm(side)
        if self.continuous(side) is not None:
            return Symmetries([(self.center, axis) for axis in np.eye(3)])
        T = self.refined(about(point, np.pi * side))
        if T is not None:
            # Only the height at which it swaps is free.
            half = point + axis * ((T[:3, 3] + T[:3, :3] @ point - point) @ axis) / 2
            flip = about(half, np.pi * side)
            if self.worst(flip) < self.limit:
                return Symmetries([(half, axis)], flip[None])
        return Symmetries([(point, axis)])

    def group(self, axes: list[_Axis]) -> Symmetries:
        """Returns the largest group of these axes, set exactly at their proper angles, that keeps the surface."""
        if not axes:
            return Symmetries()
        axes = sorted(axes, key=lambda a: -a.order)
        center = np.mean([a.point for a in axes], axis=0) if len(axes) > 1 else axes[0].point
        cyclic = 2 * np.pi / axes[0].order * axes[0].direction
        for vectors in (*_polyhedral(axes), *_dihedral(axes), cyclic[None]):
            found = Symmetries(rotations=about(center, vectors))
            if all(self.worst(T) < 1.2 * self.limit for T in found.rotations):
                return found
        return Symmetries()


def _frame(x: Array, near_y: Array) -> Array:
    """Returns (3, 3) rows at right angles: the first along x, the second near y."""
    y = near_y - (near_y @ x) * x
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def _polyhedral(axes: list[_Axis]) -> list[Array]:
    """Returns generators of the cube's and the tetrahedron's rotations, where the axes have room for them."""
    found = []
    for order in (4, 2):
        square = [a.direction for a in axes if a.order % order == 0]
        pairs = [(a, b) for a in square for b in square if abs(a @ b) < 0.1]
        if pairs and sum(a.order % 3 == 0 for a in axes) > 1:
            frame = _frame(*pairs[0])
            diagonal = 2 * np.pi / 3 / np.sqrt(3) * frame.sum(axis=0)
            found.append(np.vstack([2 * np.pi / order * frame, diagonal]))
    return found


def _dihedral(axes: list[_Axis]) -> list[Array]:
    """Returns generators of an axis with half turns across it."""
    found = []
    for main in axes:
        across = [a.direction for a in axes if a.order % 2 == 0 and abs(a.direction @ main.direction) < 0.1]
        if across:
            frame = _frame(main.direction, across[0])
            found.append(np.stack([2 * np.pi / main.order * frame[0], np.pi * frame[1]]))
    return found
