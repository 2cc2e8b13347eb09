"""A simulated tactile array: an elastic skin on the palm, and the readings of its taxels.

The skin is a bed of springs (an elastic foundation; Johnson 1985, chapter 4.3): a body that presses on it sinks in
until the springs below it hold its force. A physics engine's contact points would not do, for they are at the corners
of a face alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array
from handsight.contact.taxels import TactileSurface
from handsight.simulation.scenario import Scenario
from handsight.simulation.scene import CAN_SIZE, PALM, convex_hull


class SkinOptions(NamedTuple):
    """`SkinOptions` are the constants of a simulated tactile array."""

    foam: float = 1e7  # stiffness of a skin of 5 mm of foam [N/m per m²]
    rubber: float = 6e7
    """Stiffness of 1.5 mm of soft rubber, as on the simulated palm [N/m per m²]. The palm is hard in the physics
    engine, so a softer skin would contradict the object's pose.
    """
    springs: int = 3  # of a taxel, each way
    sigma: float = 0.002  # noise of a taxel without contact [N]
    circle_sides: int = 128  # of the polygon that approximates a circle: a can's within 0.01 mm


SKIN = SkinOptions()

PALM_GEOM = "robot0:C_palm0"
"""The geom that the array covers."""
T_PALM_GRID = np.array([[1.0, 0, 0, 0.011], [0, 0, -1, -0.0111], [0, 1, 0, 0.045], [0, 0, 0, 1]])
"""On the face of the palm's collision box that is towards -y."""
PALM_SKIN = TactileSurface.grid(
    frame=PALM,
    T_frame_grid=T_PALM_GRID,
    rows=20,
    columns=15,
    pitch=0.004,
    threshold=0.015,
    full_scale=5.0,
)
"""The array of 60 x 80 mm on the simulated palm: its x is towards the thumb, its y towards the fingers."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A `Solid` is a convex body, described by the planes of its faces."""

    normals: Array
    """(k, 3) outward."""
    offsets: Array
    """(k,) distances of the planes from the origin along their normals [m]."""

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

    def distances(self, points: Array, direction: Array) -> Array:
        """Returns the distances (n,) from points (n, 3) along a unit direction to the body's nearer surface [m].

        They are infinite where the line misses the body, and negative where that surface is behind the point.
        """
        rate, left = self.normals @ direction, self.offsets - points @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = left / rate
        begin = np.where(rate < -1e-12, at, -np.inf).max(axis=1)
        end = np.where(rate > 1e-12, at, np.inf).min(axis=1)
        misses = (np.where(np.abs(rate) <= 1e-12, left, 0.0) < 0).any(axis=1) | (end < begin)
        return np.asarray(np.where(misses, np.inf, begin))


def spring_forces(gaps: Array, force: float, stiffness: float) -> Array:
    """Returns the forces (n,) of springs that a body compresses until together they hold `force` [N].

    `gaps` (n,) are the distances of the unloaded springs from the body [m], infinite beside it; `stiffness` is a
    spring's [N/m].
    """
    near = np.sort(gaps[np.isfinite(gaps)])
    if force <= 0 or not len(near):
        return np.zeros(len(gaps))
    # The depth at which the nearest k springs hold the force; the right k is the one that reaches no further spring.
    depth = (force / stiffness + np.cumsum(near)) / np.arange(1, len(near) + 1)
    k = int(np.argmax(np.append(depth[:-1] <= near[1:], True)))
    return np.asarray(stiffness * np.maximum(depth[k] - gaps, 0.0))


def taxel_forces(
    array: TactileSurface,
    solid: Solid,
    T_grid_object: Array,
    force: float,
    uneven: Array | float = 0.0,
    springs: float = SKIN.rubber,
) -> Array:
    """Returns the forces (rows, columns) on the taxels of a solid that presses on the skin with `force` [N].

    `T_grid_object` (4, 4) is the solid's pose, `uneven` (rows, columns) each taxel's distance below the grid's plane
    [m], `springs` the skin's stiffness [N/m per m²].
    """
    fine = array.pitch / SKIN.springs
    steps = fine * (np.arange(SKIN.springs) - (SKIN.springs - 1) / 2)
    within = np.stack([*np.meshgrid(steps, steps), np.zeros((SKIN.springs, SKIN.springs))], 2)
    places = array.places_grid[:, :, None, None] + within
    R = T_grid_object[:3, :3]
    gaps = solid.distances((places.reshape(-1, 3) - T_grid_object[:3, 3]) @ R, R[2])
    gaps = (gaps.reshape(*array.shape, -1) + np.broadcast_to(uneven, array.shape)[:, :, None]).ravel()
    forces = spring_forces(gaps, force, springs * fine**2)
    return np.asarray(forces.reshape(*array.shape, -1).sum(axis=2))


class PalmSkin:
    """A `PalmSkin` is the array on the palm: constant errors are drawn at the start, noise at every reading."""

    def __init__(self, scenario: Scenario) -> None:
        """Draws by the scenario's seed."""
        n, seed, shape = scenario.nuisances, int(scenario.seed), PALM_SKIN.shape
        constant = np.random.default_rng((seed, 11))
        self._uneven = n.skin_uneven * constant.normal(size=shape)
        self._offset = n.skin_offset * constant.normal(size=shape)
        self._share, self._noise = n.skin_noise, np.random.default_rng((seed, 12))
        is_can = scenario.object == "can"  # else it is a mesh: a scenario with a skin has no box
        self._solid = Solid.cylinder(*CAN_SIZE) if is_can else Solid.hull(convex_hull(scenario.object)[0])

    def readings(self, T_palm_object: Array, force: float) -> dict[str, Array]:
        """Returns the array's readings (rows, columns) by its name [N]; `force` is the object's on the palm [N]."""
        T_grid_object = se3.inverse(T_PALM_GRID) @ T_palm_object
        true = taxel_forces(PALM_SKIN, self._solid, T_grid_object, force, self._uneven)
        share, floor = self._noise.normal(size=(2, *PALM_SKIN.shape))
        read = true * (1 + self._share * share) + (SKIN.sigma * floor if self._share else 0.0) + self._offset
        return {"palm": np.minimum(read, PALM_SKIN.full_scale or np.inf)}
