"""Symmetries that are found in an object's shape, and symmetries declared in words and checked against the shape.

Only a person can decide whether a print on the surface distinguishes two poses of the same shape.
"""

import re
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects.geometry import Geometry
from handsight.objects.surface import Triangles
from handsight.objects.symmetry import MAX_ROTATIONS, Symmetries, about

ORDERS = (8, 6, 5, 4, 3, 2)  # orders of the rotations that are tried about an axis, the highest first
EQUAL_MOMENTS = 0.85  # ratio of two principal moments above which axes between theirs are tried too

_SPINS = 2 * np.pi * np.modf(0.381966 * np.arange(1, 12))[0]
"""Angles [rad] that no finite group contains, by which a continuous axis is distinguished from one of high order."""


class _Axis(NamedTuple):
    """Axis about which a turn by 2π / order takes the surface onto itself."""

    point: Array
    direction: Array
    order: int


def propose_symmetries(model: Geometry, tolerance: float | None = None) -> Symmetries:
    """Returns the rotations that take the surface onto itself to within `tolerance` [m] nearly everywhere.

    Default tolerance: 1 % of the diameter. The search tries rotations of order 2, 3, 4, 5, 6, 8 and by any angle
    about the principal axes of inertia and, where those are not unique, about axes between them. It finds cyclic and
    dihedral groups and those of the tetrahedron, the cube, the cylinder and the ball. The model stays as it is:
    `model.with_symmetries(...)` declares them. Raises InvalidInput for a tolerance that is not positive.
    """
    default = 0.01 * model.diameter
    search = _Search(model, default if tolerance is None else checks.positive(tolerance, "tolerance"))
    directions = search.directions()
    for direction in directions:
        line = search.axis(direction, _SPINS)
        if line is not None:
            return search.of_revolution(*line)
    axes: list[_Axis] = []
    for direction in directions:
        if any(abs(direction @ axis.direction) > 0.999 for axis in axes):
            continue
        found = search.finite(direction)
        if found is not None and not any(abs(found.direction @ axis.direction) > 0.98 for axis in axes):
            axes.append(found)
    return search.group(axes)


def declared_symmetries(model: Geometry, words: Sequence[str]) -> Symmetries:
    """Returns the symmetries that words declare, about the middle of the surface.

    `z` stands for all turns about z, `z/4` for quarter turns about it, and `find`, alone, for `propose_symmetries`.
    Raises InvalidInput for other words, and for turns that move the surface.
    """
    if "find" in words:
        if len(words) > 1:
            raise InvalidInput(f"symmetry: expected find alone, got {' '.join(words)}")
        return propose_symmetries(model)
    surface = model.surface
    found = list[Symmetries]()
    places = surface.corners.mean(axis=1) if isinstance(surface, Triangles) else surface.vertices
    center = np.average(places, axis=0, weights=surface.areas)  # every symmetry leaves it in place
    for word in words:
        match = re.fullmatch(r"([xyz])(?:/([1-9]\d{0,2}))?", word)
        if match is None or int(match[2] or 1) > MAX_ROTATIONS:
            raise InvalidInput(
                "symmetry: expected find, an axis (z: any turn about it), or an axis and a number (z/4: quarter "
                f"turns), got {word!r}"
            )
        axis = np.eye(3)["xyz".index(match[1])]
        turn = about(center, 2 * np.pi / int(match[2]) * axis)[None] if match[2] else None
        found.append(Symmetries([] if match[2] else [(center, axis)], turn))
        check_symmetries(model, found[-1], "symmetry", word)
    turns = [T for each in found for T in each.rotations]
    return Symmetries([line for each in found for line in each.axes], np.array(turns))


def check_symmetries(
    model: Geometry,
    symmetries: Symmetries,
    name: str = "symmetries",
    came: str = "one",
    tolerance: float = 0.04,
) -> None:
    """Raises InvalidInput, which begins with `name`, where symmetries move the object's surface; `came` names them.

    `tolerance`: how far a turn may move a point off the surface [diameters]; less where a person declares it than where
    a library does.
    """
    if symmetries.trivial:
        return
    points = model.sample(1000)[0]
    angles = 2 * np.pi * np.arange(1, 12) / 12
    turns = [about(point, angle * axis) for point, axis in symmetries.axes for angle in angles]
    off = max(_distance(model, points, T) for T in (*symmetries.rotations[1:], *turns))
    if off > tolerance * model.diameter:
        raise InvalidInput(
            f"{name}: expected turns that leave the surface in place, got {came}, which is {1000 * off:.1f} mm off"
        )


def _distance(model: Geometry, points: Array, T: Array) -> float:
    """Returns a high percentile of the distances [m] to the surface from its points (n, 3) after the motion `T`."""
    distance = model.fine.evaluate(se3.apply(T, points)).distance
    return float(np.percentile(np.abs(distance), 98))  # others may be at corners, which the field rounds


