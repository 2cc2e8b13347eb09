"""Sweeps of a fingertip along a line: where one would meet an object of known pose, and what one has met."""

from dataclasses import dataclass, replace

import numpy as np

from handsight import checks, se3
from handsight._deprecated import renamed_arguments
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel, propose_symmetries

MAX_CAST_STEPS = 40
CAST_TOLERANCE = 2e-4
"""A cast ball has met the surface once it is this near to it; no step of a cast is shorter [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A `Sweep` is a straight path for the middle of a fingertip, which ends where the tip meets something."""

    start_world: Array
    """(3,) [m]."""
    direction_world: Array
    """(3,) of any length; it is normalised."""
    length: float
    """[m]."""

    def __post_init__(self) -> None:
        """Checks the fields; raises InvalidInput."""
        object.__setattr__(self, "start_world", checks.position(self.start_world, "sweep.start_world", (3,)))
        direction = checks.unit(self.direction_world, "sweep.direction_world", (3,))
        object.__setattr__(self, "direction_world", direction)
        object.__setattr__(self, "length", float(checks.positive(self.length, "sweep.length")))

    def at(self, distance: float) -> Array:
        """Returns the point (3,) of the path at a distance from its start [m]."""
        return np.asarray(self.start_world + distance * self.direction_world)

    @renamed_arguments(begin="start")
    def part(self, start: float, end: float) -> "Sweep":
        """Returns the part of the path between two distances from its start [m]."""
        return Sweep(self.at(start), self.direction_world, end - start)


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A `Touch` is the outcome of a sweep: where the tip met nothing, and the contact that ended it, if any."""

    free_world: Array
    """(m, 3) positions of the tip's middle at which it met nothing [m]."""
    radius: float
    """Radius of a ball about the tip's middle that is entirely within the tip [m]."""
    sigma: float
    """Standard deviation per axis of the tip's position [m]; the error is the same throughout a sweep."""
    contact_world: Contacts | None
    """One contact with its normal, in the world; None where the tip met nothing."""

    def __post_init__(self) -> None:
        """Checks the fields; raises InvalidInput."""
        free = self.free_world
        if checks.ndim(free) == 1 and not len(free):
            free = np.zeros((0, 3))
        object.__setattr__(self, "free_world", checks.position(free, "touch.free_world", (None, 3)))
        object.__setattr__(self, "radius", float(checks.sigma_point(self.radius, "touch.radius")))
        object.__setattr__(self, "sigma", float(checks.sigma(self.sigma, "touch.sigma")))
        met = self.contact_world
        if met is not None and not (isinstance(met, Contacts) and len(met) == 1 and met.has_normal.all()):
            came = checks.brief(met)
            raise InvalidInput(f"touch.contact_world: expected one contact with a normal or None, got {came}")


def with_symmetries_of_touch(model: ObjectModel, sigma: float) -> ObjectModel:
    """Returns a model with the symmetries that its surface has within `sigma` [m], the error of a touch.

    A camera may distinguish such poses, by a print on the surface; touch cannot. The declared symmetries stay where
    the surface proposes no more.
    """
    proposed, declared = propose_symmetries(model, sigma), model.symmetries
    more = (len(proposed.axes), len(proposed.rotations)) > (len(declared.axes), len(declared.rotations))
    return replace(model, symmetries=proposed) if more else model


def tip_center(contact_world: Contacts, radius: float) -> Array:
    """Returns the middle (3,) of a ball of `radius` [m] that touches the object at a contact. It is outside the object,
    where the distance and its gradient change smoothly, even near an edge of the surface."""
    return np.asarray(contact_world.points_palm[0] + radius * contact_world.normals_palm[0])


def cast(
    model: ObjectModel, Ts_world_object: Array, sweeps: list[Sweep], radius: float
) -> tuple[Array, Array, Array]:
    """Returns how far a ball moves along s sweeps until it meets the object at n poses, the normals there, and gaps.

    `Ts_world_object` is (n, 4, 4), `radius` the ball's [m]. The distances (s, n) are infinite where the ball passes by
    [m]; the object's outward normals (s, n, 3) are along the world's axes. The gaps (s, n) are the least
    distances between ball and object [m]. Each step is as long as the ball's distance
    from the object (sphere tracing, Hart 1996).
    """
    s, n = len(sweeps), len(Ts_world_object)
    Ts_object_world = np.tile(se3.inverse(Ts_world_object), (s, 1, 1))
    starts = np.repeat([sweep.start_world for sweep in sweeps], n, axis=0)
    directions = np.repeat([sweep.direction_world for sweep in sweeps], n, axis=0)
    p = np.einsum("nij,nj->ni", Ts_object_world[:, :3, :3], starts) + Ts_object_world[:, :3, 3]
    u = np.einsum("nij,nj->ni", Ts_object_world[:, :3, :3], directions)
    lengths = np.repeat([sweep.length for sweep in sweeps], n)
    travelled, hit, active = np.zeros(s * n), np.full(s * n, np.inf), np.arange(s * n)
    normals_object, gaps = np.zeros((s * n, 3)), np.full(s * n, np.inf)
    for _ in range(MAX_CAST_STEPS):
        values = model.evaluate(p[active] + travelled[active, None] * u[active])
        gap = values.distance - radius
        gaps[active] = np.minimum(gaps[active], gap)
        arrived = gap < CAST_TOLERANCE
        ended = active[arrived]
        hit[ended], normals_object[ended] = travelled[ended], values.gradient[arrived]
        travelled[active] += np.maximum(gap, CAST_TOLERANCE)
        active = active[~arrived & (travelled[active] < lengths[active])]
        if not len(active):
            break
    normals = np.einsum("nji,nj->ni", Ts_object_world[:, :3, :3], normals_object)
    return hit.reshape(s, n), normals.reshape(s, n, 3), gaps.reshape(s, n)
