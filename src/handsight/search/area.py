"""Where on a table an object may be before anything has touched it."""

from dataclasses import dataclass

import numpy as np

from handsight import checks, se3
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest
from handsight.rig import Table

MOST_RESTS = 24
SAME_REST = float(np.deg2rad(20.0))
"""Two ways to stand that differ by less are one [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """A prior over poses of an object that stands on a table: somewhere in a rectangle, turned somehow."""

    low: Array
    """(2,) least x and y in the world of the middle of the object's bounds [m]."""
    high: Array
    """(2,) the largest."""
    table: Table
    """What it stands on."""
    Rs_world_object: Array
    """(k, 3, 3) how it may stand, each as likely, up to a turn about the vertical."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        low, high = (checks.position(getattr(self, name), f"area.{name}", (2,)) for name in ("low", "high"))
        if not (low < high).all():
            raise InvalidInput(f"area: expected low below high, got {low.tolist()} and {high.tolist()}")
        if not isinstance(self.table, Table):
            raise InvalidInput(f"area.table: expected a Table, got {type(self.table).__name__}")
        Rs = checks.finite(self.Rs_world_object, "area.Rs_world_object", (None, 3, 3))
        checks.integer(len(Rs), "area.Rs_world_object: rotations", MOST_RESTS)
        for i, R in enumerate(Rs):
            se3.check(se3.compose(R, np.zeros(3)), f"area.Rs_world_object[{i}]")
        if not len(Rs):
            raise InvalidInput("area.Rs_world_object: expected at least one way to stand, got none")
        for name, value in (("low", low), ("high", high), ("Rs_world_object", Rs)):
            object.__setattr__(self, name, value)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """(n, 4) places: x, y [m], turn about the vertical [rad], and which way to stand."""
        xy = rng.uniform(self.low, self.high, (n, 2))
        rests = rng.integers(len(self.Rs_world_object), size=n)
        return np.column_stack([xy, rng.uniform(-np.pi, np.pi, n), rests])

    def holds(self, places: Array) -> Mask:
        """(n,) whether places (n, 4) are in the area."""
        return np.asarray(((places[:, :2] >= self.low) & (places[:, :2] <= self.high)).all(axis=1))

    def poses(self, model: ObjectModel, places: Array) -> Array:
        """Ts_world_object (n, 4, 4) of the object at places (n, 4)."""
        vertical = np.zeros((len(places), 3))
        vertical[:, 2] = places[:, 2]
        rests = places[:, 3].astype(int)
        R = se3.rotation_exp(vertical) @ self.Rs_world_object[rests]
        middle = np.column_stack([places[:, :2], self.middles(model)[rests]])
        return se3.compose(R, middle - R @ model.center_object)

    def middles(self, model: ObjectModel) -> Array:
        """(k,) height of the middle of the object's bounds for each way to stand [m]."""
        up = self.Rs_world_object[:, 2]
        return np.asarray(self.table.height + up @ model.center_object - (up @ model.vertices.T).min(axis=1))

    def tops(self, model: ObjectModel) -> Array:
        """(k,) height of the object's highest point for each way to stand [m]."""
        up = self.Rs_world_object[:, 2] @ model.vertices.T
        return np.asarray(self.table.height + up.max(axis=1) - up.min(axis=1))


def resting(model: ObjectModel) -> Array:
    """Rs_world_object (k, 3, 3) of the ways in which the object can stand on a plane, the likeliest first.

    The faces of its convex hull that carry what has the same weight all through (trimesh's stable poses), modulo the
    object's symmetries and turns about the vertical. Raises InvalidInput for a cloud or an open surface.
    """
    import trimesh

    if not (model.closed and len(model.faces)):
        raise InvalidInput(
            "model: expected a closed mesh to rest on its faces, got a cloud or an open surface"
        )
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    Ts, _ = trimesh.poses.compute_stable_poses(mesh, n_samples=1, threshold=1e-3)
    found: list[Array] = []
    for R in (T[:3, :3] for T in Ts):
        if all(_tilt_between(model, R, other) > SAME_REST for other in found):
            found.append(R)
    return np.array(found[:MOST_RESTS])


def _tilt_between(model: ObjectModel, R: Array, other: Array) -> float:
    """Between the ups of two ways to stand, modulo symmetry [rad]."""
    turns = se3.rotation_exp(np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None] * [0.0, 0, 1])
    Ts = se3.compose(turns @ R, np.zeros(3))
    T = se3.compose(other, np.zeros(3))
    ups = nearest(model.symmetries, Ts, T, model.radius)[:, 2, :3]
    return float(np.arccos(np.clip(ups @ other[2], -1, 1)).min())
