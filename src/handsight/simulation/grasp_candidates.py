"""Where thumb and fingers could hold an object: opposed points of its hull, the promising ones first.

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

Fingers = tuple[str, ...]
ROWS: tuple[Fingers, ...] = (("ff", "mf", "rf", "lf"), ("ff", "mf", "rf"), ("ff", "mf"))
"""Fingers that oppose the thumb; the first is the upper one, or the one further along the world's y."""


class GraspOptions(NamedTuple):
    """`GraspOptions` say which grasps of an object on a table are candidates."""

    finger_spacing: float = 0.021  # from finger to finger [m]
    even_directions: int = 12  # of the grip's axis in the table's plane, evenly spread
    max_directions: int = 24  # with those across sides
    max_width: float = 0.135  # between thumb and fingers [m]
    min_cosine: float = 0.75  # between normals and the grip's axis
    tip_radius: float = 0.0105  # of a tip about its contact, which the table must leave room for [m]
    reach: float = 0.08  # how far under the palm tips can be [m]
    friction: float = 0.6  # of contacts that are counted on, well below the simulated 1
    cone_edges: int = 8  # of the pyramid that stands for the friction cone
    thumb_force: float = 6.0  # of the thumb [N]
    thumb_force_thin: float = 3.0  # of the thumb on what is thin [N]
    lever: float = 0.04  # a torque that counts as much as a force acts at this distance [m]
    hull_directions: int = 400  # directions in which a hull is kept
    examined: int = 60  # holds of each rest whose forces are balanced, best by their shape first
    same_side_cosine: float = np.cos(np.deg2rad(15.0))  # between normals of one side
    flat_cosine: float = np.cos(np.deg2rad(4.0))  # between normals of a plane side
    stable_margin: float = 0.001
    """How far beyond a side's edge what rests on it may have its centre of mass [m]."""
    max_rests: int = 6  # stable poses that are tried
    thin: float = 0.018
    """Half of what is thin, across row and grip [m]: fingers to either side of it, by turns, keep it from rolling."""
    wide: float = 0.08  # between thumb and fingers [m]: a wider grip is worse
    reached: float = 0.105  # a still wider one is hardly reached where it is not slanted [m]


GRASP = GraspOptions()

ROLLS = tuple(np.deg2rad([0.0, 45.0, 90.0]))
"""Of the hand about the grip's axis: thumb up beside the object, to palm down above it [rad]."""
PLACES, OFFSETS = (0.0, -0.25, 0.25), ((0.0, 0.0), (0.35, 0.0), (0.55, 0.0), (0.0, 0.5))
"""Of the grip from the centre of mass, in parts of the size there: along the row. Then, in parts of half the size: back
towards the palm, for what is too wide in the middle may be held in front of it; and by turns to either side."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A `Body` is a convex body in a pose: what the search looks at instead of thousands of facets."""

    vertices: Array
    """(k, 3) [m]."""
    normals: Array
    """(m, 3) outward, of its faces."""
    offsets: Array
    """(m,): inside, normals @ p < offsets [m]."""
    areas: Array
    """(m,) [m²]."""
    mass: Array
    """(3,) its centre of mass [m]."""
    middle: Array
    """(3,) of the bounds that it has in its own frame [m]."""

    def turned(self, R: Array) -> "Body":
        """Returns the same, turned by R (3, 3), on the table, its middle over the origin."""
        vertices = (self.vertices - self.middle) @ R.T
        up = np.array([0.0, 0.0, -vertices[:, 2].min()])
        normals = self.normals @ R.T
        offsets = self.offsets - self.normals @ self.middle + normals @ up
        return Body(vertices + up, normals, offsets, self.areas, (self.mass - self.middle) @ R.T + up, up)


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """A `Hold` is points of a resting object that fingertips are to press on, in the world; the grip's axis is x."""

    R_world_object: Array
    """(3, 3)"""
    body: Body
    """The object as it rests there."""
    points: Mapping[str, Array]
    """(3,) by finger [m]."""
    normals: Mapping[str, Array]
    """(3,) outward normals of the object there."""
    roll: float
    """Of the hand about x [rad]."""
    merit: float
    """What ranks it: about 1 for the best, however low for the worst."""
    kin: tuple[int, float, float]
    """Those of the same rest, roll and offset, which fail alike."""


