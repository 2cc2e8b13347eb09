"""Candidates for a grasp: opposed points of an object's hull for thumb and fingers, the best first.

The thumb presses from one side and the fingers, in a row, from the other; the hand comes from the side or from above.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from handsight import se3
from handsight.checks import Array


class GraspOptions(NamedTuple):
    """`GraspOptions` say which grasps of an object on a table are candidates."""

    finger_spacing: float = 0.021  # from finger to finger [m]
    even_directions: int = 12  # of the grip's axis in the table's plane, evenly distributed
    max_directions: int = 24  # these and the directions across the object's sides
    max_width: float = 0.135  # between thumb and fingers [m]
    min_cosine: float = 0.75  # between normals and the grip's axis
    tip_radius: float = 0.0105  # of a tip around its contact, which the table must leave free [m]
    reach: float = 0.08  # how far below the palm tips can be [m]
    friction: float = 0.6  # of contacts that the balance relies on, well below the simulated 1
    cone_edges: int = 8  # of the pyramid that approximates the friction cone
    thumb_force: float = 6.0  # of the thumb [N]
    thumb_force_thin: float = 3.0  # of the thumb on a thin object [N]
    lever: float = 0.04  # arm at which a torque counts as much as a force [m]
    hull_directions: int = 400  # directions whose extreme vertices represent a hull
    examined: int = 60  # candidates of each rest whose forces are balanced, those of the best shape
    same_side_cosine: float = np.cos(np.deg2rad(15.0))  # between normals of one side
    flat_cosine: float = np.cos(np.deg2rad(4.0))  # between normals of a plane side
    stable_margin: float = 0.001  # how far outside a side the centre of mass may be above it [m]
    max_rests: int = 6  # stable poses that are tried
    thin: float = 0.018
    """Half the width of a thin object, across row and grip [m]: fingers alternate between its sides, lest it rolls."""
    wide: float = 0.08  # between thumb and fingers [m]: a wider grip is worse
    reached: float = 0.105  # between thumb and fingers [m]: a wider grip hardly reaches unless it is slanted


GRASP = GraspOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A `Body` is the convex hull of an object in some pose, reduced to few faces."""

    vertices: Array  # (k, 3) [m]
    normals: Array  # (m, 3) outward, of its faces
    offsets: Array  # (m,): inside, normals @ p < offsets [m]
    areas: Array  # (m,) of the faces [m²]
    mass: Array  # (3,) the centre of mass [m]
    middle: Array  # (3,) the middle of the bounds in the object's own frame [m]

    def turned(self, R: Array) -> "Body":
        """Returns the body turned by R (3, 3) and standing on the table, its middle above the origin."""
        vertices = (self.vertices - self.middle) @ R.T
        up = np.array([0.0, 0.0, -vertices[:, 2].min()])
        normals = self.normals @ R.T
        offsets = self.offsets - self.normals @ self.middle + normals @ up
        return Body(vertices + up, normals, offsets, self.areas, (self.mass - self.middle) @ R.T + up, up)


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """A `Hold` is where fingertips are to press on a resting object, in the world; the grip's axis is x."""

    R_world_object: Array  # (3, 3) rotation of the object at rest
    body: Body  # the object as it rests there
    points: Mapping[str, Array]  # (3,) by finger [m]
    normals: Mapping[str, Array]  # (3,) outward normals of the object there
    roll: float  # of the hand about x [rad]
    merit: float  # its rank: about 1 for the best, without a lower bound
    kin: tuple[int, float, float]
    """Number of its resting pose, roll and offset: candidates that share all three tend to fail together."""


