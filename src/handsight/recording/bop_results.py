"""Poses of other people's detectors, from files in the form of BOP's results."""

import csv
import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile
from handsight.files import read_bytes


class BopResultOptions(NamedTuple):
    """`BopResultOptions` say how results in BOP's form are read."""

    metres: float = 1e-3  # metres of the file's unit
    max_bytes: int = 256 * 1024**2  # of a file
    rounding: float = 1e-3  # how far a written rotation may be off one


RESULT_FILES = BopResultOptions()

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")


@dataclass(frozen=True, slots=True, eq=False)
class BopResult:
    """A `BopResult` says where a detector has an object in an image; `PoseMeasurement(result.T_camera_object)` gives
    it to a tracker."""

    scene: int
    image: int
    object: int
    """BOP's number of it."""
    score: float
    T_camera_object: Array
    """(4, 4) in the camera's optical frame [m]."""
    seconds: float | None
    """That it took; None: not told."""


def read_bop_results(path: str | os.PathLike[str]) -> list[BopResult]:
    """Returns the rows of a CSV file `scene_id,im_id,obj_id,score,R,t,time`: R nine numbers, t three in mm, time -1
    if unknown.

    Raises InvalidFile with the line where one is wrong.
    """
    try:
        text = read_bytes(path, RESULT_FILES.max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidFile(f"{path}: expected text in UTF-8, got bytes that are none") from None
    rows, found = csv.reader(text.splitlines(), strict=True), list[BopResult]()
    try:
        for row in rows:
            if row and not (rows.line_num == 1 and [cell.strip() for cell in row] == [*COLUMNS]):
                found.append(_result(row))
    except (ValueError, OverflowError, csv.Error, HandsightError) as error:
        raise InvalidFile(f"{path}: line {rows.line_num}: {error}") from None
    return found


def _result(row: list[str]) -> BopResult:
    """Returns the result of one row; raises ValueError or InvalidInput."""
    if len(row) != len(COLUMNS):
        raise ValueError(f"expected {len(COLUMNS)} columns, {','.join(COLUMNS)}, got {len(row)}")
    scene, image, thing = (_integer(cell, name) for cell, name in zip(row, COLUMNS[:3], strict=False))
    score, seconds = (float(_numbers(row[k], COLUMNS[k], 1)[0]) for k in (3, 6))
    R, t = (_numbers(row[k], COLUMNS[k], count) for k, count in ((4, 9), (5, 3)))
    if np.abs(R).max() > 2:
        raise ValueError(f"R: expected a rotation, got {row[4][:60]!r}")
    U, values, V = np.linalg.svd(R.reshape(3, 3))
    if np.abs(values - 1).max() > RESULT_FILES.rounding or np.linalg.det(U @ V) < 0:
        raise ValueError(f"R: expected a rotation, got one off by {np.abs(values - 1).max():.2g}")
    T = se3.check(se3.compose(U @ V, RESULT_FILES.metres * t), "t")
    return BopResult(scene, image, thing, score, T, seconds if seconds >= 0 else None)


def _numbers(cell: str, name: str, count: int) -> Array:
    try:
        values = np.array([float(word) for word in cell.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(
            f"{name}: expected {count} finite number{'s' if count > 1 else ''}, got {cell[:60]!r}"
        )
    return values


def _integer(cell: str, name: str) -> int:
    try:
        return int(cell)
    except ValueError:
        raise ValueError(f"{name}: expected a whole number, got {cell[:40]!r}") from None