def body_of(vertices: Array) -> Body:
    """Returns the hull (k, 3) [m] by its extreme vertices: a smooth one within a hundredth of its size of the whole."""
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


def rests(body: Body) -> list[Array]:
    """Yields rotations Rs_world_object (3, 3): as its file has it, then on the largest sides that carry it, then on
    end.

    A side carries what has its centre of mass above it: where that is projected, no other face ends the body.
    """
    found = [np.eye(3)]
    heights = body.offsets - body.normals @ body.mass
    sizes = (body.normals @ body.normals.T > GRASP.flat_cosine) @ body.areas
    for i in np.argsort(-sizes, kind="stable"):
        down = body.normals[i]
        stands = (body.normals @ (body.mass + heights[i] * down) - body.offsets).max() < GRASP.stable_margin
        if stands and all(-down @ R[2] < GRASP.same_side_cosine for R in found):
            found.append(_standing_on(down))
    if len(found) > GRASP.max_rests:
        end = max(found[GRASP.max_rests - 1 :], key=lambda R: float(np.ptp(body.vertices @ R[2])))
        found = [*found[: GRASP.max_rests - 1], end]
    return found


def grasp_candidates(body: Body) -> list[Hold]:
    """Returns all that geometry and balanced forces let one hope for, best first."""
    found: list[Hold] = []
    for order, R in enumerate(rests(body)):
        mine: list[Hold] = []
        for direction in _directions(body.turned(R)):
            R_world_object = se3.rotation_exp(np.array([0.0, 0.0, -direction])) @ R
            mine += _across(body.turned(R_world_object), R_world_object, order)
        mine.sort(key=lambda hold: -hold.merit)
        found += [_balanced(hold) for hold in mine[: GRASP.examined]]
    return sorted(found, key=lambda hold: -hold.merit)


def forces(points: Array, normals: Array, wished: Array) -> tuple[Array, float]:
    """Returns (n, 3) forces of fingers on an object that keep it at rest, and what they leave unbalanced [N].

    `points`, outward `normals` (n, 3); `wished` (n,): how hard each should press [N]. Each force is within the pyramid
    of friction, as near to what is wished as the balance allows.
    """
    n, turns = len(points), 2 * np.pi * np.arange(GRASP.cone_edges) / GRASP.cone_edges
    sides = np.linalg.svd(normals[:, None, :])[2][:, 1:]  # two tangents each
    tangents = np.cos(turns)[:, None] * sides[:, None, 0] + np.sin(turns)[:, None] * sides[:, None, 1]
    edges = -normals[:, None] + GRASP.friction * tangents  # (n, EDGES, 3)
    arms = (points - points.mean(axis=0)) / GRASP.lever
    wrenches = np.concatenate([edges, np.cross(arms[:, None], edges)], axis=2).reshape(-1, 6).T
    each = np.kron(np.eye(n), np.ones(GRASP.cone_edges))
    A = np.vstack([3 * wrenches, 0.5 * each, 0.05 * np.eye(n * GRASP.cone_edges)])
    shares, _ = nnls(A, np.concatenate([np.zeros(6), 0.5 * wished, np.zeros(n * GRASP.cone_edges)]))
    pressed = np.einsum("ne,nek->nk", shares.reshape(n, GRASP.cone_edges), edges)
    return pressed, float(np.linalg.norm(wrenches @ shares))


def wished(points: Mapping[str, Array]) -> Array:
    """Returns (n,) how hard thumb and fingers shall press [N]: the less, the sooner what is thin rolls away between
    them."""
    width = np.mean([point[0] for finger, point in points.items() if finger != "th"]) - points["th"][0]
    press = GRASP.thumb_force if width > 2 * GRASP.thin else GRASP.thumb_force_thin
    return np.array([press if finger == "th" else press / (len(points) - 1) for finger in points])


def _standing_on(down: Array) -> Array:
    """Returns (3, 3) the least turn that brings a direction of the object to the world's -z."""
    axis = np.cross(down, [0.0, 0, -1])
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return np.eye(3) if down[2] < 0 else np.diag([1.0, -1, -1])
    return se3.rotation_exp(np.arctan2(sine, -down[2]) * axis / sine)


