"""An object as the record and the grid nodes that kernels take (`handsight._kernels.records`)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import records
from handsight.objects.geometry import Geometry
from handsight.objects.symmetry import Symmetries


class RecordOptions(NamedTuple):
    """`RecordOptions` are the errors and weights that kernels are given of an object."""

    edge: float = 0.75  # radius of curvature below which the surface counts as an edge [coarse cells]
    facet_margin: float = 0.01  # how far facets may be within the surface that they approximate [diameters]
    normal_weight: float = 1.3
    """Distance by which a unit of normal counts when contacts are matched with samples [diameters]."""
    band: float = 1.6  # tangential distance to a sample that costs nothing [spacings of the samples]
    tangential: float = 0.32  # standard deviation of the distance beyond it [spacings]
    patch: float = 0.02  # standard deviation of the surface about a sample's plane [spacings]
    least_distance: float = 1e-4  # no model's surface is assumed to be more exact than this [diameters]
    least_normal: float = 2e-3  # and no model's normal [rad]
    coarse_distance: float = 0.03  # error of the smooth field on faces: of its distance [coarse cells]
    coarse_normal: float = 0.03  # and of its normal [rad]


RECORD = RecordOptions()


class ModelRecord(NamedTuple):
    """A `ModelRecord` is an object as kernels take it."""

    model: NDArray[np.void]
    """(1,) MODEL."""
    nodes: NDArray[np.float32]
    """The nodes of its grids, one grid after another."""
    symmetry_known: bool
    """Whether kernels know its kind of symmetry."""


def model_record(geometry: Geometry, symmetries: Symmetries) -> ModelRecord:
    """Returns the record of an object with that geometry and those symmetries."""
    record = np.zeros(1, dtype=records.MODEL)
    row, spacing, diameter = record[0], geometry.sample_spacing, geometry.diameter
    coarse = geometry.coarse.fill(row["coarse"], 0)
    nodes = [coarse, geometry.fine.fill(row["fine"], len(coarse))]
    row["coarse"]["variance_distance"] = (RECORD.coarse_distance * geometry.coarse.cell) ** 2
    row["coarse"]["variance_normal"] = RECORD.coarse_normal**2
    row["radius"], row["center"] = geometry.radius, geometry.center_object
    row["bounds"] = geometry.bounds_object + RECORD.facet_margin * diameter * np.array([[-1.0], [1.0]])
    row["edge_curvature2"] = 1 / (RECORD.edge * geometry.coarse.cell) ** 2
    error, place_by_place = row["error"], geometry.field_error
    error["least_distance"] = (RECORD.least_distance * diameter) ** 2
    error["least_normal"] = RECORD.least_normal**2
    if place_by_place is not None:
        error["inverse_cell"], error["origin"] = 1 / place_by_place.cell, place_by_place.origin
        error["shape"], error["nodes"] = place_by_place.values.shape[:3], sum(map(len, nodes))
        nodes.append(place_by_place.values.astype(np.float32).reshape(-1))
    symmetry = row["symmetry"]
    symmetry["kind"], symmetry["axes"] = _kind(symmetries), len(symmetries.axes)
    for k, (point, direction) in enumerate(symmetries.axes):
        symmetry["pivot"], symmetry["axis"][k] = point, direction
    count = min(len(symmetries.rotations), records.MOST_ROTATIONS)
    symmetry["rotations"], symmetry["rotation"][:count] = count, symmetries.rotations[:count, :3]
    row["normal_weight2"] = (RECORD.normal_weight * diameter) ** 2
    row["band"], row["tangential_weight"] = RECORD.band * spacing, 1 / (RECORD.tangential * spacing) ** 2
    row["sample_variance_distance"] = (RECORD.patch * spacing) ** 2
    row["sample_variance_normal"] = geometry.sigma_normal**2
    row["samples"][:, 0], row["samples"][:, 1] = geometry.points_object, geometry.normals_object
    row["scan"][0] = (geometry.points_object**2).sum(axis=1)
    row["scan"][1:4], row["scan"][4:] = geometry.points_object.T, geometry.normals_object.T
    known = symmetry["kind"] != records.OTHER_SYMMETRY
    return ModelRecord(record, np.concatenate(nodes), bool(known))


def _kind(symmetries: Symmetries) -> int:
    """Returns the kernels' kind of these symmetries; OTHER_SYMMETRY where they have none for them."""
    if symmetries.trivial:
        return records.NO_SYMMETRY
    if len(symmetries.rotations) > records.MOST_ROTATIONS:
        return records.OTHER_SYMMETRY
    if not symmetries.axes:
        return records.DISCRETE
    point, direction = symmetries.axes[0]
    through_origin = np.abs(point - (point @ direction) * direction).max() < 1e-15
    return records.AXIS if len(symmetries.axes) == 1 and through_origin else records.OTHER_SYMMETRY
