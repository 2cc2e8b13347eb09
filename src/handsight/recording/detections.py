"""Detections of objects in images, written as JSON or BOP results."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.messages.report import shortened
from handsight.objects import ObjectModel
from handsight.recording.frames import Frame, Unread
from handsight.vision import ObjectDetection, SceneDetection
from handsight.vision.object.locate import Recognition

MAX_HYPOTHESES = 3
MIN_WEIGHT = 0.01
"""Hypotheses of an object that are written, and the weight above which the others than the best are."""
FAR = 3.0
IMPROBABLE = 0.005
"""Median depth [m] beyond which, and probability below which, an object may be in another unit."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Located:
    """The result of locating an object in one image, or of recognising which of several it shows."""

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
        reason = (self.recognition or self.found).reason
        known = self.frame.depth[self.frame.depth > 0]
        if reason is None or not np.isfinite(known).any():
            return reason
        median = float(np.median(known[np.isfinite(known)]))
        hint = ""
        if median > FAR:
            hint = "; in tenths of millimetres? then --depth-scale 0.0001"
        elif 0 < self.found.probability < IMPROBABLE:  # as everything is at another scale
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
    """The result of locating all of several objects in one image."""

    frame: Frame
    models: Mapping[str, ObjectModel]
    found: SceneDetection
    seconds: float
    """Duration of the search [s]."""

    @property
    def instances(self) -> list[Located]:
        """Each object that was found, the most probable first."""
        located = partial(Located, frame=self.frame, seconds=self.seconds)
        return [located(model=self.models[one.name], found=one.detection) for one in self.found.instances]

    @property
    def reason(self) -> str | None:
        """Why none was found; None: at least one was found."""
        if self.found.instances:
            return None
        return "; ".join(shortened(dict.fromkeys(self.found.missing.values())))


def json_line(row: Located | LocatedAll | Unread) -> str:
    """Returns a line of JSON without its newline; for an unreadable image, `{"frame": ..., "error": ...}`.

    Poses are `T_camera_object`, in the camera's optical frame [m]; of each object's hypotheses the likeliest.
    """
    if isinstance(row, Unread):
        return json.dumps({"frame": row.name, "error": row.reason})
    fields: dict[str, object] = {"frame": row.frame.name}
    if row.frame.number is not None:
        fields |= dict(zip(("scene_id", "im_id"), row.frame.number, strict=True))
    found = row.reason is None
    if isinstance(row, LocatedAll):
        objects = list[dict[str, object]]()
        for each, instance in zip(row.instances, row.found.instances, strict=True):
            pixels = int(instance.pixels.sum())
            objects.append({"object": each.model.name} | _pose_fields(each) | {"pixels": pixels})
        fields |= {"found": found, "objects": objects, "missing": row.found.missing}
    else:
        fields |= {"object": row.name, "found": found}
        if row.recognition is not None:
            fields |= {"scores": row.recognition.scores, "none": row.recognition.none}
        fields |= _pose_fields(row) if found else {"reason": row.reason}
    if row.frame.notes:
        fields["notes"] = row.frame.notes
    fields["seconds"] = row.seconds
    return json.dumps(fields, allow_nan=False, default=np.ndarray.tolist)


def _pose_fields(row: Located) -> dict[str, object]:
    """Returns an object's pose, probability and likeliest hypotheses as JSON has them, but for arrays."""
    found = row.found
    poses = list[dict[str, object]]()
    likely = 1 + int((found.weights[1:MAX_HYPOTHESES] > MIN_WEIGHT).sum())  # the likeliest is the first
    for k in range(likely):
        pose = se3.position_quaternion(found.Ts_camera_object[k])
        poses.append(pose | {"covariance": found.covariances[k]})
    hypotheses = [pose | {"weight": found.weights[k]} for k, pose in enumerate(poses)]
    starts = (row.frame.starts or {}).get(row.model.name)
    from_start = {} if starts is None else {"from_start": _nearest_start(row, starts)}
    return (
        poses[0]
        | from_start
        | {
            "probability": found.probability,
            "explained": row.explained,
            "hypotheses": hypotheses,
        }
    )


def _nearest_start(row: Located, starts: Array) -> dict[str, float]:
    """Returns how far the found pose is from the nearest given one, modulo the object's symmetries."""
    T = row.found.Ts_camera_object[0]
    offs = np.array([se3.difference(row.model.nearest(start, T), T) for start in starts])
    shifts, turns = (np.linalg.norm(part, axis=1) for part in (offs[:, :3], offs[:, 3:]))
    nearest = (shifts + row.model.radius * turns).argmin()
    return {"shift_mm": 1e3 * shifts[nearest], "turn_deg": float(np.degrees(turns[nearest]))}


def bop_lines(row: Located | LocatedAll | Unread, numbers: Mapping[str, int]) -> list[str]:
    """Returns the lines of BOP results without their newlines, one for each object that was found.

    `numbers`: BOP's numbers of the objects, by name. The score is `explained`; the time is that of the whole image.
    """
    if isinstance(row, Unread) or row.reason is not None:
        return []
    lines = list[str]()
    for each in [row] if isinstance(row, Located) else row.instances:
        T = each.found.Ts_camera_object[0]
        scene, image = each.frame.number or (0, 0)
        parts = T[:3, :3], T[:3, 3] / 1e-3  # t in mm
        R, t = (" ".join(f"{value:.6f}" for value in part.ravel()) for part in parts)
        number = numbers[each.model.name]
        lines.append(f"{scene},{image},{number},{each.explained:.4f},{R},{t},{row.seconds:.4f}")
    return lines
