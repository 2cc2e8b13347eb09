"""Detections of objects in images, written as JSON or BOP results."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from handsight import se3
from handsight.objects import ObjectModel
from handsight.recording.frames import Frame, Unread
from handsight.vision import JudgedStarts, ObjectDetection, SceneDetection
from handsight.vision.object.locate import Recognition

MAX_REASONS = 3
"""Reasons that are listed why none of several objects was found."""
MAX_HYPOTHESES, MIN_WEIGHT = 3, 0.01
"""Hypotheses of an object that are written, and the weight above which the others than the best are."""
FAR, IMPROBABLE = 3.0, 0.005
"""Median depth [m] beyond which, and probability below which, an object may be in another unit."""


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
        if not hint and 0 < self.found.probability < IMPROBABLE:  # as everything is at another scale
            hint = "; if that is not the distance of the scene, set --depth-scale"
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocatedAll:
    """A `LocatedAll` is the result of locating all of several objects in one image."""

    frame: Frame
    models: Mapping[str, ObjectModel]
    found: SceneDetection
    seconds: float
    """Duration of the search [s]."""
    starts: Mapping[str, JudgedStarts] = field(default_factory=dict)
    """Of poses that were given, by the object's name: are they right?"""

    @property
    def instances(self) -> list[Located]:
        """Each object that was found, the most probable first."""
        located = partial(Located, frame=self.frame, seconds=self.seconds)
        each = ((i.name, replace(i.detection, probability=i.probability)) for i in self.found.instances)
        return [located(model=self.models[name], found=one) for name, one in each]

    @property
    def reason(self) -> str | None:
        """Why none was found; None: at least one was found."""
        if self.found.instances:
            return None
        reasons = list(dict.fromkeys(self.found.missing.values()))
        more = [f"and {len(reasons) - MAX_REASONS} more"] * (len(reasons) > MAX_REASONS)
        return "; ".join([*reasons[:MAX_REASONS], *more])


def json_line(row: Located | LocatedAll | Unread, *, complete: bool = False) -> str:
    """Returns a line of JSON without its newline; for an unreadable image, `{"frame": ..., "error": ...}`.

    Poses are `T_camera_object`, in the camera's optical frame [m]. complete: with all hypotheses of each object; else
    with the likeliest only, the others of a weight above 0.01.
    """
    if isinstance(row, Unread):
        return json.dumps({"frame": row.name, "error": row.reason})
    frame, reason = row.frame, row.reason
    fields: dict[str, object] = {"frame": frame.name}
    if frame.number is not None:
        fields |= dict(zip(("scene_id", "im_id"), frame.number, strict=True))
    if isinstance(row, LocatedAll):
        pixels = [int(each.pixels.sum()) for each in row.found.instances]
        objects = [
            {"object": each.model.name} | _pose_fields(each, complete) | {"pixels": n}
            for each, n in zip(row.instances, pixels, strict=True)
        ]
        fields |= {"found": reason is None, "objects": objects, "missing": row.found.missing}
        if row.starts:
            fields["starts"] = {name: _judged(starts) for name, starts in row.starts.items()}
        return json.dumps(fields | {"seconds": row.seconds}, allow_nan=False)
    fields |= {"object": row.name, "found": reason is None}
    if row.recognition is not None:
        fields |= {"scores": row.recognition.scores, "none": row.recognition.none}
    fields |= _pose_fields(row, complete) if reason is None else {"reason": reason}
    if (starts := row.found.starts) is not None:
        fields["starts"] = _judged(starts)
    return json.dumps(fields | {"seconds": row.seconds}, allow_nan=False)


def _pose_fields(row: Located, complete: bool) -> dict[str, object]:
    """Returns an object's pose, probability and hypotheses as JSON has them; not `complete`: the likeliest of these."""
    columns, poses = (row.found.Ts_camera_object, row.found.covariances, row.found.weights), []
    for T, covariance, weight in zip(*columns, strict=True):
        pose = {**se3.position_quaternion(T), "covariance": covariance}
        poses.append({key: value.tolist() for key, value in pose.items()} | {"weight": float(weight)})
    if not complete:  # the likeliest is the first
        likely = 1 + int((row.found.weights[1:MAX_HYPOTHESES] > MIN_WEIGHT).sum())
        poses = poses[:likely]
    fields = {key: value for key, value in poses[0].items() if key != "weight"}
    return fields | {"probability": row.found.probability, "explained": row.explained, "hypotheses": poses}


def _judged(starts: JudgedStarts) -> list[dict[str, object]]:
    """Returns what the image says of poses that were given as JSON has it."""
    judged = starts.right, starts.probabilities, starts.moved, starts.better
    each = zip(*(column.tolist() for column in judged), strict=True)
    return [dict(zip(("right", "probability", "moved", "better"), values, strict=True)) for values in each]


def bop_lines(row: Located | LocatedAll | Unread, numbers: Mapping[str, int]) -> list[str]:
    """Returns the lines of BOP results without their newlines, one for each object that was found.

    `numbers`: BOP's numbers of the objects, by name. The score is `explained`; the time is that of the whole image.
    """
    if isinstance(row, Unread) or row.reason is not None:
        return []
    lines = list[str]()
    for each in [row] if isinstance(row, Located) else row.instances:
        T, (scene, image) = each.found.Ts_camera_object[0], each.frame.number or (0, 0)
        parts = T[:3, :3], T[:3, 3] / 1e-3  # t in mm
        R, t = (" ".join(f"{value:.6f}" for value in part.ravel()) for part in parts)
        number = numbers[each.model.name]
        lines.append(f"{scene},{image},{number},{each.explained:.4f},{R},{t},{row.seconds:.4f}")
    return lines
