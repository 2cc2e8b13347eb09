"""The points of an object that depth images are compared with: pairs that vote, and which are visible from where."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import pose_score, votes
from handsight.checks import Array
from handsight.objects import ObjectModel, cache

SAMPLES = 600
"""Surface points by which a pose is scored; the model's own 256 vote."""
DIRECTIONS = 200
"""Directions from which it is computed which of them are visible."""


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
    voters = np.stack([model.points_object, model.normals_object])
    places, facing = model.sample(SAMPLES)
    directions = se3.directions(DIRECTIONS)
    surface = model.surface
    # Sheets and exact fields differ where vertices and faces do not.
    name = cache.key(
        f"visible 1 {type(model.fine).__name__}", places, facing, surface.vertices, surface.faces
    )

    def visible_sets() -> NDArray[np.uint8]:
        visible = np.empty((DIRECTIONS, SAMPLES), dtype=np.bool_)
        pose_score.visible_sets(*model.record[:2], places, facing, directions, visible)
        return np.packbits(visible)

    packed = cache.remembered_numbers("bits", name, np.uint8, visible_sets)
    visible = np.unpackbits(packed).reshape(DIRECTIONS, SAMPLES).astype(np.bool_)
    sides = np.stack([places, facing]), directions, visible, float(model.area / SAMPLES)
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
