"""Where objects were found in pictures, as lines of JSON or as BOP's results."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.recording.frames import Frame, Unread
from handsight.vision import ObjectDetection
from handsight.vision.object.recognition import Recognition

BOP_COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Located:
    """A `Located` is an object looked for in one picture, or which of several it shows."""

    frame: Frame
    model: ObjectModel
    """Of several the likeliest."""
    found: ObjectDetection
    """Where that is."""
    seconds: float
    """That looking took."""
    recognition: Recognition | None = None
    """Which of several it is; None: there was one."""

    @property
    def reason(self) -> str | None:
        """Why it is not there, with the median depth, which tells a wrong unit; None: it is there."""
        fields = (self.recognition or self.found).reason
        depth = self.frame.depth
        if fields is None or not (known := depth[np.isfinite(depth) & (depth > 0)]).size:
            return fields
        return f"{fields} (median depth {np.median(known):.2f} m)"

    @property
    def name(self) -> str | None:
        """Of the object; None: it is none of several."""
        return self.model.name if self.recognition is None else self.recognition.name

    @property
    def explained(self) -> float:
        """Of the pixels that should be the object's those that are, 0 to 1."""
        candidate = self.found.candidates[0]
        return float(np.clip(candidate["explained"] / max(candidate["expected"], 1.0), 0, 1))


def answer(located: Located) -> dict[str, object]:
    """Returns the answer as JSON has it; poses are T_camera_object, in the camera's optical frame."""
    frame, found = located.frame, located.found
    fields: dict[str, Any] = {"frame": frame.name}
    if frame.number is not None:
        fields |= dict(zip(("scene_id", "im_id"), frame.number, strict=True))
    reason = located.reason
    fields |= {"object": located.name, "found": reason is None}
    if located.recognition is not None:
        fields |= {"scores": located.recognition.scores, "none": located.recognition.none}
    if reason is not None:
        return fields | {"reason": reason, "seconds": located.seconds}
    poses = [
        {**_pose(T), "covariance": covariance.tolist(), "weight": float(weight)}
        for T, covariance, weight in zip(
            found.Ts_camera_object, found.covariances, found.weights, strict=True
        )
    ]
    best = {key: value for key, value in poses[0].items() if key != "weight"}
    of_best = {"probability": found.probability, "explained": located.explained}
    return fields | best | of_best | {"hypotheses": poses, "seconds": located.seconds}


def json_line(row: Located | Unread) -> str:
    """Returns a line of JSON, without its end; `{"frame": ..., "error": ...}` of a picture that cannot be read."""
    fields = {"frame": row.name, "error": row.reason} if isinstance(row, Unread) else answer(row)
    return json.dumps(fields, allow_nan=False)


def bop_line(row: Located | Unread, numbers: Mapping[str, int]) -> str | None:
    """Returns a line of BOP's results, t in mm, without its end; None where there is no pose. `numbers`: BOP's by name.

    The score is the share of its pixels that the pose explains.
    """
    if isinstance(row, Unread) or row.reason is not None:
        return None
    T = row.found.Ts_camera_object[0]
    R, t = (" ".join(f"{value:.6f}" for value in part.ravel()) for part in (T[:3, :3], T[:3, 3] / MM))
    scene, image = row.frame.number or (0, 0)
    return f"{scene},{image},{numbers[row.model.name]},{row.explained:.4f},{R},{t},{row.seconds:.4f}"


def _pose(T: Array) -> dict[str, list[float]]:
    return {
        "position": T[:3, 3].tolist(),
        "quaternion_xyzw": se3.quaternion_from_rotation(T[:3, :3]).tolist(),
    }
