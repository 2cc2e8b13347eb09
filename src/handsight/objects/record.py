"""An object as the record and the grid nodes that kernels take (`handsight._kernels.records`)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import records
from handsight.objects.geometry import Geometry
from handsight.objects.symmetry import Symmetries


class RecordOptions(NamedTuple):
    """`RecordOptions` are the errors that an object's model is assumed to have, and the weights of phase 1. Phase 1 of
    a correction matches contacts with samples of the surface."""

    edge: float = 0.75  # radius of curvature below which the surface counts as an edge [coarse cells]
    facet_margin: float = 0.01  # how far facets may be within the surface that they approximate [diameters]
    normal_weight: float = 1.3
    """Distance that a difference of 1 between unit normals counts as, when a contact is matched [diameters]."""
    band: float = 1.6  # tangential distance to a sample that costs nothing [spacings of the samples]
    tangential: float = 0.32  # standard deviation of the distance beyond it [spacings]
    patch: float = 0.02  # standard deviation of the surface about a sample's plane [spacings]
    least_distance: float = 1e-4  # least standard deviation that is assumed for a model's surface [diameters]
    least_normal: float = 2e-3  # least standard deviation that is assumed for a model's normal [rad]
    coarse_distance: float = 0.03  # standard deviation of the coarse field's distance on faces [coarse cells]
    coarse_normal: float = 0.03  # standard deviation of the coarse field's normal on faces [rad]


RECORD = RecordOptions()


class ModelRecord(NamedTuple):
    """A `ModelRecord` is an object as kernels take it."""

    model: NDArray[np.void]
    """(1,) MODEL."""
    nodes: NDArray[np.float32]
    """The nodes of its grids, one grid after another."""
    symmetry_known: bool
    """Whether kernels can find the object's equivalent poses: where its symmetries are none, finitely many, or one axis
    through the origin. For others `symmetry.nearest` finds them."""


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
    symmetry, count = (
        row["symmetry"],
        len(symmetries.rotations),
    )  # at most `MAX_ROTATIONS`, for which there is room
    kind = records.NO_SYMMETRY if symmetries.trivial else records.DISCRETE
    for k, (point, direction) in enumerate(symmetries.axes):
        through_origin = np.abs(point - (point @ direction) * direction).max() < 1e-15
        kind = records.AXIS if len(symmetries.axes) == 1 and through_origin else records.OTHER_SYMMETRY
        symmetry["pivot"], symmetry["axis"][k] = point, direction
    symmetry["kind"], symmetry["axes"] = kind, len(symmetries.axes)
    symmetry["rotations"], symmetry["rotation"][:count] = count, symmetries.rotations[:, :3]
    row["normal_weight2"] = (RECORD.normal_weight * diameter) ** 2
    row["band"], row["tangential_weight"] = RECORD.band * spacing, 1 / (RECORD.tangential * spacing) ** 2
    row["sample_variance_distance"] = (RECORD.patch * spacing) ** 2
    row["sample_variance_normal"] = geometry.sigma_normal**2
    row["samples"][:, 0], row["samples"][:, 1] = geometry.points_object, geometry.normals_object
    row["scan"][0] = (geometry.points_object**2).sum(axis=1)
    row["scan"][1:4], row["scan"][4:] = geometry.points_object.T, geometry.normals_object.T
    return ModelRecord(record, np.concatenate(nodes), kind != records.OTHER_SYMMETRY)
