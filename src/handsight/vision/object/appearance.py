"""The points of an object that depth images are compared with: pairs that vote, and which are visible from where."""

from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel, cache
from handsight.objects.surface import Cloud, Surface
from handsight.vision.candidates import NOTHING_KNOWN, candidates_at, distinct, poses_of
from handsight.vision.kernels import depth_term, pose_score, votes
from handsight.vision.kernels.vision_records import DEPTH_POINT, STAGE

SAMPLES = 2400
FEW = 600
"""Surface points by which a pose is scored, and by which many are compared; the model's own 256 vote."""
DIRECTIONS = 800  # directions from which it is computed which of them are visible


TURNS_STARTS = 1500  # rotations that they are searched from
TURNS_POINTS = 150  # of the surface
TURNS_WITHIN = 0.03  # of the surface, where a point counts as on it [diameters]
TURNS_LEAST = 0.75  # share of the points
TURNS_SPACING = 0.08  # between two of them [diameters]
TURNS_MOST = 48
PIXELS = 200
AWAY = 5
BEHIND = 0.02
"""The object is drawn by so many pixels a diameter and from so many diameters; points that are so little behind what is
drawn are visible [diameters]."""


class Sides(NamedTuple):
    """Points of an object's surface, and which of them are visible from where."""

    samples: Array  # (2, m, 3) points and normals
    directions: Array  # (k, 3) unit, from the object's centre
    visible: NDArray[np.uint8]  # (k, m / 8) which points are visible along each, in bits, the lowest first
    area: float  # the area that each point stands for [m²]


@dataclass(frozen=True, eq=False)
class Appearance:
    """What is computed of an object once, for all depth images."""

    pairs: tuple[NDArray[np.int32], NDArray[np.int32]]
    """Where the pairs of each cell begin, and the pairs: first point and spin of each in one number."""
    voters: Array  # (2, 256, 3) points and normals of the pairs
    sides: Sides  # by which a pose is scored
    few_sides: Sides  # by which many poses are compared
    turns: Array
    """(t, 4, 4) motions of the object that bring most of its surface onto itself, without its symmetries."""


_APPEARANCES = WeakKeyDictionary[ObjectModel, Appearance]()
"""Those of the models that are alive."""


def appearance_of(model: ObjectModel) -> Appearance:
    """Returns the appearance of an object, computed once for each model and forgotten with it."""
    found = _APPEARANCES.get(model)
    if found is None:
        found = _APPEARANCES[model] = _computed(model)
    return found


