"""Surfaces of a hand's links: triangles, and points that are evenly spread over them."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from handsight import se3
from handsight.checks import Array, Indices
from handsight.hand.chains import Chains, transform_points

if TYPE_CHECKING:
    from mujoco import MjModel


class ShapeKind(IntEnum):
    """MuJoCo's kinds of shapes that a hand can have; planes and height fields are none."""

    SPHERE = 2
    CAPSULE = 3
    ELLIPSOID = 4
    CYLINDER = 5
    BOX = 6
    MESH = 7


class LinkMesh(NamedTuple):
    """The surface of one link."""

    vertices: Array  # (k, 3) vertices in the link's axes [m]
    faces: Indices  # (m, 3) numbers of vertices, counterclockwise from outside


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OnLinks:
    """`OnLinks` are points each of which moves with one link of a hand."""

    bodies: tuple[str, ...]  # names of the b links that have any
    body_of: Indices  # (k,) places in `bodies` of the points' links
    chains: Chains  # how `bodies` move in the palm

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose positions are needed to place the links, also those of fingers without a tip."""
        return self.chains.joints


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandShape(OnLinks):
    """Triangles each of which moves with one link of a hand."""

    vertices_body: Array  # (k, 3) vertices in the axes of their link [m]
    faces: Indices  # (m, 3) numbers of vertices, counterclockwise from outside

    @property
    def meshes(self) -> dict[str, LinkMesh]:
        """By link, its triangles in its own axes."""
        first = np.searchsorted(self.body_of, np.arange(len(self.bodies) + 1))
        link = self.body_of[self.faces[:, 0]]
        return {
            body: LinkMesh(self.vertices_body[first[k] : first[k + 1]], self.faces[link == k] - first[k])
            for k, body in enumerate(self.bodies)
        }

    def vertices_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """Returns the vertices (k, 3) in the palm [m]; raises InvalidInput as `Hand.Ts_palm_tip` does."""
        return transform_points(self.vertices_body, self.body_of, self.chains.poses(joint_positions)[0])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandSurface(OnLinks):
    """Points on links of a hand; no object can be deeper in the hand than these points."""

    points_body: Array  # (k, 3) points in the axes of their link [m], inside the surface by the given depth
    normals: Array  # (k, 3) unit outward normals in the axes of their link
    middles: Array  # (b, 3) centroid of each link's points, in its axes [m]

    def points_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """Returns the points (k, 3) in the palm [m]; raises InvalidInput as `Hand.Ts_palm_tip` does."""
        return transform_points(self.points_body, self.body_of, self.chains.poses(joint_positions)[0])

    def points_and_sensitivities(
        self, joint_positions: Mapping[str, float], errors: ArrayLike = 1.0
    ) -> tuple[Array, Array]:
        """Returns the points (k, 3) as `points_palm`, and the sensitivity (b,) of each link's middle to joint errors.

        The sensitivity is the root mean square motion per axis [m] for independent errors in each joint [rad], or for
        `errors` (j, m) as `Rig.joint_errors` has them.
        """
        Ts, axes = self.chains.poses(joint_positions)
        bodies = np.arange(len(self.bodies))
        middles = transform_points(self.middles, bodies, Ts)
        by_joint = self.chains.jacobians(middles, bodies, axes, self.chains.errors(errors))[:, :3]
        points = transform_points(self.points_body, self.body_of, Ts)
        return points, np.sqrt((by_joint**2).sum(axis=(1, 2)) / 3)


def sample_evenly(triangles: list[Array], count: int, seed: int) -> tuple[Indices, Array, Array]:
    """Returns samples as `sample_by_area` does, with the points of each link as even as possible. They are chosen from
    eight times as many; above 1000 points `sample_by_area` is even enough."""
    few = sample_by_area(triangles, count, seed)
    if count > 1000:
        return few
    link, points, normals = sample_by_area(triangles, 8 * count, seed)
    chosen = [np.zeros(0, dtype=np.int64)]
    for k, number in zip(*np.unique(few[0], return_counts=True), strict=True):
        rows = np.flatnonzero(link == k)
        chosen.append(rows[choose_evenly(points[rows], int(number))])
    rows = np.concatenate(chosen)
    return link[rows], points[rows], normals[rows]


def choose_evenly(points: Array, count: int) -> Indices:
    """Returns `count` numbers of points (n, 3), count ≤ n, each the most central of those nearest to it. Farthest-point
    sampling gives the cells; its own points are on edges, the most central ones of the cells are not."""
    place = 0
    nearest = np.full(len(points), np.inf)
    owner = np.zeros(len(points), dtype=np.int64)
    for k in range(count):
        offsets = points - points[place]
        square = np.einsum("ni,ni->n", offsets, offsets)
        owner[square < nearest] = k
        nearest = np.minimum(nearest, square)
        place = int(nearest.argmax())
    chosen = []
    for k in range(count):
        rows = np.flatnonzero(owner == k)
        offsets = points[rows] - points[rows].mean(axis=0)
        chosen.append(rows[np.einsum("ni,ni->n", offsets, offsets).argmin()])
    return np.array(chosen, dtype=np.int64)


def sample_by_area(triangles: list[Array], count: int, seed: int) -> tuple[Indices, Array, Array]:
    """Returns for each of m = `count` points the number of its link (m,), its position and its normal (m, 3).

    `triangles`: (f, 3, 3) for each link. The sampling is stratified: the areas are put in one line, and one point is
    drawn in each of its `count` equal parts. Without any area there are no points.
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


