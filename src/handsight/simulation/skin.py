"""A simulated elastic skin, on a palm or on a curved fingertip, and the forces on its taxels.

The skin is a bed of springs (an elastic foundation; Johnson 1985, chapter 4.3): a body that presses on it sinks in
until the springs below it hold its force. A physics engine's contact points would not do, for they are at the corners
of a face alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array, Indices
from handsight.contact.taxels import TactileSurface
from handsight.simulation.scene import BOX_SIZE, CAN_SIZE, PALM, convex_hull


class SkinOptions(NamedTuple):
    """`SkinOptions` are the constants of a simulated tactile array."""

    foam: float = 1e7  # stiffness of a skin of 5 mm of foam [N/m per m²]
    rubber: float = 6e7
    """Stiffness of 1.5 mm of soft rubber, as on the simulated hand [N/m per m²]. The hand is hard in the physics
    engine, so a softer skin would contradict the object's pose."""
    springs: int = 3  # of a taxel of a flat array, each way
    tip_springs: int = 3000  # of a fingertip, evenly distributed
    cell: float = 0.85  # distance from a taxel to the springs that it measures, in pitches
    least_cosine: float = 0.3  # between a body's push and the inward normal of skin that it can press
    sigma: float = 0.002  # noise of a taxel without contact [N]
    circle_sides: int = 128  # of the polygon that approximates a circle: a can's within 0.01 mm


SKIN = SkinOptions()

T_PALM_GRID = np.array([[1.0, 0, 0, 0.011], [0, 0, -1, -0.0111], [0, 1, 0, 0.045], [0, 0, 0, 1]])
"""On the face of the palm's collision box that is towards -y."""
PALM_SKIN = TactileSurface.grid(
    frame=PALM, T_frame_grid=T_PALM_GRID, rows=20, columns=15, pitch=0.004, threshold=0.015, full_scale=5.0
)
"""The array of 60 x 80 mm on the simulated palm: its x is towards the thumb, its y towards the fingers."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A `Solid` is a convex body, described by the planes of its faces."""

    normals: Array  # (k, 3) outward
    offsets: Array  # (k,) distances of the planes from the origin along their normals [m]

    @classmethod
    def cylinder(cls, radius: float, height: float) -> "Solid":
        """Returns a cylinder about the origin and z."""
        angle = 2 * np.pi * np.arange(SKIN.circle_sides) / SKIN.circle_sides
        sides = np.stack([np.cos(angle), np.sin(angle), np.zeros(SKIN.circle_sides)], axis=1)
        ends = np.array([[0.0, 0, 1], [0, 0, -1]])
        return cls(np.vstack([sides, ends]), np.repeat([radius, height / 2], [SKIN.circle_sides, 2]))

    @classmethod
    def hull(cls, vertices: Array) -> "Solid":
        """Returns the convex hull of vertices (k, 3) [m]."""
        planes = ConvexHull(vertices).equations
        return cls(planes[:, :3], -planes[:, 3])

    @classmethod
    def of(cls, name: str) -> "Solid":
        """Returns a scenario's object in its own frame."""
        if name == "can":
            return cls.cylinder(*CAN_SIZE)
        if name == "box":
            return cls(np.vstack([np.eye(3), -np.eye(3)]), np.tile(np.array(BOX_SIZE) / 2, 2))
        return cls.hull(convex_hull(name)[0])

    def distances(self, points: Array, direction: Array) -> Array:
        """Returns the distances (n,) from points (n, 3) along a unit direction to the body's nearer surface [m].

        They are infinite where the line misses the body, and negative where that surface is behind the point.
        """
        rate = self.normals @ direction
        enters, leaves, beside = rate < -1e-12, rate > 1e-12, np.abs(rate) <= 1e-12
        along = np.where(beside, 1.0, rate)
        at = self.offsets / along - points @ (self.normals / along[:, None]).T
        begin = at[:, enters].max(axis=1, initial=-np.inf)
        end = at[:, leaves].min(axis=1, initial=np.inf)
        misses = (at[:, beside] < 0).any(axis=1) | (end < begin)
        return np.asarray(np.where(misses, np.inf, begin))


