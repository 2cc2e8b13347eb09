"""Detections of objects in images: written as JSON or BOP results, and read from other detectors' BOP results."""

import csv
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile
from handsight.files import read_bytes
from handsight.objects import ObjectModel
from handsight.recording.frames import Frame, Unread
from handsight.vision import ObjectDetection
from handsight.vision.object.locate import Recognition

BOP_COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
"""The columns of a file of BOP results; t is in millimetres."""


@dataclass(frozen=True, slots=True, eq=False)
class BopResult:
    """A `BopResult` is a detector's pose of an object in an image.

    `PoseMeasurement(result.T_camera_object)` is the form that a tracker takes.
    """

    scene: int
    image: int
    object: int
    """BOP's number of the object."""
    score: float
    T_camera_object: Array
    """(4, 4) pose in the camera's optical frame [m]."""
    seconds: float | None
    """Duration of the detection; None: the file does not state it."""


def read_bop_results(path: str | os.PathLike[str]) -> list[BopResult]:
    """Returns the rows of a CSV file of BOP results, `scene_id,im_id,obj_id,score,R,t,time`.

    R has nine numbers, row by row; t has three, in millimetres; time is -1 if unknown [s]. Raises InvalidFile with the
    line of the first wrong row.
    """
    try:
        text = read_bytes(path, 256 * 1024**2).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidFile(f"{path}: expected text in UTF-8, got bytes that are none") from None
    rows, head = csv.reader(text.splitlines(), strict=True), BOP_COLUMNS.split(",")
    try:
        return [
            _result(row)
            for row in rows
            if row and not (rows.line_num == 1 and [cell.strip() for cell in row] == head)
        ]
    except (ValueError, OverflowError, csv.Error, HandsightError) as error:
        raise InvalidFile(f"{path}: line {rows.line_num}: {error}") from None


def _result(row: list[str]) -> BopResult:
    """Returns the result of one row; raises ValueError or InvalidInput."""
    names = BOP_COLUMNS.split(",")
    if len(row) != len(names):
        raise ValueError(f"expected {len(names)} columns, {BOP_COLUMNS}, got {len(row)}")
    keys = list[int]()
    for name, cell in zip(names[:3], row, strict=False):
        try:
            keys.append(int(cell))
        except ValueError:
            raise ValueError(f"{name}: expected a whole number, got {cell[:40]!r}") from None
    numbers = dict[str, Array]()
    for name, k, count in (("score", 3, 1), ("time", 6, 1), ("R", 4, 9), ("t", 5, 3)):
        try:
            numbers[name] = np.array([float(word) for word in row[k].split()])
        except ValueError:
            numbers[name] = np.zeros(0)
        if len(numbers[name]) != count or not np.isfinite(numbers[name]).all():
            plural = "s" if count > 1 else ""
            raise ValueError(f"{name}: expected {count} finite number{plural}, got {row[k][:60]!r}")
    if np.abs(numbers["R"]).max() > 2:
        raise ValueError(f"R: expected a rotation, got {row[4][:60]!r}")
    U, values, V = np.linalg.svd(numbers["R"].reshape(3, 3))
    if np.abs(values - 1).max() > 1e-3 or np.linalg.det(U @ V) < 0:  # the numbers are rounded
        raise ValueError(f"R: expected a rotation, got one off by {np.abs(values - 1).max():.2g}")
    T = se3.check(se3.compose(U @ V, 1e-3 * numbers["t"]), "t")
    score, seconds = float(numbers["score"][0]), float(numbers["time"][0])
    scene, image, number = keys
    return BopResult(scene, image, number, score, T, seconds if seconds >= 0 else None)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Located:
    """A `Located` is the result of locating an object in one image, or of recognising which of several it shows."""

    frame: Frame
    model: ObjectModel
    """The object; if there are several, the most probable one."""
    found: ObjectDetection
    """The object's pose, or why there is none."""
    seconds: float
    """Duration of the search [s]."""
    recognition: Recognition | None = None
    """Which of several objects it is; None: there was only one to locate."""

    @property
    def reason(self) -> str | None:
        """Why no object was found, with the median depth, which reveals a wrong unit; None: an object was found."""
        reason, depth = (self.recognition or self.found).reason, self.frame.depth
        if reason is None or not (known := depth[np.isfinite(depth) & (depth > 0)]).size:
            return reason
        return f"{reason} (median depth {np.median(known):.2f} m)"

    @property
    def name(self) -> str | None:
        """The object's name; None: the image shows none of the objects."""
        return self.model.name if self.recognition is None else self.recognition.name

    @property
    def explained(self) -> float:
        """The share of the object's expected pixels that its pose explains, 0 to 1."""
        candidate = self.found.candidates[0]
        return float(np.clip(candidate["explained"] / max(candidate["expected"], 1.0), 0, 1))


def json_line(row: Located | Unread) -> str:
    """Returns a line of JSON without its newline; for an unreadable image, `{"frame": ..., "error": ...}`.

    Poses are `T_camera_object`, in the camera's optical frame [m].
    """
    if isinstance(row, Unread):
        return json.dumps({"frame": row.name, "error": row.reason})
    frame, found, reason = row.frame, row.found, row.reason
    fields: dict[str, object] = {"frame": frame.name}
    if frame.number is not None:
        fields |= dict(zip(("scene_id", "im_id"), frame.number, strict=True))
    fields |= {"object": row.name, "found": reason is None}
    if row.recognition is not None:
        fields |= {"scores": row.recognition.scores, "none": row.recognition.none}
    if reason is None:
        columns = found.Ts_camera_object, found.covariances, found.weights
        poses = [
            {
                "position": T[:3, 3].tolist(),
                "quaternion_xyzw": se3.quaternion_from_rotation(T[:3, :3]).tolist(),
                "covariance": covariance.tolist(),
                "weight": float(weight),
            }
            for T, covariance, weight in zip(*columns, strict=True)
        ]
        fields |= {key: value for key, value in poses[0].items() if key != "weight"}
        fields |= {"probability": found.probability, "explained": row.explained, "hypotheses": poses}
    else:
        fields["reason"] = reason
    return json.dumps(fields | {"seconds": row.seconds}, allow_nan=False)


def bop_line(row: Located | Unread, numbers: Mapping[str, int]) -> str | None:
    """Returns a line of BOP results without its newline; None where there is no pose.

    `numbers`: BOP's numbers of the objects, by name. The score is `explained`.
    """
    if isinstance(row, Unread) or row.reason is not None:
        return None
    T = row.found.Ts_camera_object[0]
    parts = T[:3, :3], T[:3, 3] / 1e-3  # t in mm
    R, t = (" ".join(f"{value:.6f}" for value in part.ravel()) for part in parts)
    scene, image = row.frame.number or (0, 0)
    return f"{scene},{image},{numbers[row.model.name]},{row.explained:.4f},{R},{t},{row.seconds:.4f}"
