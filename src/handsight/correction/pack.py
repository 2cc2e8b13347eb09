"""Objects, contacts and priors as the flat arrays that kernels take (`handsight._kernels.layout`)."""

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import layout as at
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction.estimate import PosePrior
from handsight.correction.evidence import EDGE, LEAST_ROUGH
from handsight.correction.two_phase import COARSE_BLUR, patches
from handsight.objects import ObjectModel
from handsight.objects.pack import packed_field
from handsight.objects.symmetry import Symmetries

Singles = NDArray[np.float32]
_LANES = 8
"""Samples that a kernel compares at once."""


def packed(model: ObjectModel) -> tuple[Array, Singles]:
    """The numbers of an object and its float32 part; made once for each model."""
    kept = model.kept.get("correction")
    if kept is None:
        kept = model.kept["correction"] = _packed(model)
    numbers, singles = kept
    return numbers, singles


def known_symmetry(symmetries: Symmetries) -> int:
    """Which of the kernels' kinds of symmetry an object has; OTHER where they know none like it."""
    if symmetries.trivial:
        return at.NONE
    if not symmetries.axes:
        return at.DISCRETE
    point, direction = symmetries.axes[0]
    along = (point @ direction) * direction
    return at.AXIS if len(symmetries.axes) == 1 and np.abs(point - along).max() < 1e-15 else at.OTHER


def _packed(model: ObjectModel) -> tuple[Array, Singles]:
    head = np.zeros(at.MODEL)
    head[at.COARSE : at.COARSE + at.FIELD], coarse = packed_field(model.coarse, 0)
    head[at.FINE : at.FINE + at.FIELD], fine = packed_field(model.fine, len(coarse))
    head[at.RADIUS] = model.radius
    # Facets may be a little within the surface they stand for.
    margin = 0.01 * model.diameter * np.array([[-1.0], [1.0]])
    head[at.BOUNDS : at.BOUNDS + 6] = (model.bounds_object + margin).reshape(-1)
    head[at.CENTER : at.CENTER + 3] = model.center_object
    samples = patches(model)
    head[at.SAMPLE_VARIANCE : at.SAMPLE_VARIANCE + 2] = samples.variance_point, samples.variance_normal
    head[at.BAND], head[at.WEIGHT_TANGENTIAL] = samples.band, 1 / samples.sigma_tangential
    head[at.MATCH_WEIGHT] = samples.normal_weight**2
    least = (LEAST_ROUGH[0] * model.diameter) ** 2, LEAST_ROUGH[1] ** 2
    head[at.LEAST_ROUGH : at.LEAST_ROUGH + 2] = least
    head[at.SHARP] = 1 / (EDGE * model.coarse.cell) ** 2
    head[at.BLUR : at.BLUR + 2] = (COARSE_BLUR[0] * model.coarse.cell) ** 2, COARSE_BLUR[1] ** 2
    parts = [head]
    _append_symmetries(model.symmetries, head, parts)
    head[at.SAMPLES] = _length(parts)
    parts.append(np.hstack([samples.points_object, samples.normals_object]).reshape(-1))
    if model.field_error is not None:
        rough = model.field_error
        head[at.ROUGH_CELL] = 1 / rough.cell
        head[at.ROUGH_ORIGIN : at.ROUGH_ORIGIN + 3] = rough.origin
        head[at.ROUGH_SHAPE : at.ROUGH_SHAPE + 3] = rough.values.shape[:3]
        head[at.ROUGH] = _length(parts)
        parts.append(rough.values.reshape(-1))
    head[at.SCAN] = len(coarse) + len(fine)
    table = _table(samples.points_object, samples.normals_object)
    head[at.SCAN_COUNT] = table.shape[1]
    return np.concatenate(parts), np.concatenate([coarse, fine, table.reshape(-1)])


def _append_symmetries(symmetries: Symmetries, head: Array, parts: list[Array]) -> None:
    head[at.SYMMETRY], head[at.AXIS_COUNT] = known_symmetry(symmetries), len(symmetries.axes)
    for k, (point, direction) in enumerate(symmetries.axes):
        head[at.PIVOT : at.PIVOT + 3] = symmetries.axes[0][0] if k else point
        head[at.AXES + 3 * k : at.AXES + 3 * k + 3] = direction
    rotations = symmetries.rotations
    head[at.ROTATION_COUNT], head[at.ROTATIONS] = len(rotations), _length(parts)
    turns, shifts = rotations[:, :3, :3].reshape(-1, 9), rotations[:, :3, 3]
    parts.append(np.hstack([turns, shifts]).reshape(-1))


def _table(points: Array, normals: Array) -> Singles:
    """(7, s) what phase 1 scans: squared length, point, normal of each sample; columns beyond them are never least."""
    count = len(points)
    table = np.zeros((7, -(-count // _LANES) * _LANES), dtype=np.float32)
    table[0] = np.inf
    table[0, :count] = (points * points).sum(axis=1)
    table[1:4, :count], table[4:, :count] = points.T, normals.T
    return table


def _length(parts: list[Array]) -> int:
    return sum(len(part) for part in parts)


def packed_contacts(contacts: Contacts) -> Array:
    """(n CONTACT,), what a kernel fills in left as it is."""
    rows = np.empty((len(contacts.points_palm), at.CONTACT))
    rows[:, : at.NORMAL] = contacts.points_palm
    rows[:, at.NORMAL : at.HAS_NORMAL] = contacts.normals_palm
    rows[:, at.HAS_NORMAL] = contacts.has_normal
    rows[:, at.COVARIANCE :] = contacts.covariance.reshape(-1, 36)
    return rows.reshape(-1)


def packed_prior(vision: PosePrior | None) -> Array:
    """(PRIOR,), or nothing when blind."""
    if vision is None:
        return np.empty(0)
    numbers, T = np.empty(at.PRIOR), vision.T_palm_object
    numbers[: at.PRIOR_POSITION].reshape(3, 3)[:] = T[:3, :3]
    numbers[at.PRIOR_POSITION : at.PRIOR_COVARIANCE] = T[:3, 3]
    numbers[at.PRIOR_COVARIANCE :].reshape(6, 6)[:] = vision.covariance
    return numbers


def packed_poses(Ts: Array) -> Array:
    """(..., 12) rotation row by row, position."""
    numbers = np.empty((*Ts.shape[:-2], 12))
    numbers[..., :9] = Ts[..., :3, :3].reshape(*Ts.shape[:-2], 9)
    numbers[..., 9:] = Ts[..., :3, 3]
    return numbers


def unpacked_poses(numbers: Array) -> Array:
    """(..., 4, 4) of (..., 12)."""
    lead = numbers.shape[:-1]
    T = np.zeros((*lead, 4, 4))
    T[..., :3, :3] = numbers[..., :9].reshape(*lead, 3, 3)
    T[..., :3, 3] = numbers[..., 9:]
    T[..., 3, 3] = 1.0
    return T
