"""The prior of a search by touch, where on a table the object may stand, and sweeps of a fingertip along lines over it:
where one would meet an object of known pose, and what one has met.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from handsight import checks, se3
from handsight.checks import Array, Mask
from handsight.contact import Contacts
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel, propose_symmetries
from handsight.objects.resting import resting_poses
from handsight.objects.symmetry import nearest
from handsight.rig import Table

MAX_CAST_STEPS = 40
CAST_TOLERANCE = 2e-4
"""A cast ball has met the surface once it is this near to it; no step of a cast is shorter [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A straight path for the middle of a fingertip, which ends where the tip meets something."""

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

    def part(self, start: float, end: float) -> "Sweep":
        """Returns the part of the path between two distances from its start [m]."""
        return Sweep(self.at(start), self.direction_world, end - start)


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """The outcome of a sweep: where the tip met nothing, and the contact that ended it, if any."""

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
    proposed = propose_symmetries(model, sigma)
    declared = model.symmetries
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
    travelled = np.zeros(s * n)
    hit = np.full(s * n, np.inf)
    active = np.arange(s * n)
    normals_object = np.zeros((s * n, 3))
    gaps = np.full(s * n, np.inf)
    for _ in range(MAX_CAST_STEPS):
        values = model.evaluate(p[active] + travelled[active, None] * u[active])
        gap = values.distance - radius
        gaps[active] = np.minimum(gaps[active], gap)
        arrived = gap < CAST_TOLERANCE
        ended = active[arrived]
        hit[ended] = travelled[ended]
        normals_object[ended] = values.gradient[arrived]
        travelled[active] += np.maximum(gap, CAST_TOLERANCE)
        active = active[~arrived & (travelled[active] < lengths[active])]
        if not len(active):
            break
    normals = np.einsum("nji,nj->ni", Ts_object_world[:, :3, :3], normals_object)
    return hit.reshape(s, n), normals.reshape(s, n, 3), gaps.reshape(s, n)


MAX_STABLE_POSES = 24
SAME_STABLE_POSE = float(np.deg2rad(20.0))  # two stable poses whose tilts differ by less count as one [rad]


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """A uniform prior over the poses of an object that stands on a table, in a rectangle, at any yaw.

    A placement is a row (x [m], y [m], yaw [rad], index of the stable pose): the position of the middle of the object's
    bounds along the table's axes, the rotation about its normal, and the side on which the object stands. The table's
    axes are those of the world, but for its tilt.
    """

    low: Array
    """(2,) smallest x and y of the middle of the object's bounds, along the table's axes [m]."""
    high: Array
    """(2,) largest x and y of it [m]."""
    table: Table
    """The table that the object stands on; its height is along its normal."""
    Rs_world_object: Array
    """(k, 3, 3) orientations of the stable poses on a level table at yaw 0, each as likely as the others."""
    R_world_table: Array = field(default_factory=lambda: np.eye(3))
    """(3, 3) the table's tilt, as measured: its axes, the normal last."""

    def __post_init__(self) -> None:
        """Checks the fields; raises InvalidInput."""
        low, high = (checks.position(getattr(self, name), f"area.{name}", (2,)) for name in ("low", "high"))
        if not (low < high).all():
            raise InvalidInput(f"area: expected low below high, got {low.tolist()} and {high.tolist()}")
        if not isinstance(self.table, Table):
            raise InvalidInput(f"area.table: expected a Table, got {type(self.table).__name__}")
        Rs = checks.finite(self.Rs_world_object, "area.Rs_world_object", (None, 3, 3))
        checks.integer(len(Rs), "area.Rs_world_object: rotations", MAX_STABLE_POSES, least=1)
        R_table = checks.finite(self.R_world_table, "area.R_world_table", (3, 3))
        rotations = {f"area.Rs_world_object[{i}]": R for i, R in enumerate(Rs)} | {
            "area.R_world_table": R_table
        }
        for name, R in rotations.items():
            se3.check(se3.compose(R, np.zeros(3)), name)
        values = {"low": low, "high": high, "Rs_world_object": Rs, "R_world_table": R_table}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Returns `n` random placements (n, 4)."""
        xy = rng.uniform(self.low, self.high, (n, 2))
        stable = rng.integers(len(self.Rs_world_object), size=n)
        return np.column_stack([xy, rng.uniform(-np.pi, np.pi, n), stable])

    def contains(self, placements: Array) -> Mask:
        """Returns (n,) whether each of the placements (n, 4) is within the rectangle."""
        return np.asarray(((placements[:, :2] >= self.low) & (placements[:, :2] <= self.high)).all(axis=1))

    def poses(self, model: ObjectModel, placements: Array) -> Array:
        """Returns Ts_world_object (n, 4, 4) of the object at placements (n, 4)."""
        vertical = np.zeros((len(placements), 3))
        vertical[:, 2] = placements[:, 2]
        stable = placements[:, 3].astype(int)
        R = se3.rotation_exp(vertical) @ self.Rs_world_object[stable]
        middle = np.column_stack([placements[:, :2], self.center_heights(model)[stable]])
        R = self.R_world_table @ R
        middle = middle @ self.R_world_table.T
        return se3.compose(R, middle - R @ model.center_object)

    def sweep(self, through: Array, along: Array, height: float, reach: float) -> Sweep:
        """Returns the sweep at a height above the table through a point (2,) along a unit vector (2,).

        Its ends are `reach` from the area's middle, measured along its direction [m]. All are along the table's axes.
        """
        start = through + (((self.low + self.high) / 2 - through) @ along - reach) * along
        start_world = self.R_world_table @ [*start, self.table.height + height]
        return Sweep(start_world, self.R_world_table[:, :2] @ along, 2 * reach)

    def center_heights(self, model: ObjectModel) -> Array:
        """Returns (k,) the height [m] of the bounds' middle in each stable pose, along the table's normal."""
        up = self.Rs_world_object[:, 2]
        return np.asarray(self.table.height + up @ model.center_object - (up @ model.vertices.T).min(axis=1))


def resting(model: ObjectModel) -> Array:
    """Returns Rs_world_object (k, 3, 3) of the object's resting poses on a plane, the likeliest first.

    Poses that differ by a symmetry of the object or by a rotation about the vertical count as one. Raises InvalidInput
    for a cloud or an open surface.
    """
    if not (model.closed and len(model.faces)):
        expected = "expected a closed mesh to rest on its faces"
        raise InvalidInput(f"model: {expected}, got a cloud or an open surface")
    turns = se3.rotation_exp(np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None] * [0.0, 0, 1])
    distinct: list[Array] = []
    for pose in resting_poses(model, model.center_of_mass):
        up = -pose.down[0]
        axes = np.linalg.svd(up[None])[2]
        R = np.stack([axes[1], np.cross(up, axes[1]), up])
        turned = se3.compose(turns @ R, np.zeros(3))
        tilts = []
        for other in distinct:
            T_other = se3.compose(other, np.zeros(3))
            ups = nearest(model.symmetries, turned, T_other, model.radius)[:, 2, :3]
            tilts.append(np.arccos(np.clip(ups @ other[2], -1, 1)).min())
        if all(tilt > SAME_STABLE_POSE for tilt in tilts):
            distinct.append(R)
    return np.array(distinct[:MAX_STABLE_POSES])