def _directions(body: Body) -> list[float]:
    """Turns of the grip's axis about the vertical [rad]: across the largest sides, where polygons are narrowest, then
    all round."""
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


def _across(body: Body, R: Array, order: int) -> Iterator[Hold]:
    """Yields holds whose axis is x, of one pose of the object."""
    size = np.ptp(body.vertices, axis=0)
    for roll, place, (offset, zigzag) in product(ROLLS, PLACES, OFFSETS):
        row, approach = (
            np.array([0.0, np.sin(roll), np.cos(roll)]),
            np.array([0, np.cos(roll), -np.sin(roll)]),
        )
        centre = body.mass + place * (size @ np.abs(row)) * row
        half = (size @ np.abs(approach)) / 2 * approach
        if zigzag and np.linalg.norm(half) > GRASP.thin:
            continue
        thumb = _met(body, (centre - offset * half)[None], -1.0)
        for fingers in ROWS:
            steps = GRASP.finger_spacing * (np.arange(len(fingers))[::-1] - (len(fingers) - 1) / 2)
            lateral = zigzag * (-1.0) ** np.arange(len(fingers)) - offset
            others = _met(body, centre + steps[:, None] * row + lateral[:, None] * half, 1.0)
            points, normals = (np.vstack(pair) for pair in zip(thumb, others, strict=True))
            if np.isfinite(points).all() and (np.abs(normals[:, 0]) >= GRASP.min_cosine).all():
                merit = (
                    _merit(body, points, normals, float(roll))
                    - 0.2 * (order > 0)
                    - 0.1 * (offset > 0)
                    + 0.2 * (zigzag > 0)
                )
                names = ("th", *fingers)
                if merit > -1:
                    yield Hold(
                        R, body, dict(zip(names, points, strict=True)), dict(zip(names, normals, strict=True)),
                        float(roll), merit, (order, float(roll), offset + zigzag),
                    )  # fmt: skip


def _met(body: Body, starts: Array, sense: float) -> tuple[Array, Array]:
    """Returns points (n, 3) where lines along ±x from inside leave the body, NaN from outside, and the normals
    there."""
    rate = sense * body.normals[:, 0]
    ahead = rate > 1e-9
    below = body.offsets[None] - starts @ body.normals.T
    steps = np.where(ahead, below / np.where(ahead, rate, 1.0), np.inf)
    k = np.argmin(steps, axis=1)
    points = starts + sense * np.take_along_axis(steps, k[:, None], axis=1) * [1.0, 0, 0]
    points[below.min(axis=1) <= 0] = np.nan
    return points, body.normals[k]


def _merit(body: Body, points: Array, normals: Array, roll: float) -> float:
    """Returns what the shape of a hold is worth; -inf where no hand could have it."""
    fingers = points[1:].mean(axis=0)
    width, lowest = float(fingers[0] - points[0, 0]), float(points[:, 2].min())
    under = np.sin(roll) * (body.vertices[:, 2].max() - points[0, 2])
    if width > GRASP.max_width or lowest < GRASP.tip_radius - 0.002 or under > GRASP.reach:
        return -np.inf
    straight = float(np.abs(normals[:, 0]).mean())
    lever = float(np.linalg.norm((body.mass - (fingers + points[0]) / 2)[1:]))
    room = max(GRASP.tip_radius + 0.004 - lowest, 0.0)
    return (
        straight + 0.1 * (len(points) - 4) - 4 * lever - 3 * max(width - GRASP.wide, 0.0)
        - 30 * max(width * straight - GRASP.reached, 0.0) - 50 * room - 0.1 * (roll > 0)
    )  # fmt: skip


def _balanced(hold: Hold) -> Hold:
    """Returns the same, worth less by the force that is left over and by what cannot be pressed."""
    wish = wished(hold.points)
    found, left = forces(np.array([*hold.points.values()]), np.array([*hold.normals.values()]), wish)
    lacking = 1 - np.minimum(np.linalg.norm(found, axis=1) / wish, 1.0)
    return replace(hold, merit=hold.merit - left - 0.5 * float(lacking.mean()))
