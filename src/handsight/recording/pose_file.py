"""Poses of objects from the files of other estimators, told apart by their content.

What is read: BOP results (.csv), the JSON of SAM-6D (`R`, `t`) and of MegaPose (`TWO`), and 4 x 4 numbers, one file an
image as FoundationPose writes them (`ob_in_cam/*.txt`) or one alone, as text or as NumPy arrays. BOP and SAM-6D have
lengths in millimetres, the others in metres.
"""

import csv
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.files import read_bytes, read_text
from handsight.msgspec_errors import decode_json
from handsight.vision.pixels import numpy_array

BOP_COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
BOP_COMMAS = 5
"""In the first line of BOP results, which other texts have fewer of."""
MAX_BYTES = 1 << 29
"""Of a file."""
ENDINGS = (".txt", ".npy")
"""Of the files of a folder, each with the pose in the image of its name."""
UNKNOWN = ""
"""Name of an object that a file does not name."""
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class GivenPose:
    """The pose of an object in an image, by another estimator."""

    place: str
    """Where it stands, for messages: the file, and the line or the index."""
    scene: int | None
    """BOP's number of the scene; None: the file has none."""
    image: str
    """The image's name without its ending, or its number as text."""
    object: str
    """The object's name or BOP's number as text; `UNKNOWN` where the file has neither."""
    score: float
    """How sure the estimator is, higher for surer."""
    T_camera_object: Array
    """(4, 4) pose in the camera's optical frame [m]."""


def read_poses(path: str | os.PathLike[str]) -> list[GivenPose]:
    """Returns the poses in a file or a folder; see the top of this module for what is read.

    Raises InvalidFile, which names the file and the line or the entry.
    """
    place = Path(path)
    if place.is_dir():
        files = sorted(file for file in place.iterdir() if file.suffix in ENDINGS)
        if not files:
            raise InvalidFile(f"{place}: expected poses, a .txt or .npy for each image, got none")
        return [_single(file) for file in files]
    if place.suffix == ".npy":
        return [_single(place)]
    text = read_text(place, MAX_BYTES).lstrip()
    if text.startswith(("[", "{")):
        return list(_entries(place, text))
    if place.suffix == ".csv" or text.partition("\n")[0].count(",") >= BOP_COMMAS:
        return list(_bop_results(place, text))
    return [_single(place)]


def _single(path: Path) -> GivenPose:
    """Returns the pose of a file with 4 x 4 numbers, in metres; its name is that of the image."""
    try:
        if path.suffix == ".npy":
            numbers = numpy_array(read_bytes(path, MAX_BYTES))
        else:
            numbers = np.array(read_text(path, MAX_BYTES).replace(",", " ").split(), dtype=float)
        if numbers.size != 16:
            raise InvalidInput(f"expected 4 x 4 numbers, got {numbers.size}")
        T = se3.rounded(checks.finite(numbers.reshape(4, 4), "pose", (4, 4)), "pose")
    except (HandsightError, ValueError) as error:
        raise InvalidFile(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    return GivenPose(str(path), None, path.stem, UNKNOWN, 1.0, T)


def _bop_results(path: Path, text: str) -> Iterator[GivenPose]:
    """Yields the rows of BOP results: R has nine numbers, row by row; t has three, in millimetres."""
    rows = csv.reader(text.splitlines())
    try:
        for row in rows:
            if row and ",".join(row).replace(" ", "") != BOP_COLUMNS:
                yield _bop_result(row, f"{path}: line {rows.line_num}")
    except (ValueError, csv.Error, HandsightError) as error:
        raise InvalidFile(f"{path}: line {rows.line_num}: {error}") from None


def _bop_result(row: list[str], place: str) -> GivenPose:
    if len(row) != len(BOP_COLUMNS.split(",")):
        raise InvalidInput(f"expected the columns {BOP_COLUMNS}, got {len(row)} of them")
    scene, image, number = (int(cell) for cell in row[:3])
    score = float(checks.finite(float(row[3]), "score", ()))
    R = [float(word) for word in row[4].split()]
    t = [float(word) for word in row[5].split()]
    return GivenPose(place, scene, str(image), str(number), score, _from_millimetres(R, t))


def _from_millimetres(R: Any, t: Any) -> Array:
    """Returns the pose (4, 4) [m] of nine numbers of a rotation, and of three in millimetres."""
    rotation = checks.finite(np.ravel(R), "R", (9,)).reshape(3, 3)
    position = 1e-3 * checks.finite(np.ravel(t), "t", (3,))
    return se3.rounded(se3.compose(rotation, position), "R, t")


def _entries(path: Path, text: str) -> Iterator[GivenPose]:
    """Yields the poses of a JSON list, as SAM-6D or MegaPose write it."""
    document = decode_json(text.encode(), str(path))
    if not isinstance(document, list) or not all(isinstance(entry, dict) for entry in document):
        raise InvalidFile(f"{path}: expected a list of objects with poses, got {checks.brief(document)}")
    for i, entry in enumerate(document):
        try:
            yield _entry(entry, f"{path}: [{i}]")
        except (HandsightError, ValueError, TypeError, KeyError) as error:
            reason = f"expected {error}, got no such key" if isinstance(error, KeyError) else str(error)
            raise InvalidFile(f"{path}: [{i}]: {reason}") from None


def _entry(entry: Row, place: str) -> GivenPose:
    if "TWO" in entry:  # MegaPose: quaternion x, y, z, w and position [m]
        quaternion, position = entry["TWO"]
        T = se3.from_position_quaternion(
            checks.finite(position, "TWO[1]", (3,)), checks.unit(quaternion, "TWO[0]", (4,))
        )
        return GivenPose(place, None, UNKNOWN, str(entry["label"]), float(entry.get("score", 1.0)), T)
    scene, image, number = (int(entry[key]) for key in ("scene_id", "image_id", "category_id"))
    T = _from_millimetres(entry["R"], entry["t"])
    return GivenPose(place, scene, str(image), str(number), float(entry.get("score", 1.0)), T)
