"""What an object looks like to a depth camera: pairs of its surface points, and which of them each side shows."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels import look_score, votes
from handsight.checks import Array
from handsight.objects import ObjectModel, cache

SAMPLES = 600
"""Surface points by which a pose is judged; the model's own 256 vote."""
DIRECTIONS = 200
"""Sides from which it is known which of them are seen."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What is worked out of an object once."""

    pairs: tuple[NDArray[np.int64], NDArray[np.int32], Array]
    """Where each cell's pairs begin, their first points and their spins."""
    voters: Array
    """(2, 256, 3) points and normals of the pairs."""
    sides: tuple[Array, Array, NDArray[np.bool_]]
    """(2, SAMPLES, 3) points and normals by which a pose is judged; (DIRECTIONS, 3) unit, from the object's centre;
    (DIRECTIONS, SAMPLES) which points are seen from far along each."""
    sample_area: float
    """That each sample stands for [m²]."""


@lru_cache(maxsize=128)  # of a library's objects, which recognition goes through again and again
def appearance_of(model: ObjectModel) -> Appearance:
    """The appearance of an object; what takes long is kept on disk beside its fields."""
    points, normals = model.points_object, model.normals_object
    cells, spins = np.empty((len(points),) * 2, dtype=np.int64), np.empty((len(points),) * 2)
    votes.pairs_of(points, normals, model.diameter, cells, spins)
    order = np.argsort(cells, axis=None, kind="stable")
    order = order[np.searchsorted(cells.reshape(-1)[order], 0) :]
    starts = np.searchsorted(cells.reshape(-1)[order], np.arange(votes.CELLS + 1))
    pairs = starts, (order // len(points)).astype(np.int32), spins.reshape(-1)[order]
    places, facing = model.sample(SAMPLES)
    directions = se3.directions(DIRECTIONS)
    surface = model.surface
    # Sheets and exact fields differ where vertices and faces do not.
    name = cache.key(
        f"visible 1 {type(model.fine).__name__}", places, facing, surface.vertices, surface.faces
    )

    def visible_sets() -> NDArray[np.bool_]:
        visible = np.empty((DIRECTIONS, SAMPLES), dtype=np.bool_)
        look_score.visible_sets(*model.record[:2], places, facing, directions, visible)
        return visible

    visible = cache.remembered_bits(name, (DIRECTIONS, SAMPLES), visible_sets)
    sides = np.stack([places, facing]), directions, visible
    return Appearance(pairs, np.stack([points, normals]), sides, model.area / SAMPLES)