def _computed(model: ObjectModel) -> Appearance:
    """Returns the appearance of an object; pairs and visible points are kept on disk beside its fields."""
    voters = np.stack([model.points_object, model.normals_object])
    samples = np.stack(model.sample(SAMPLES))
    samples = np.concatenate([samples[:, k :: SAMPLES // FEW] for k in range(SAMPLES // FEW)], axis=1)
    area = model.area / SAMPLES
    if not model.closed:  # a sheet has two sides
        voters[1, ::2] *= -1
        samples[1, ::2] *= -1
        area *= 2
    directions = se3.directions(DIRECTIONS)
    name = cache.key("visible 2", samples, directions, model.vertices, model.faces)
    bits = cache.remembered_numbers(
        "bits", name, np.uint8, lambda: visible_sets(model, samples, directions).reshape(-1)
    )
    packed = bits.reshape(DIRECTIONS, -1)
    sides = Sides(samples, directions, packed, area)
    few = Sides(samples[:, :FEW].copy(), directions, packed[:, : FEW // 8].copy(), area * (SAMPLES // FEW))
    steps = f"{votes.DISTANCES} {votes.ANGLES} {votes.POINT_BITS}"
    name = cache.key(f"pairs 1 {steps}", voters, np.array(model.diameter))
    table = cache.remembered_numbers("numbers", name, np.int32, lambda: pair_table(voters, model.diameter))
    starts, pairs = np.split(table, [votes.CELLS + 1])
    symmetries = model.symmetries
    axes = np.array(symmetries.axes).reshape(-1, 3)
    name = cache.key(
        f"turns 3 {TURNS_STARTS} {TURNS_POINTS} {TURNS_WITHIN} {TURNS_LEAST} {TURNS_SPACING} {TURNS_MOST}",
        *voters,
        symmetries.rotations,
        axes,
    )
    turns = cache.remembered_numbers("turns", name, np.float64, lambda: near_symmetries(model).reshape(-1))
    return Appearance((starts, pairs), voters, sides, few, turns.reshape(-1, 4, 4))


def pair_table(voters: Array, diameter: float) -> NDArray[np.int32]:
    """Returns where the pairs of each cell begin, and then the pairs, of points and normals (2, n, 3)."""
    points, normals = voters
    count = len(points)
    cells = np.empty(count**2, dtype=np.int64)
    spins = np.empty(count**2)
    square = count, count
    votes.pairs_of(points, normals, diameter, cells.reshape(square), spins.reshape(square))
    order = np.argsort(cells, kind="stable")
    order = order[cells[order] >= 0]
    starts = np.searchsorted(cells[order], np.arange(votes.CELLS + 1))
    turns = np.floor(spins[order] * (votes.TURN / (2 * np.pi))).astype(np.int64) % votes.TURN
    pairs = (order // count << votes.POINT_BITS) + turns
    return np.concatenate([starts, pairs]).astype(np.int32)


def drawn_surface(surface: Surface) -> tuple[Array, Indices]:
    """Returns vertices (k, 3) [m] and triangles (m, 3) by which a surface is drawn, one for each point of a cloud."""
    if not isinstance(surface, Cloud):
        return surface.vertices, surface.faces
    across = se3.perpendicular(surface.normals)
    up = np.cross(surface.normals, across)
    angles = 2 * np.pi / 3 * np.arange(3)[:, None, None]
    reach = 1.5 * np.sqrt(surface.areas)[:, None]
    corners = surface.vertices + reach * (np.cos(angles) * across + np.sin(angles) * up)
    triangles = np.arange(3 * len(across)).reshape(3, -1).T
    return corners.reshape(-1, 3), triangles


def visible_sets(model: ObjectModel, samples: Array, directions: Array) -> NDArray[np.uint8]:
    """Returns (k, m / 8) which of the samples (2, m, 3) are visible along each direction (k, 3), in bits. The object is
    drawn from a few diameters off, which is as far as cameras are."""
    vertices, faces = drawn_surface(model.surface)
    points, normals = samples
    focal = PIXELS * AWAY
    size = int(1.2 * PIXELS)
    matrix = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    camera = Camera(matrix, (size, size))
    visible = []
    for way in directions:
        x = se3.perpendicular(way)
        R = np.stack([x, np.cross(-way, x), -way])
        shift = [0, 0, AWAY * model.diameter] - R @ model.center_object
        depth = camera.draw(vertices @ R.T + shift, faces).depth
        at = points @ R.T + shift
        column, row = np.rint(camera.project(at)).astype(int).T
        facing = -((normals @ R.T) * at).sum(axis=1) / np.linalg.norm(at, axis=1)
        behind = at[:, 2] - depth[row, column]
        clear = (facing > pose_score.MIN_FACING) & (behind < BEHIND * model.diameter)
        visible.append(np.packbits(clear, bitorder="little"))
    return np.stack(visible)


def near_symmetries(model: ObjectModel) -> Array:
    """Returns (t, 4, 4) motions, without symmetries, that bring most of the surface onto itself, such as the turns of a
    mug about its axis, which only the handle shows.

    Points of the surface are laid onto it from many rotations, as those of an image are, and then from products of
    those motions that are found.
    """
    points, normals = model.sample(TURNS_POINTS)
    rows = np.zeros(len(points), dtype=DEPTH_POINT)
    rng = np.random.default_rng(0)
    rows["point"], rows["normal"] = points, normals
    stages = np.array(
        [(0, 4 * TURNS_WITHIN, 2 * TURNS_WITHIN, 6, 1), (1, 2 * TURNS_WITHIN, TURNS_WITHIN, 6, 1)],
        dtype=STAGE,
    )

    def about_center(R: Array) -> Array:
        return se3.compose(R, model.center_object - R @ model.center_object)

    def shares(Ts: Array) -> Array:
        """Returns which share of the points is on the surface after motions (k, 4, 4), with its normal."""
        distance, gradient, _ = model.fine.evaluate(se3.apply(se3.inverse(Ts), points).reshape(-1, 3))
        g = gradient.reshape(len(Ts), -1, 3) @ Ts[:, :3, :3].swapaxes(1, 2)
        same = np.abs(distance).reshape(len(Ts), -1) < TURNS_WITHIN * model.diameter
        return np.asarray((same & (np.abs((g * normals).sum(2)) > 0.5 * np.linalg.norm(g, axis=2))).mean(1))

    found = np.eye(4)[None]
    share = np.full(1, 2.0)
    starts = about_center(se3.random(rng, TURNS_STARTS)[:, :3, :3])
    for _ in range(2):
        laid = candidates_at(starts)
        laid["bound"] = 0.01 * model.diameter
        depth_term.refine_poses(*model.record[:2], rows, stages, model.diameter, NOTHING_KNOWN, laid)
        Ts = poses_of(laid)
        likely = shares(Ts) > TURNS_LEAST * shares(np.eye(4)[None])
        found = np.concatenate([found, Ts[likely]])
        share = np.append(share, shares(Ts[likely]))
        starts = np.matmul(*found[rng.integers(len(found), size=(2, TURNS_STARTS // 2))])
    # A shift alone is none: the search tries those by itself.
    turned = candidates_at(about_center(found[:, :3, :3]))
    turned["votes"] = np.arange(len(turned))
    turned = distinct(model, turned, share, TURNS_MOST + 1, TURNS_SPACING)
    return np.asarray(found[turned["votes"][1:].astype(int)])