def body_of(vertices: Array) -> Body:
    """Returns the hull of `vertices` (k, 3) [m] by its extreme ones, within a hundredth of its size if it is smooth."""
    directions = se3.directions(GRASP.hull_directions)
    kept = vertices[np.unique(np.argmax(vertices @ np.vstack([directions, np.eye(3), -np.eye(3)]).T, axis=0))]
    hull = ConvexHull(kept)
    corners = kept[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = kept.mean(axis=0)
    volumes = np.abs(np.linalg.det(corners - inside))
    mass = inside + volumes @ (corners - inside).sum(axis=1) / (4 * volumes.sum())
    areas = np.linalg.norm(across, axis=1) / 2
    middle = (kept.min(axis=0) + kept.max(axis=0)) / 2
    return Body(kept, hull.equations[:, :3], -hull.equations[:, 3], areas, mass, middle)


def least_rotation(first: Array, second: Array) -> Array:
    """Returns the least rotation (3, 3) that turns one direction (3,) to another, both of any length."""
    a, b = first / np.linalg.norm(first), second / np.linalg.norm(second)
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if (
        sine < 1e-9
    ):  # exact, so that an object that rests as in its file or upside down is not turned by rounding
        axis = np.cross(se3.perpendicular(a), a)
        return np.eye(3) if a @ b > 0 else 2 * np.outer(axis, axis) - np.eye(3)
    return se3.rotation_exp(np.arctan2(sine, a @ b) * axis / sine)


def rests(body: Body) -> list[Array]:
    """Returns rotations Rs_world_object (3, 3) in which the body rests: as in its file, on its largest sides, on end.
    It rests on a side if its centre of mass, projected to the side's plane, is inside all other faces."""
    found = [np.eye(3)]
    heights = body.offsets - body.normals @ body.mass
    sizes = (body.normals @ body.normals.T > GRASP.flat_cosine) @ body.areas
    for i in np.argsort(-sizes, kind="stable"):
        down = body.normals[i]
        stands = (body.normals @ (body.mass + heights[i] * down) - body.offsets).max() < GRASP.stable_margin
        if stands and all(-down @ R[2] < GRASP.same_side_cosine for R in found):
            found.append(least_rotation(down, np.array([0.0, 0, -1])))
    if len(found) > GRASP.max_rests:
        end = max(found[GRASP.max_rests - 1 :], key=lambda R: float(np.ptp(body.vertices @ R[2])))
        found = [*found[: GRASP.max_rests - 1], end]
    return found


def grasp_candidates(body: Body) -> list[Hold]:
    """Returns all holds that geometry and the balance of forces allow, best first."""
    found: list[Hold] = []
    for order, R in enumerate(rests(body)):
        resting: list[Hold] = []
        for direction in _directions(body.turned(R)):
            R_world_object = se3.rotation_exp(np.array([0.0, 0.0, -direction])) @ R
            resting += _holds_along_x(body.turned(R_world_object), R_world_object, order)
        resting.sort(key=lambda hold: -hold.merit)
        for hold in resting[: GRASP.examined]:
            wish = wished(hold.points)
            points, normals = (np.array([*of.values()]) for of in (hold.points, hold.normals))
            pressed, left = forces(points, normals, wish)
            lacking = 1 - np.minimum(np.linalg.norm(pressed, axis=1) / wish, 1.0)
            found.append(replace(hold, merit=hold.merit - left - 0.5 * float(lacking.mean())))
    return sorted(found, key=lambda hold: -hold.merit)


def forces(points: Array, normals: Array, wished: Array) -> tuple[Array, float]:
    """Returns forces (n, 3) of fingers that keep an object at rest, and the unbalanced rest of their wrench [N].

    Fingers press at `points` with outward `normals` (n, 3), each as hard as `wished` (n,) [N] where the balance allows
    it; each force is within the pyramid of friction.
    """
    n, turns = len(points), 2 * np.pi * np.arange(GRASP.cone_edges) / GRASP.cone_edges
    sides = np.linalg.svd(normals[:, None, :])[2][:, 1:]  # two tangents each
    tangents = np.cos(turns)[:, None] * sides[:, None, 0] + np.sin(turns)[:, None] * sides[:, None, 1]
    edges = -normals[:, None] + GRASP.friction * tangents  # (n, cone_edges, 3)
    arms = (points - points.mean(axis=0)) / GRASP.lever
    wrenches = np.concatenate([edges, np.cross(arms[:, None], edges)], axis=2).reshape(-1, 6).T
    each = np.kron(np.eye(n), np.ones(GRASP.cone_edges))
    A = np.vstack([3 * wrenches, 0.5 * each, 0.05 * np.eye(n * GRASP.cone_edges)])
    shares, _ = nnls(A, np.concatenate([np.zeros(6), 0.5 * wished, np.zeros(n * GRASP.cone_edges)]))
    pressed = np.einsum("ne,nek->nk", shares.reshape(n, GRASP.cone_edges), edges)
    return pressed, float(np.linalg.norm(wrenches @ shares))


def wished(points: Mapping[str, Array]) -> Array:
    """Returns (n,) how hard thumb and fingers should press [N]: less on a thin object, which rolls away sooner."""
    width = np.mean([point[0] for finger, point in points.items() if finger != "th"]) - points["th"][0]
    press = GRASP.thumb_force if width > 2 * GRASP.thin else GRASP.thumb_force_thin
    return np.array([press if finger == "th" else press / (len(points) - 1) for finger in points])


def _directions(body: Body) -> list[float]:
    """Returns angles of the grip's axis about the vertical [rad]: across the largest sides, then evenly distributed."""
    upright = np.abs(body.normals[:, 2]) < 0.35
    turns = np.arctan2(body.normals[upright, 1], body.normals[upright, 0])
    order = np.argsort(-body.areas[upright], kind="stable")
    even = 2 * np.pi * np.arange(GRASP.even_directions) / GRASP.even_directions
    found: list[float] = []
    for turn in [*(t for a in turns[order] for t in (a, a + np.pi)), *even]:
        if all(np.cos(turn - other) < GRASP.same_side_cosine for other in found):
            found.append(float(turn))
        if len(found) == GRASP.max_directions:
            break
    return found


def _holds_along_x(body: Body, R: Array, order: int) -> Iterator[Hold]:
    """Yields holds of a body, the grip's axis along x; the body is turned by R (3, 3) from its file, in its
    `order`-th rest."""
    # The hand's roll about the grip's axis: from thumb up beside the object to palm down above it [rad].
    rolls = np.deg2rad([0.0, 45.0, 90.0])
    # Shifts of the grip from the centre of mass along the row of fingers, as shares of the object's size.
    places = (0.0, -0.25, 0.25)
    # Shifts across, as shares of half the size: back towards the palm, for an object that is too wide in the middle
    # may be narrow enough in front of it; and of the fingers by turns to either side.
    offsets = ((0.0, 0.0), (0.35, 0.0), (0.55, 0.0), (0.0, 0.5))
    # Fingers that oppose the thumb; the first is the upper one, or the one further along the world's y.
    finger_rows = (("ff", "mf", "rf", "lf"), ("ff", "mf", "rf"), ("ff", "mf"))
    size = np.ptp(body.vertices, axis=0)
    for roll, place, (offset, zigzag) in product(rolls, places, offsets):
        row = np.array([0.0, np.sin(roll), np.cos(roll)])
        approach = np.array([0, np.cos(roll), -np.sin(roll)])
        centre = body.mass + place * (size @ np.abs(row)) * row
        half = (size @ np.abs(approach)) / 2 * approach
        if zigzag and np.linalg.norm(half) > GRASP.thin:
            continue
        thumb = _exits(body, (centre - offset * half)[None], -1.0)
        for fingers in finger_rows:
            steps = GRASP.finger_spacing * (np.arange(len(fingers))[::-1] - (len(fingers) - 1) / 2)
            lateral = zigzag * (-1.0) ** np.arange(len(fingers)) - offset
            others = _exits(body, centre + steps[:, None] * row + lateral[:, None] * half, 1.0)
            points, normals = (np.vstack(pair) for pair in zip(thumb, others, strict=True))
            if not np.isfinite(points).all() or (np.abs(normals[:, 0]) < GRASP.min_cosine).any():
                continue
            middle, lowest = points[1:].mean(axis=0), float(points[:, 2].min())
            width, straight = float(middle[0] - points[0, 0]), float(np.abs(normals[:, 0]).mean())
            under = np.sin(roll) * (body.vertices[:, 2].max() - points[0, 2])
            if width > GRASP.max_width or lowest < GRASP.tip_radius - 0.002 or under > GRASP.reach:
                continue
            lever = float(np.linalg.norm((body.mass - (middle + points[0]) / 2)[1:]))
            missing_room = max(GRASP.tip_radius + 0.004 - lowest, 0.0)
            merit = (
                straight + 0.1 * (len(points) - 4) - 4 * lever - 3 * max(width - GRASP.wide, 0.0)
                - 30 * max(width * straight - GRASP.reached, 0.0) - 50 * missing_room - 0.1 * (roll > 0)
                - 0.2 * (order > 0) - 0.1 * (offset > 0) + 0.2 * (zigzag > 0)
            )  # fmt: skip
            if merit > -1:
                names, kin = ("th", *fingers), (order, float(roll), offset + zigzag)
                at, outward = (dict(zip(names, each, strict=True)) for each in (points, normals))
                yield Hold(R, body, at, outward, float(roll), merit, kin)


def _exits(body: Body, starts: Array, sense: float) -> tuple[Array, Array]:
    """Returns points (n, 3) where lines along ±x from `starts` (n, 3) leave the body, and the normals (n, 3) there. A
    line that starts outside has NaN."""
    rate = sense * body.normals[:, 0]
    ahead = rate > 1e-9
    below = body.offsets[None] - starts @ body.normals.T
    steps = np.where(ahead, below / np.where(ahead, rate, 1.0), np.inf)
    k = np.argmin(steps, axis=1)
    points = starts + sense * np.take_along_axis(steps, k[:, None], axis=1) * [1.0, 0, 0]
    points[below.min(axis=1) <= 0] = np.nan
    return points, body.normals[k]
