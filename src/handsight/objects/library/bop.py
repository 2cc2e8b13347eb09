"""`models_info.json` as the BOP benchmark has it: of each object its diameter and symmetries, there in millimetres.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import SYMMETRY_LIMITS, Symmetries, about


class BopOptions(NamedTuple):
    """`BopOptions` say how symmetries of a BOP library are read."""

    metres: float = 1e-3  # metres of the file's unit
    tolerance: float = 0.01
    """Turns as matrices, and shifts as parts of the diameter, that differ by less are meant to be one: files round
    them to a few digits.
    """
    rounds: int = 6  # of making a group exact; each squares how far it is off


BOP_SYMMETRIES = BopOptions()


Vector = tuple[float, float, float]
Matrix = tuple[
    float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float,
]  # fmt: skip
"""4 x 4, row by row."""


class ContinuousAxis(msgspec.Struct):
    """A `ContinuousAxis` is a line about which any turn is a symmetry."""

    axis: Vector
    offset: Vector = (0.0, 0.0, 0.0)
    """A point of it [mm]."""


class Info(msgspec.Struct):
    """An `Info` is what the file says of an object; keys that nobody here asks for are left alone."""

    diameter: Annotated[float, msgspec.Meta(ge=1e-4, le=1e10)]
    """[mm]"""
    size_x: float | None = None
    size_y: float | None = None
    size_z: float | None = None
    symmetries_discrete: list[Matrix] = []
    symmetries_continuous: list[ContinuousAxis] = []


def info_of(model: ObjectModel) -> dict[str, object]:
    """Returns what the file is to say of an object."""
    low, high = model.bounds_object / BOP_SYMMETRIES.metres
    of = model.symmetries
    return {
        "diameter": model.diameter / BOP_SYMMETRIES.metres,
        **{f"min_{axis}": float(low[k]) for k, axis in enumerate("xyz")},
        **{f"size_{axis}": float(high[k] - low[k]) for k, axis in enumerate("xyz")},
        "symmetries_discrete": [_flat(T) for T in of.rotations[1:]],
        "symmetries_continuous": [
            {"axis": axis.tolist(), "offset": (point / BOP_SYMMETRIES.metres).tolist()}
            for point, axis in of.axes
        ],
    }


def symmetries_of(info: Info) -> Symmetries:
    """Returns the symmetries that the file means, exact however they are rounded; raises InvalidInput where these are
    none."""
    near = BOP_SYMMETRIES.tolerance * info.diameter * BOP_SYMMETRIES.metres
    turns = [_turn(matrix, f"symmetries_discrete[{k}]") for k, matrix in enumerate(info.symmetries_discrete)]
    lines = [
        (
            checks.position(
                BOP_SYMMETRIES.metres * np.array(line.offset), f"symmetries_continuous[{k}].offset", (3,)
            ),
            line.axis,
        )
        for k, line in enumerate(info.symmetries_continuous)
    ]
    if len(turns) > SYMMETRY_LIMITS.max_rotations:
        raise InvalidInput(
            f"symmetries_discrete: expected at most {SYMMETRY_LIMITS.max_rotations}, got {len(turns)}"
        )
    if not lines:
        return Symmetries(rotations=_exact(turns, near))
    found = Symmetries(lines)
    middles = [
        middle for k, T in enumerate(turns) if (middle := _swapped_about(T, found, near, k)) is not None
    ]
    if not middles:
        return found
    middle, axis = np.mean(middles, axis=0), found.axes[0][1]
    if np.abs(np.array(middles) - middle).max() > near:
        raise InvalidInput("symmetries_discrete: expected half turns that swap the ends about one middle")
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    return Symmetries([(middle, axis)], about(middle, np.pi * side / np.linalg.norm(side))[None])


def _flat(T: Array) -> list[float]:
    return [float(x) for x in se3.compose(T[:3, :3], T[:3, 3] / BOP_SYMMETRIES.metres).reshape(-1)]


def _turn(matrix: Matrix, name: str) -> Array:
    """Returns the rigid transform [m] that a matrix [mm] of few digits means."""
    given = np.array(matrix).reshape(4, 4)
    shift = checks.position(BOP_SYMMETRIES.metres * given[:3, 3], name, (3,))
    R = _nearest_rotations(given[:3, :3])
    if not (np.abs(R - given[:3, :3]).max() < BOP_SYMMETRIES.tolerance and (given[3] == [0, 0, 0, 1]).all()):
        raise InvalidInput(f"{name}: expected a rigid transform, got {checks.brief(given)}")
    return se3.compose(R, shift)


def _nearest_rotations(M: Array) -> Array:
    """Returns the rotations (..., 3, 3) nearest to matrices (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def _swapped_about(T: Array, found: Symmetries, near: float, k: int) -> Array | None:
    """Returns the point about which a discrete symmetry swaps the ends of a continuous one's axis; None where it
    keeps them."""
    point, axis = found.axes[0]
    shift = se3.apply(T, point[None])[0] - point
    along, cosine = float(shift @ axis), float(axis @ T[:3, :3] @ axis)
    gap = shift if found.round else shift - along * axis
    if np.linalg.norm(gap) > near or (not found.round and abs(cosine) < 1 - BOP_SYMMETRIES.tolerance):
        raise InvalidInput(f"symmetries_discrete[{k}]: expected a turn that keeps the continuous axis")
    if found.round or (cosine > 0 and abs(along) < near):
        return None
    if cosine > 0:
        raise InvalidInput(
            f"symmetries_discrete[{k}]: expected a turn, got a shift along the continuous axis"
        )
    return np.asarray(point + along * axis / 2)


def _exact(turns: list[Array], near: float) -> Array:
    """Returns the finite group (k, 4, 4) that turns are meant to make, closed to rounding.

    The mean of R(gh) R(h)⁻¹ over all h is nearer to a group's R(g) than R(g) itself, by a square each time (Grove,
    Karcher, Ruh 1974); and what all turns leave in place is the mean of where they take a point.
    """
    group = _closed(turns, near)
    products = group[:, None] @ group
    gaps = np.array([[_gap(product, group, near) for product in row] for row in products])
    table, R = gaps.argmin(axis=-1), group[:, :3, :3]
    for _ in range(BOP_SYMMETRIES.rounds):
        R = _nearest_rotations(np.einsum("ghij,hkj->gik", R[table], R))
    center = group[:, :3, 3].mean(axis=0)
    exact = se3.compose(R, center - R @ center)
    if max(_gap(T, one[None], near)[0] for T, one in zip(group, exact, strict=True)) > 1:
        raise InvalidInput("symmetries_discrete: expected turns about one point, got others")
    return exact


def _closed(turns: list[Array], near: float) -> Array:
    """Returns the turns and their products (k, 4, 4), the identity first; raises InvalidInput where there is no end
    of them."""
    group, done = np.eye(4)[None], 0
    while done < len(group):
        for turn in turns:
            product = group[done] @ turn
            if _gap(product, group, near).min() > 1:
                group = np.vstack([group, product[None]])
        if len(group) > SYMMETRY_LIMITS.max_rotations:
            message = f"expected a finite group, got over {SYMMETRY_LIMITS.max_rotations} products"
            raise InvalidInput(f"symmetries_discrete: {message}")
        done += 1
    return group


def _gap(T: Array, others: Array, near: float) -> Array:
    """Returns how far a transform is off each of others (k, 4, 4); 1 where they may just be meant to be one."""
    differences = np.abs(others - T)
    return np.asarray(
        np.maximum(
            differences[:, :3, :3].max(axis=(1, 2)) / BOP_SYMMETRIES.tolerance,
            differences[:, :3, 3].max(axis=1) / near,
        )
    )