def body_triangles(model: "MjModel", body: int, *, visual: bool = False) -> Array:
    """Returns the triangles (f, 3, 3) of a body's collision shapes, or else of all, in its axes [m]. With `visual` its
    visual shapes, which collide with nothing in most files, or else all."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    shapes = [g for g in range(first, first + count) if model.geom_type[g] in list(ShapeKind)]
    preferred = [g for g in shapes if bool(model.geom_contype[g] or model.geom_conaffinity[g]) != visual]
    triangles = [np.zeros((0, 3, 3))]
    for g in preferred or shapes:
        R = se3.rotation_from_quaternion(model.geom_quat[g][[1, 2, 3, 0]])
        triangles.append(_shape_triangles(model, g) @ R.T + model.geom_pos[g])
    return np.concatenate(triangles)


def _shape_triangles(model: "MjModel", g: int) -> Array:
    """Returns the triangles (f, 3, 3) of a shape in its own axes [m]."""
    kind, size = model.geom_type[g], model.geom_size[g]
    if kind == ShapeKind.MESH:
        mesh = model.geom_dataid[g]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
        first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        corners = vertices[model.mesh_face[first : first + count]]
        volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        return np.asarray(corners if volume > 0 else corners[:, ::-1])
    if kind == ShapeKind.BOX:
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * size
        faces = "130 410 032 240 173 514 571 372 642 276 654 756"
        return np.asarray(corners[[[int(k) for k in face] for face in faces.split()]])
    radius, half, _ = size
    if kind == ShapeKind.CYLINDER:
        return turned(np.array([0, radius, radius, 0]), half * np.array([-1, -1, 1, 1]), 32)
    # The profile of a capsule, that of a ball if its halves are at the same height.
    below = np.linspace(-np.pi / 2, 0, 17)
    angle = np.concatenate([below, -below[::-1]])
    above = np.repeat([-half, half], 17)
    if kind == ShapeKind.CAPSULE:
        return turned(radius * np.cos(angle), radius * np.sin(angle) + above, 64)
    radii = size if kind == ShapeKind.ELLIPSOID else radius
    return np.asarray(turned(np.cos(angle), np.sin(angle), 64) * radii)


def turned(radii: Array, heights: Array, segments: int) -> Array:
    """Returns the triangles (f, 3, 3) that a profile, `radii` and `heights` (k,) upwards, sweeps in a turn about z."""
    angle = 2 * np.pi / segments * np.arange(segments)
    around = np.stack([np.cos(angle), np.sin(angle), np.ones(segments)], axis=1)[:, None]
    low = around * np.column_stack([radii, radii, heights])  # (segments, k, 3)
    next_low = np.roll(low, -1, axis=0)
    a = low[:, :-1]
    b = next_low[:, :-1]
    c = low[:, 1:]
    d = next_low[:, 1:]
    triangles = np.stack([a, b, c, c, b, d], axis=2).reshape(-1, 3, 3)
    areas = np.linalg.norm(np.cross(*(triangles[:, k] - triangles[:, 0] for k in (1, 2))), axis=1)
    return np.asarray(triangles[areas > 1e-9 * areas.max()])  # at the poles, each second one is a line
