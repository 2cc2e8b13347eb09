"""A fingertip that sweeps along a line: what it would meet, and what it has met."""

from dataclasses import dataclass

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

STEPS, NEAR = 40, 2e-4
"""Of a cast at most; how near to the surface it has arrived [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A straight line for the middle of a fingertip, until it meets something."""

    start_world: Array
    """(3,) [m]."""
    direction_world: Array
    """(3,) of any length."""
    length: float
    """[m]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        object.__setattr__(self, "start_world", checks.position(self.start_world, "sweep.start_world", (3,)))
        direction = checks.unit(self.direction_world, "sweep.direction_world", (3,))
        object.__setattr__(self, "direction_world", direction)
        object.__setattr__(self, "length", float(checks.positive(self.length, "sweep.length")))

    def at(self, distance: float) -> Array:
        """(3,) the point that far along it [m]."""
        return np.asarray(self.start_world + distance * self.direction_world)

    def part(self, begin: float, end: float) -> "Sweep":
        """The part of it between two distances from its start [m], which lie on it."""
        return Sweep(self.at(begin), self.direction_world, end - begin)


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What came of a sweep: where the tip met nothing, and what it met in the end."""

    free_world: Array
    """(m, 3) where the middle of the tip was while it met nothing [m]."""
    radius: float
    """Of the ball around that middle which is certainly within the tip [m]."""
    sigma: float
    """Of where the tip is, all along the sweep alike: one standard deviation per axis [m]."""
    contact_world: Contacts | None
    """One contact, in the world; None: the tip met nothing."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        free = self.free_world
        if len(free):
            free = checks.position(free, "touch.free_world", (None, 3))
        object.__setattr__(self, "free_world", np.asarray(free, dtype=np.float64).reshape(-1, 3))
        object.__setattr__(self, "radius", float(checks.positive(self.radius, "touch.radius")))
        object.__setattr__(self, "sigma", float(checks.sigma(self.sigma, "touch.sigma")))
        met = self.contact_world
        if met is not None and not (isinstance(met, Contacts) and len(met) == 1 and met.has_normal.all()):
            came = checks.brief(met)
            raise InvalidInput(f"touch.contact_world: expected one contact with a normal or None, got {came}")


def cast(
    model: ObjectModel, Ts_world_object: Array, sweeps: list[Sweep], radius: float
) -> tuple[Array, Array]:
    """How far a ball goes along each sweep until it meets the object at each pose [m], and the normal there.

    `Ts_world_object` (n, 4, 4). Distances (s, n), infinite where it passes, and outward normals (s, n, 3) along the
    world's axes. Steps are as long as the object is away (sphere tracing, Hart 1996).
    """
    s, n = len(sweeps), len(Ts_world_object)
    Ts_object_world = np.tile(se3.inverse(Ts_world_object), (s, 1, 1))
    starts = np.repeat([sweep.start_world for sweep in sweeps], n, axis=0)
    ways = np.repeat([sweep.direction_world for sweep in sweeps], n, axis=0)
    p = np.einsum("nij,nj->ni", Ts_object_world[:, :3, :3], starts) + Ts_object_world[:, :3, 3]
    u = np.einsum("nij,nj->ni", Ts_object_world[:, :3, :3], ways)
    lengths = np.repeat([sweep.length for sweep in sweeps], n)
    gone, met, left = np.zeros(s * n), np.full(s * n, np.inf), np.arange(s * n)
    normals_object = np.zeros((s * n, 3))
    for _ in range(STEPS):
        values = model.evaluate(p[left] + gone[left, None] * u[left])
        ahead = values.distance - radius
        arrived = ahead < NEAR
        there = left[arrived]
        met[there], normals_object[there] = gone[there], values.gradient[arrived]
        gone[left] += np.maximum(ahead, NEAR)
        left = left[~arrived & (gone[left] < lengths[left])]
        if not len(left):
            break
    normals = np.einsum("nji,nj->ni", Ts_object_world[:, :3, :3], normals_object)
    return met.reshape(s, n), normals.reshape(s, n, 3)