class _Search:
    """Search for symmetry axes of an object, by the distances of its turned samples from its surface."""

    def __init__(self, model: Geometry, tolerance: float) -> None:
        self.points, _ = model.sample(400)
        many, _ = model.sample(4000, seed=1)
        self.center = many.mean(axis=0)
        self.moments, self.principal = np.linalg.eigh(np.cov((many - self.center).T))
        self.model = model
        self.size = model.diameter
        self.worst = partial(_distance, model, self.points)
        self.limit = tolerance + self.worst(np.eye(4))

    def directions(self) -> Array:
        """Returns directions (k, 3) of possible axes: principal ones, x, y, z, and those between equal moments."""
        found = np.vstack([self.principal.T[::-1], np.eye(3)])
        moments = self.moments
        if moments[0] > EQUAL_MOMENTS * moments[2]:
            return np.vstack([found, se3.directions(2 * 150)[:150]])  # a half sphere
        for i, j in ((0, 1), (1, 2)):
            if moments[i] > EQUAL_MOMENTS * moments[j]:
                angle = np.pi * np.arange(48)[:, None] / 48
                between = np.cos(angle) * self.principal[:, i] + np.sin(angle) * self.principal[:, j]
                found = np.vstack([found, between])
        return found

    def refined(self, T: Array) -> Array | None:
        """Returns `T` moved so that it brings the samples nearest to the surface; None if they stay far from it."""
        for step in range(6):
            moved = se3.apply(T, self.points)
            distance, gradient, _ = self.model.fine.evaluate(moved)
            limit = 0.06 * self.size / (1 + step)  # a larger root mean square is not refined
            if step in (0, 3) and np.sqrt((distance**2).mean()) > limit:
                return None
            arm = (moved - T[:3, 3]) / self.size
            rows = np.hstack([gradient, np.cross(arm, gradient)])
            # The damping keeps directions that the surface does not determine where they are.
            normal = rows.T @ rows + len(rows) * np.diag([1e-5] * 3 + [1e-6] * 3)
            change = -np.linalg.solve(normal, rows.T @ distance) / np.repeat([1.0, self.size], 3)
            T = se3.moved(T, change)
        return T

    def axis(self, direction: Array, angles: Array, drift: float = np.inf) -> tuple[Array, Array] | None:
        """Returns point and direction of an axis near a direction about which turns by the angles [rad] keep the
        surface, or None; `drift`: the most by which the first angle may change in the refinement [rad]."""
        T = self.refined(about(self.center, angles[0] * direction))
        if T is None:
            return None
        vector = se3.rotation_log(T[:3, :3])
        angle = np.linalg.norm(vector)
        along = vector / angle
        offset = se3.apply(T, self.center[None])[0] - self.center
        across = offset - (offset @ along) * along
        point = self.center + np.linalg.lstsq(np.eye(3) - T[:3, :3], across, rcond=1e-6)[0]
        if abs(angle - angles[0]) > drift or any(
            self.worst(about(point, a * along)) >= self.limit for a in angles
        ):
            return None
        return point, along * np.sign(along @ direction)

    def finite(self, direction: Array) -> _Axis | None:
        """Returns the axis near a direction with the highest order that keeps the surface, or None."""
        for order in ORDERS:
            found = self.axis(direction, np.array([2 * np.pi / order]), 0.2 / order)
            if found is not None:
                return _Axis(*found, order)
        return None

    def of_revolution(self, point: Array, axis: Array) -> Symmetries:
        """Returns the symmetries of a surface with this axis: a ball's, or the axis with or without swapped ends."""
        side = se3.perpendicular(axis)
        if self.axis(side, _SPINS) is not None:
            return Symmetries([(self.center, axis) for axis in np.eye(3)])
        T = self.refined(about(point, np.pi * side))
        if T is not None:
            # Of the half turn, only the height of its axis is free.
            half = point + axis * ((T[:3, 3] + T[:3, :3] @ point - point) @ axis) / 2
            flip = about(half, np.pi * side)
            if self.worst(flip) < self.limit:
                return Symmetries([(half, axis)], flip[None])
        return Symmetries([(point, axis)])

    def group(self, axes: list[_Axis]) -> Symmetries:
        """Returns the largest group with these axes that keeps the surface, at the exact angles of that group."""
        if not axes:
            return Symmetries()
        axes = sorted(axes, key=lambda a: -a.order)
        center = np.mean([a.point for a in axes], axis=0) if len(axes) > 1 else axes[0].point
        cyclic = 2 * np.pi / axes[0].order * axes[0].direction
        candidates = []  # rotation vectors (m, 3) that generate a group
        for order in (4, 2):  # the cube's, the tetrahedron's
            square = [a.direction for a in axes if a.order % order == 0]
            pairs = [(a, b) for a in square for b in square if abs(a @ b) < 0.1]
            if pairs and sum(a.order % 3 == 0 for a in axes) > 1:
                frame = se3.axes_along(*pairs[0]).T
                diagonal = 2 * np.pi / 3 / np.sqrt(3) * frame.sum(axis=0)
                candidates.append(np.vstack([2 * np.pi / order * frame, diagonal]))
        for main in axes:  # dihedral: an axis with half turns across it
            for half in axes:
                if half.order % 2 == 0 and abs(half.direction @ main.direction) < 0.1:
                    frame = se3.axes_along(main.direction, half.direction).T
                    candidates.append(np.stack([2 * np.pi / main.order * frame[0], np.pi * frame[1]]))
                    break
        for vectors in (*candidates, cyclic[None]):
            found = Symmetries(rotations=about(center, vectors))
            if all(self.worst(T) < 1.2 * self.limit for T in found.rotations):
                return found
        return Symmetries()
