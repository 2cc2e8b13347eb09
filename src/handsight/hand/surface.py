"""Points on the surface of a hand's links, which no object can be deeper than."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from handsight import se3
from handsight.checks import Array, Indices
from handsight.hand.chains import Chains, transform_points

SHAPES = SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(2, 8)
"""MuJoCo's kinds of shapes that have a surface to sample; planes and height fields are no part of a hand."""
FINER, MANY = 8, 1000
"""Points drawn for each that is kept; and points that are even enough without choosing."""


@dataclass(frozen=True, slots=True, eq=False)
class HandSurface:
    """Points each of which moves with one link of a hand."""

    bodies: tuple[str, ...]
    """The links that have points."""
    body_of: Indices
    """(m,) places in `bodies`."""
    points_body: Array
    """(m, 3) in the axes of its link [m], inside the surface by what was asked for."""
    normals: Array
    """(m, 3) unit, outward, in the axes of its link."""
    chains: Chains
    """Of `bodies`, from the palm."""
    middles: Array
    """(b, 3) of each link's points, in its axes [m]."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose positions it takes to place the points."""
        return self.chains.joints

    def points_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """(m, 3) where the points are [m]; raises InvalidInput as `Hand.Ts_palm_tip` does.

        Needs the joints of every link that has points, fingers without a tip among them.
        """
        Ts, _ = self.chains.poses(joint_positions)
        return transform_points(self.points_body, self.body_of, Ts)

    def points_and_sensitivities(self, joint_positions: Mapping[str, float]) -> tuple[Array, Array]:
        """The points (m, 3) as `points_palm`, and (b,) how far each link's middle moves per axis [m] when every joint
        is off by a radian, each for itself: root mean square."""
        Ts, axes = self.chains.poses(joint_positions)
        bodies = np.arange(len(self.bodies))
        by_joint = self.chains.jacobians(transform_points(self.middles, bodies, Ts), bodies, axes)[:, :3]
        return transform_points(self.points_body, self.body_of, Ts), np.sqrt(
            (by_joint**2).sum(axis=(1, 2)) / 3
        )


def sample_evenly(triangles: list[Array], count: int, seed: int) -> tuple[Indices, Array, Array]:
    """As `sample_by_area`, each link's points as evenly on it as can be, chosen of FINER times as many; up to MANY of all."""
    if count > MANY:
        return sample_by_area(triangles, count, seed)
    link, _, _ = sample_by_area(triangles, count, seed)
    finer, points, normals = sample_by_area(triangles, FINER * count, seed)
    chosen = [np.zeros(0, dtype=np.int64)]
    for k in np.unique(link):
        mine = np.flatnonzero(finer == k)
        chosen.append(mine[choose_evenly(points[mine], int((link == k).sum()))])
    rows = np.concatenate(chosen)
    return finer[rows], points[rows], normals[rows]


def choose_evenly(points: Array, count: int) -> Indices:
    """(count,) of points (n, 3), count ≤ n: each the middle of those that are nearer to it than to the others.

    First each next one is the farthest from those before, which is on edges; the middle of its share is not.
    """
    place, nearest, owner = 0, np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
    for k in range(count):
        away = points - points[place]
        square = np.einsum("ni,ni->n", away, away)
        owner[square < nearest] = k
        nearest = np.minimum(nearest, square)
        place = int(nearest.argmax())
    chosen = []
    for k in range(count):
        mine = np.flatnonzero(owner == k)
        away = points[mine] - points[mine].mean(axis=0)
        chosen.append(mine[np.einsum("ni,ni->n", away, away).argmin()])
    return np.array(chosen, dtype=np.int64)


def sample_by_area(triangles: list[Array], count: int, seed: int) -> tuple[Indices, Array, Array]:
    """Of each point its place in the list, itself and the outward normal: (m,), (m, 3), (m, 3).

    `triangles`: (f, 3, 3) for each link. Evenly by area: the area is laid out in one line, with one point drawn in
    each of its `count` equal parts.
    """
    rng = np.random.default_rng(seed)
    link = np.repeat(np.arange(len(triangles)), [len(part) for part in triangles])
    corners = np.concatenate(triangles) if triangles else np.zeros((0, 3, 3))
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ends = np.cumsum(np.linalg.norm(crosses, axis=1))
    if not len(ends) or not ends[-1] > 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    along = (np.arange(count) + rng.random(count)) / count * ends[-1]
    chosen = np.searchsorted(ends, along, side="right").clip(max=len(ends) - 1)
    u, v = rng.random((2, count))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("mc,mcx->mx", weights, corners[chosen])
    normals = crosses[chosen] / np.linalg.norm(crosses[chosen], axis=1, keepdims=True)
    return link[chosen], points, normals


def collision_triangles(model: Any, body: int) -> Array:
    """(f, 3, 3) the shapes of a body [m]: those that touch, else those that are seen."""
    shapes = _shapes(model, body)
    touching = [g for g in shapes if model.geom_contype[g] or model.geom_conaffinity[g]]
    return _in_body(model, touching or shapes)


def visual_triangles(model: Any, body: int) -> Array:
    """(f, 3, 3) the shapes of a body [m]: those that are seen, which touch nothing in most files, else all."""
    shapes = _shapes(model, body)
    seen = [g for g in shapes if not (model.geom_contype[g] or model.geom_conaffinity[g])]
    return _in_body(model, seen or shapes)


def _shapes(model: Any, body: int) -> list[int]:
    first = int(model.body_geomadr[body])
    return [g for g in range(first, first + int(model.body_geomnum[body])) if model.geom_type[g] in SHAPES]


def _in_body(model: Any, shapes: list[int]) -> Array:
    found = [np.zeros((0, 3, 3))]
    for g in shapes:
        R = se3.rotation_from_quaternion(model.geom_quat[g][[1, 2, 3, 0]])
        found.append(_corners(model, g) @ R.T + model.geom_pos[g])
    return np.concatenate(found)


def _corners(model: Any, g: int) -> Array:
    """(f, 3, 3) a shape's triangles in its own axes [m]."""
    kind, size = model.geom_type[g], model.geom_size[g]
    if kind == MESH:
        return _mesh(model, model.geom_dataid[g])
    if kind in (SPHERE, ELLIPSOID):
        radii = size if kind == ELLIPSOID else size[:1]
        return np.asarray(trimesh.creation.icosphere(subdivisions=3).triangles * radii)
    if kind == BOX:
        return np.asarray(trimesh.creation.box(2 * size).triangles)
    radius, half, _ = size
    if kind == CYLINDER:
        return np.asarray(trimesh.creation.cylinder(radius, 2 * half).triangles)
    capsule = trimesh.creation.capsule(2 * half, radius)
    # trimesh has had it stand on the origin and about it.
    return np.asarray(capsule.triangles - capsule.bounds.mean(axis=0))


def _mesh(model: Any, mesh: int) -> Array:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    corners = vertices[model.mesh_face[first : first + count]]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return np.asarray(corners if volume > 0 else corners[:, ::-1])