def spring_forces(gaps: Array, force: float, stiffness: Array | float) -> Array:
    """Returns the forces (n,) of springs that a body compresses until together they hold `force` [N].

    `gaps` (n,) are the distances of the unloaded springs from the body [m], infinite beside it; `stiffness`, of each
    spring or of all, is in N/m.
    """
    order = np.argsort(gaps)[: np.isfinite(gaps).sum()]
    if force <= 0 or not len(order):
        return np.zeros(len(gaps))
    near, k = gaps[order], np.broadcast_to(stiffness, gaps.shape)[order]
    # The depth at which the nearest springs hold the force; the right number of them reaches no further spring.
    depth = (force + np.cumsum(k * near)) / np.cumsum(k)
    last = int(np.argmax(np.append(depth[:-1] <= near[1:], True)))
    return np.asarray(stiffness * np.maximum(depth[last] - gaps, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ElasticSkin:
    """An `ElasticSkin` is a bed of springs on a link, each below one of its taxels or below none."""

    points: Array  # (m, 3) ends of the unloaded springs in the link [m]
    normals: Array  # (m, 3) outward
    areas: Array  # (m,) that each represents [m²]
    taxels: Indices  # (m,) the taxel that measures each spring; the number of taxels where none does
    places: Array  # (n, 3) of the taxels in the link [m]

    @classmethod
    def flat(cls, array: TactileSurface) -> "ElasticSkin":
        """Returns the skin of a flat grid of taxels, with springs below these alone."""
        fine = array.pitch / SKIN.springs
        steps = fine * (np.arange(SKIN.springs) - (SKIN.springs - 1) / 2)
        within = np.stack(np.meshgrid(steps, steps, 0.0), axis=-1).reshape(-1, 3)
        n, each, axes = len(array.points), len(within), array.taxels["axes"]
        points = array.points[:, None] + within @ axes.swapaxes(1, 2)
        normals, taxels = np.repeat(axes[:, :, 2], each, axis=0), np.repeat(np.arange(n), each)
        return cls(points.reshape(-1, 3), normals, np.full(n * each, fine**2), taxels, array.points)

    @classmethod
    def ellipsoid(cls, semi_axes: Array, T_link_tip: Array, places: Array, reach: Array) -> "ElasticSkin":
        """Returns the skin all over a fingertip, an ellipsoid (3,) [m] with that pose (4, 4). `places` (n, 3) are its
        taxels in the link, `reach` (n,) how far each one's cell extends at most [m]."""
        unit = se3.directions(SKIN.tip_springs)
        out = unit / semi_axes
        length = np.linalg.norm(out, axis=1)
        areas = semi_axes.prod() * length * 4 * np.pi / len(unit)
        points = se3.apply(T_link_tip, semi_axes * unit)
        distances = np.linalg.norm(points[:, None] - places, axis=2)
        taxels = distances.argmin(axis=1)
        taxels[distances.min(axis=1) > reach[taxels]] = len(places)
        return cls(points, out / length[:, None] @ T_link_tip[:3, :3].T, areas, taxels, places)

    def forces(
        self,
        solid: Solid,
        T_link_solid: Array,
        force: Array,
        push: Array,
        uneven: Array | float = 0.0,
        stiffness: float = SKIN.rubber,
        torque: float = 0.0,
    ) -> Array:
        """Returns the forces (n + 1, 3) of a solid on the taxels in the link, and on skin without one in the last row.

        Their sum is `force` (3,) [N]. `push` (3,) is the unit direction in which the solid presses into the skin:
        along it springs are compressed, each of which presses back along its own normal. The rest of the force is
        shared in proportion to the pressure, and so is `torque` about `push` [N m], in proportion to the distance from
        the centre of pressure too. `uneven` (n,): each taxel's distance below its place [m].
        """
        found = np.zeros((len(self.places) + 1, 3))
        cosines = -self.normals @ push
        near = np.flatnonzero(cosines > SKIN.least_cosine)
        cosines, normals, taxels = cosines[near], self.normals[near], self.taxels[near]
        R = T_link_solid[:3, :3]
        gaps = solid.distances((self.points[near] - T_link_solid[:3, 3]) @ R, -push @ R)
        gaps = gaps + np.append(np.broadcast_to(uneven, len(self.places)), 0.0)[taxels]
        borne = spring_forces(gaps, float(force @ push), stiffness * self.areas[near] * cosines**2)
        if not borne.any():
            return found
        pressed = -(borne / cosines)[:, None] * normals
        share = borne / borne.sum()
        arms = np.cross(push, self.points[near] - share @ self.points[near])
        turn = torque / max(share @ (arms**2).sum(axis=1), 1e-9)
        np.add.at(found, taxels, pressed + share[:, None] * (force - pressed.sum(axis=0) + turn * arms))
        return found
