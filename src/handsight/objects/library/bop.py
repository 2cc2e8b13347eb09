"""`models_info.json` of the BOP benchmark: the diameter and the symmetries of each object, in millimetres.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from typing import Annotated

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import MAX_ROTATIONS, Symmetries, about, closed_group

METRES = 1e-3
"""Metres in the unit of a BOP library's files."""
TOLERANCE = 0.01
"""Rotation matrices are meant to be equal if their entries differ by less, and shifts if they differ by less than this
part of the diameter, because files have few digits."""
SURFACE_TOLERANCE = 0.1
"""How far a symmetry may move a point off the surface [diameters]: BOP searches symmetries with this tolerance (Hodaň
et al. 2020), so that details do not break them. Ones of the YCB scans are up to 0.054 off, false ones mostly more."""

Vector = tuple[float, float, float]
Matrix = tuple[
    float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float,
]  # fmt: skip
"""4 x 4, row by row."""


class ContinuousAxis(msgspec.Struct):
    """A `ContinuousAxis` is a line about which every turn is a symmetry."""

    axis: Vector
    offset: Vector = (0.0, 0.0, 0.0)
    """A point on the line [mm]."""


class Info(msgspec.Struct):
    """An `Info` is the entry of `models_info.json` for an object; other keys are ignored."""

    diameter: Annotated[float, msgspec.Meta(ge=1e-4, le=1e10)]
    """[mm]"""
    size_x: float | None = None
    size_y: float | None = None
    size_z: float | None = None
    symmetries_discrete: list[Matrix] = []
    symmetries_continuous: list[ContinuousAxis] = []


def info_of(model: ObjectModel) -> dict[str, object]:
    """Returns the values of `models_info.json` for an object."""
    low, high = model.bounds_object / METRES
    symmetries = model.symmetries
    turns = [se3.compose(T[:3, :3], T[:3, 3] / METRES) for T in symmetries.rotations[1:]]
    return {
        "diameter": model.diameter / METRES,
        **{f"min_{axis}": float(low[k]) for k, axis in enumerate("xyz")},
        **{f"size_{axis}": float(high[k] - low[k]) for k, axis in enumerate("xyz")},
        "symmetries_discrete": [[float(x) for x in T.reshape(-1)] for T in turns],
        "symmetries_continuous": [
            {"axis": axis.tolist(), "offset": (point / METRES).tolist()} for point, axis in symmetries.axes
        ],
    }


def symmetries_of(info: Info) -> Symmetries:
    """Returns the symmetries that rounded numbers mean, as an exact group; raises InvalidInput where they form none."""
    near = TOLERANCE * info.diameter * METRES
    turns = []
    for k, matrix in enumerate(info.symmetries_discrete):
        name, given = f"symmetries_discrete[{k}]", np.array(matrix).reshape(4, 4)
        shift = checks.position(METRES * given[:3, 3], name, (3,))
        R = _nearest_rotations(given[:3, :3])
        if not (np.abs(R - given[:3, :3]).max() < TOLERANCE and (given[3] == [0, 0, 0, 1]).all()):
            raise InvalidInput(f"{name}: expected a rigid transform, got {checks.brief(given)}")
        turns.append(se3.compose(R, shift))
    lines = []
    for k, line in enumerate(info.symmetries_continuous):
        offset, name = METRES * np.array(line.offset), f"symmetries_continuous[{k}].offset"
        lines.append((checks.position(offset, name, (3,)), line.axis))
    if len(turns) > MAX_ROTATIONS:
        raise InvalidInput(f"symmetries_discrete: expected at most {MAX_ROTATIONS}, got {len(turns)}")
    if not lines:
        return Symmetries(rotations=_exact_group(turns, near))
    symmetries = Symmetries(lines)
    point, axis = symmetries.axes[0]
    middles = []
    for k, T in enumerate(turns):  # each must keep the axis in place, or swap its ends about a middle
        shift = se3.apply(T, point[None])[0] - point
        along, cosine = float(shift @ axis), float(axis @ T[:3, :3] @ axis)
        gap = shift if symmetries.round else shift - along * axis
        if np.linalg.norm(gap) > near or (not symmetries.round and abs(cosine) < 1 - TOLERANCE):
            raise InvalidInput(f"symmetries_discrete[{k}]: expected a turn that keeps the continuous axis")
        if symmetries.round or (cosine > 0 and abs(along) < near):
            continue
        if cosine > 0:
            message = "expected a turn, got a shift along the continuous axis"
            raise InvalidInput(f"symmetries_discrete[{k}]: {message}")
        middles.append(point + along * axis / 2)
    if not middles:
        return symmetries
    middle = np.mean(middles, axis=0)
    if np.abs(np.array(middles) - middle).max() > near:
        raise InvalidInput("symmetries_discrete: expected half turns that swap the ends about one middle")
    return Symmetries([(middle, axis)], about(middle, np.pi * se3.perpendicular(axis))[None])


def _nearest_rotations(M: Array) -> Array:
    """Returns the rotations (..., 3, 3) nearest to matrices (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def _exact_group(turns: list[Array], near: float) -> Array:
    """Returns the finite group (k, 4, 4) that inexact turns generate, exact to rounding; raises InvalidInput.

    The turns are multiplied until no product is new; transforms that differ by less than `TOLERANCE` and `near` [m]
    are the same. The mean of R(gh) R(h)⁻¹ over all h is then closer to an exact group's R(g) than R(g) itself, and
    repeating this squares the error each time (Grove, Karcher, Ruh 1974). The point that all turns leave in place is
    the mean of the points to which they take the origin.
    """

    def distance(T: Array, others: Array) -> Array:
        differences = np.abs(others - T)
        rotation = differences[:, :3, :3].max(axis=(1, 2)) / TOLERANCE
        return np.asarray(np.maximum(rotation, differences[:, :3, 3].max(axis=1) / near))

    group = closed_group(turns, distance, "symmetries_discrete")
    products = group[:, None] @ group
    gaps = np.array([[distance(product, group) for product in row] for row in products])
    table, R = gaps.argmin(axis=-1), group[:, :3, :3]
    for _ in range(6):
        R = _nearest_rotations(np.einsum("ghij,hkj->gik", R[table], R))
    center = group[:, :3, 3].mean(axis=0)
    exact = se3.compose(R, center - R @ center)
    if max(distance(T, one[None])[0] for T, one in zip(group, exact, strict=True)) > 1:
        raise InvalidInput("symmetries_discrete: expected turns about one point, got others")
    return exact
