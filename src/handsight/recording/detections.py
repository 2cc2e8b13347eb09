"""Detections of objects in images, written as JSON or BOP results."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.objects import ObjectModel
from handsight.recording.frames import Frame, Unread
from handsight.vision import ObjectDetection
from handsight.vision.object.locate import Recognition

FAR = 3.0
"""A median depth beyond which an object that was not found may be in an image of another unit [m]."""


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
        median = float(np.median(known))
        hint = "; in tenths of millimetres? then --depth-scale 0.0001" if median > FAR else ""
        return f"{reason} (median depth {median:.2f} m{hint})"

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
    if (starts := found.starts) is not None:
        judged = starts.right, starts.probabilities, starts.moved, starts.better
        names = "right", "probability", "moved", "better"
        each = zip(*(column.tolist() for column in judged), strict=True)
        fields["starts"] = [dict(zip(names, values, strict=True)) for values in each]
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
