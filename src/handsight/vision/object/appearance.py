"""The points of an object that depth images are compared with: pairs that vote, and which are visible from where."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import pose_score, votes
from handsight.camera import Camera
from handsight.checks import Array
from handsight.objects import ObjectModel, cache
from handsight.objects.surface import Cloud

SAMPLES = 600
"""Surface points by which a pose is scored; the model's own 256 vote."""
DIRECTIONS = 200
"""Directions from which it is computed which of them are visible."""

PIXELS, AWAY, BEHIND = 200, 5.0, 0.02
"""The object is drawn by so many pixels a diameter and from so many diameters; points that are so little behind what is
drawn are visible [diameters]."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """An `Appearance` is computed of an object once, for all depth images."""

    pairs: tuple[NDArray[np.int32], NDArray[np.int32]]
    """Where the pairs of each cell begin, and the pairs: first point and spin of each in one number."""
    voters: Array
    """(2, 256, 3) points and normals of the pairs."""
    sides: tuple[Array, Array, NDArray[np.bool_], float]
    """(2, SAMPLES, 3) points and normals by which a pose is scored; (DIRECTIONS, 3) unit, from the object's centre;
    (DIRECTIONS, SAMPLES) which points are visible from far along each; the area that each point stands for [m²]."""


@lru_cache(maxsize=128)  # of a library's objects, which recognition goes through again and again
def appearance_of(model: ObjectModel) -> Appearance:
    """Returns the appearance of an object; pairs and visible points are kept on disk beside its fields."""
    voters, places, facing = np.stack([model.points_object, model.normals_object]), *model.sample(SAMPLES)
    area = model.area / SAMPLES
    if not model.closed:  # a sheet has two sides
        voters = np.concatenate([voters, voters * [[[1]], [[-1]]]], axis=1)
        facing[1::2] *= -1
        area *= 2
    directions = se3.directions(DIRECTIONS)
    surface = model.surface
    name = cache.key("visible 2", places, facing, surface.vertices, surface.faces)
    packed = cache.remembered_numbers(
        "bits", name, np.uint8, lambda: np.packbits(visible_sets(model, places, facing, directions))
    )
    visible = np.unpackbits(packed)[: DIRECTIONS * SAMPLES].reshape(DIRECTIONS, SAMPLES).astype(np.bool_)
    sides = np.stack([places, facing]), directions, visible, float(area)
    count, diameter = voters.shape[1], model.diameter

    def table() -> NDArray[np.int32]:
        cells, spins = np.empty((count, count), dtype=np.int64), np.empty((count, count))
        votes.pairs_of(voters[0], voters[1], diameter, cells, spins)
        cell, spin = cells.reshape(-1), spins.reshape(-1)
        order = np.argsort(cell, kind="stable")
        order = order[np.searchsorted(cell[order], 0) :]
        starts = np.searchsorted(cell[order], np.arange(votes.CELLS + 1))
        turns = np.floor(spin[order] * (votes.TURN / (2 * np.pi))).astype(np.int64) % votes.TURN
        return np.concatenate([starts, (order // count << votes.POINT_BITS) + turns]).astype(np.int32)

    steps = f"{votes.DISTANCES} {votes.ANGLES} {votes.POINT_BITS}"
    name = cache.key(f"pairs 1 {steps}", voters, np.array(diameter))
    starts, pairs = np.split(cache.remembered_numbers("numbers", name, np.int32, table), [votes.CELLS + 1])
    return Appearance((starts, pairs), voters, sides)


def visible_sets(model: ObjectModel, places: Array, facing: Array, directions: Array) -> NDArray[np.bool_]:
    """Returns (k, m) which surface points (m, 3) with normals (m, 3) are visible along each direction (k, 3).

    The object is drawn from a few diameters off, which is as far as cameras are.
    """
    surface, D, away = model.surface, model.diameter, AWAY * model.diameter
    vertices, faces = surface.vertices, surface.faces
    if isinstance(surface, Cloud):  # a triangle for each point
        across = se3.perpendicular(surface.normals)
        up = np.cross(surface.normals, across)
        turns = 2 * np.pi / 3 * np.arange(3)[:, None, None]
        reach = 1.5 * np.sqrt(surface.areas)[:, None]
        vertices = (surface.vertices + reach * (np.cos(turns) * across + np.sin(turns) * up)).swapaxes(0, 1)
        vertices, faces = vertices.reshape(-1, 3), np.arange(3 * len(surface.vertices)).reshape(-1, 3)
    focal, middle = PIXELS * AWAY, PIXELS * 0.6
    camera = Camera(
        np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]]), (int(2 * middle), int(2 * middle))
    )
    visible = np.empty((len(directions), len(places)), dtype=np.bool_)
    for k, way in enumerate(directions):
        x = se3.perpendicular(way)
        R = np.stack([x, np.cross(-way, x), -way])
        depth = camera.draw((vertices - model.center_object) @ R.T + [0, 0, away], faces).depth
        at = (places - model.center_object) @ R.T + [0, 0, away]
        column, row = (np.round(focal * at[:, i] / at[:, 2] + middle).astype(int) for i in (0, 1))
        ray = at / np.linalg.norm(at, axis=1, keepdims=True)
        visible[k] = -((facing @ R.T) * ray).sum(axis=1) > pose_score.MIN_FACING
        visible[k] &= at[:, 2] < depth[row, column] + BEHIND * D
    return visible
