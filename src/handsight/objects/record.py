"""An object as the record and the grid nodes that kernels take (`handsight._kernels.records`)."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import records
from handsight.objects.symmetry import Symmetries

if TYPE_CHECKING:
    from handsight.objects.model import ObjectModel

Record = NDArray[np.void]
Nodes = NDArray[np.float32]


class RecordOptions(NamedTuple):
    """`RecordOptions` are what kernels are given of an object."""

    edge: float = 0.75  # radius of curvature below which the surface counts as an edge [coarse cells]
    facet_margin: float = 0.01  # facets may be this far within the surface that they stand for [diameters]
    normal_weight: float = 1.3
    """What a unit of normal counts as when contacts are matched with samples [diameters]."""
    band: float = 1.6  # of the samples' spacing: the tangential distance that costs nothing
    tangential: float = 0.32  # the standard deviation of what is beyond it, of the samples' spacing
    patch: float = 0.02  # how far a patch is off its sample's plane, of the samples' spacing


RECORD = RecordOptions()

LEAST_ERROR = (1e-4, 2e-3)
"""No model is better than this: of its place [diameters] and of its normal [rad]."""
COARSE_ERROR = (0.03, 0.03)
"""How far the smooth field is off on faces: of its distance [cells] and of its normal [rad]."""


class ModelRecord(NamedTuple):
    """A `ModelRecord` is an object as kernels take it."""

    model: Record
    """(1,) MODEL."""
    nodes: Nodes
    """Of its grids, one after another."""
    symmetry_known: bool
    """Whether kernels know its symmetry."""


def model_record(model: "ObjectModel") -> ModelRecord:
    """Returns the record of an object."""
    record = np.zeros(1, dtype=records.MODEL)
    row, spacing = record[0], model.sample_spacing
    coarse = model.coarse.fill(row["coarse"], 0)
    nodes = [coarse, model.fine.fill(row["fine"], len(coarse))]
    row["coarse"]["variance_distance"] = (COARSE_ERROR[0] * model.coarse.cell) ** 2
    row["coarse"]["variance_normal"] = COARSE_ERROR[1] ** 2
    row["radius"], row["center"] = model.radius, model.center_object
    row["bounds"] = model.bounds_object + RECORD.facet_margin * model.diameter * np.array([[-1.0], [1.0]])
    row["edge_curvature2"] = 1 / (RECORD.edge * model.coarse.cell) ** 2
    error, place_by_place = row["error"], model.field_error
    error["least_distance"] = (LEAST_ERROR[0] * model.diameter) ** 2
    error["least_normal"] = LEAST_ERROR[1] ** 2
    if place_by_place is not None:
        error["inverse_cell"], error["origin"] = 1 / place_by_place.cell, place_by_place.origin
        error["shape"], error["nodes"] = place_by_place.values.shape[:3], sum(map(len, nodes))
        nodes.append(place_by_place.values.astype(np.float32).reshape(-1))
    _fill_symmetry(row["symmetry"], model.symmetries)
    row["normal_weight2"] = (RECORD.normal_weight * model.diameter) ** 2
    row["band"], row["tangential_weight"] = RECORD.band * spacing, 1 / (RECORD.tangential * spacing) ** 2
    row["sample_variance_distance"] = (RECORD.patch * spacing) ** 2
    row["sample_variance_normal"] = model.sigma_normal**2
    row["samples"][:, 0], row["samples"][:, 1] = model.points_object, model.normals_object
    row["scan"][0] = (model.points_object**2).sum(axis=1)
    row["scan"][1:4], row["scan"][4:] = model.points_object.T, model.normals_object.T
    known = row["symmetry"]["kind"] != records.OTHER_SYMMETRY
    return ModelRecord(record, np.concatenate(nodes), bool(known))


def _fill_symmetry(row: np.void, symmetries: Symmetries) -> None:
    row["kind"], row["axes"] = _known_symmetry(symmetries), len(symmetries.axes)
    for k, (point, direction) in enumerate(symmetries.axes):
        row["pivot"], row["axis"][k] = point, direction
    count = min(len(symmetries.rotations), records.MOST_ROTATIONS)
    row["rotations"], row["rotation"][:count] = count, symmetries.rotations[:count, :3]


def _known_symmetry(symmetries: Symmetries) -> int:
    """Returns which of the kernels' kinds of symmetry an object has; OTHER_SYMMETRY where they know none like it."""
    if symmetries.trivial:
        return records.NO_SYMMETRY
    if len(symmetries.rotations) > records.MOST_ROTATIONS:
        return records.OTHER_SYMMETRY
    if not symmetries.axes:
        return records.DISCRETE
    point, direction = symmetries.axes[0]
    along = (point @ direction) * direction
    through = np.abs(point - along).max() < 1e-15
    return records.AXIS if len(symmetries.axes) == 1 and through else records.OTHER_SYMMETRY
