"""What other programs say of images: where objects are, their poses, and which objects to find.

Rows of their files belong to an image by its name or number, and to an object by its name or BOP's number. How many do
is said, and that none does is an error: files of another split would otherwise count as images without objects.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Generic, Protocol, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.objects import ObjectModel
from handsight.recording.detection_file import MAX_BYTES, GivenDetection, Number, read_detections
from handsight.recording.folder import image_number
from handsight.recording.frames import Frame, ImageName, Unread
from handsight.recording.pose_file import UNKNOWN, GivenPose, read_poses

MAX_STARTS = 10
"""Poses of an object in an image that are used, those with the highest scores."""
BEHIND_SHARE = 0.9
"""An object is behind what an image shows where this share of its pixels is nearer than its own surface can be."""


class TargetForm(msgspec.Struct):
    """An entry of `test_targets_bop19.json`: how often an object is in an image."""

    scene_id: Number
    im_id: Number
    obj_id: Number
    inst_count: Annotated[int, Meta(ge=1, le=10_000)] = 1


@dataclass(frozen=True, slots=True)
class Target:
    """How often an object is in an image."""

    scene: int | None
    image: str
    object: str
    count: int


class Row(Protocol):
    """A row of a file about an image and an object."""

    @property
    def scene(self) -> int | None: ...
    @property
    def image(self) -> str: ...
    @property
    def object(self) -> str: ...


R = TypeVar("R", bound=Row)


class Rows(Generic[R]):
    """A file's rows about the images and the objects to locate."""

    def __init__(
        self, path: Path, rows: Sequence[R], names: Mapping[str, str], images: Sequence[ImageName]
    ) -> None:
        """`names`: the objects to locate, by name and by BOP's number as text. Raises InvalidFile where no row is about
        these objects or images."""
        self._names = names
        self._by_image = defaultdict[str, list[R]](list)
        self._only = len(images) == 1
        objects = set(names.values())
        came = sorted({row.object for row in rows})
        # One object is asked for, and one there is: without a name there, or without a number here, as a mesh file.
        unnamed = came == [UNKNOWN] or names.keys() == objects
        if len(objects) == len(came) == 1 and unnamed and came[0] not in names:
            self._names = {came[0]: next(iter(objects))}
        known = [row for row in rows if row.object in self._names]
        if rows and not known:
            expected = ", ".join(names) or "objects with numbers in a library"
            raise InvalidFile(f"{path}: expected objects {expected}, got {', '.join(came)}")
        for row in known:
            self._by_image[_key(row.image)].append(row)
        matched = sum(len(self.of(image)) for image in images)
        self.sentence = f"{path}: {matched} of {len(rows)} rows are about these images and objects"
        if rows and not matched:
            shown = ", ".join(dict.fromkeys(image.text for image in images[:4]))
            others = ", ".join(dict.fromkeys(ImageName(row.scene, row.image).text for row in known[:4]))
            expected = f"expected rows about the images {shown}{', ...' * (len(images) > 4)}"
            raise InvalidFile(
                f"{path}: {expected}, got {others}{', ...' * (len(known) > 4)}: 0 of {len(rows)} match"
            )

    def of(self, image: ImageName) -> list[tuple[str, R]]:
        """Returns the rows of an image, each with its object's name."""
        rows = self._by_image.get(_key(image.stem), [])
        if self._only and not image_number(image.stem):  # the only image, whose name has no number
            rows = next(iter(self._by_image.values())) if len(self._by_image) == 1 else rows
        elif self._only:
            rows = rows or self._by_image.get(UNKNOWN, [])
        same = [row for row in rows if None in (row.scene, image.scene) or row.scene == image.scene]
        return [(self._names[row.object], row) for row in same]


def _key(image: str) -> str:
    return image_number(image) or image


class Hints:
    """What files of other programs say of images."""

    def __init__(
        self,
        models: Mapping[str, ObjectModel],
        numbers: Mapping[str, str],
        images: Sequence[ImageName],
        *,
        detections: Path | None = None,
        start: Path | None = None,
        targets: Path | None = None,
    ) -> None:
        """Reads the files. `models`: the objects to locate, by name; `numbers`: their names by BOP's numbers as text.
        `images`: all that there are. Raises InvalidFile, also where a file has none of these objects or images."""
        self._models = models
        names = {name: name for name in models} | dict(numbers)
        self._detections: Rows[GivenDetection] | None = None
        self._starts: Rows[GivenPose] | None = None
        self._targets: Rows[Target] | None = None
        if detections is not None:
            self._detections = Rows(detections, read_detections(detections), names, images)
        if start is not None:
            self._starts = Rows(start, read_poses(start), names, images)
        if targets is not None:
            self._targets = Rows(targets, _read_targets(targets), names, images)
        self._names = names

    @property
    def sentences(self) -> list[str]:
        """How many rows of each file are used."""
        return [rows.sentence for rows in (self._detections, self._starts, self._targets) if rows is not None]

    def beside_each(self, frames: Iterable[Frame | Unread]) -> Iterator[Frame | Unread]:
        """Yields the frames with what the files say of them, without those in which nothing is to be found."""
        for frame in frames:
            try:
                found = frame if isinstance(frame, Unread) else self.beside(frame)
            except HandsightError as error:
                found = Unread(frame.name, str(error))
            if found is not None:
                yield found

    def beside(self, frame: Frame) -> Frame | None:
        """Returns a frame with what the files say of it; None: it has no target. Raises InvalidInput where a detection
        cannot be in it."""
        if self._targets is not None:
            targets = Counter[str]()
            for name, target in self._targets.of(frame.image):
                targets[name] += target.count
            if not targets:
                return None
            frame = replace(frame, targets=dict(targets))
        if self._starts is not None:
            frame = self._with_starts(frame, self._starts)
        if frame.detections is None and self._detections is None:
            return frame
        detections = [
            replace(each, label=self._names.get(each.label, each.label)) for each in frame.detections or ()
        ]
        for name, given in self._detections.of(frame.image) if self._detections is not None else ():
            detections.append(given.detection(name, frame.camera))
        return replace(frame, detections=tuple(detections))

    def _with_starts(self, frame: Frame, starts: Rows[GivenPose]) -> Frame:
        """Returns the frame with the poses that can be in it, and a note about each that cannot."""
        poses = defaultdict[str, list[Array]](list)
        notes = list(frame.notes)
        for name, given in sorted(starts.of(frame.image), key=lambda row: -row[1].score):
            doubt = doubt_of(given.T_camera_object, self._models[name], frame)
            if doubt:
                notes.append(f"{given.place}: not used: {doubt}")
            elif len(poses[name]) < MAX_STARTS:
                poses[name].append(given.T_camera_object)
        found = {name: np.array(several) for name, several in poses.items() if several}
        return replace(frame, starts=found or None, notes=tuple(notes))


def doubt_of(T_camera_object: Array, model: ObjectModel, frame: Frame) -> str:
    """Returns why a pose (4, 4) cannot be that of the object in an image; empty where it can."""
    center = se3.apply(T_camera_object, model.center_object[None])[0]
    distance = float(np.linalg.norm(center))
    size = model.diameter
    if distance < size / 2:
        return f"the object of {1e3 * size:.0f} mm would be {1e3 * distance:.3g} mm from the camera (in another unit?)"
    if center[2] <= 0:
        return "the object would be behind the camera"
    (pixel,) = frame.camera.project(center[None])
    half = frame.camera.matrix[0, 0] * size / (2 * center[2])
    width, height = frame.camera.size
    if not (pixel > -half).all() or (pixel >= np.array([width, height]) + half).any():
        return "the object would be outside the image"
    left, top = np.maximum(pixel - half / 2, 0).astype(int)
    right, bottom = np.ceil(pixel + half / 2).astype(int) + 1
    depth = frame.depth[top:bottom, left:right]
    known = depth[depth > 0]
    if known.size and np.mean(known < center[2] - size / 2) > BEHIND_SHARE:
        seen = float(np.median(known))
        place = f"at {center[2]:.3g} m, behind what the image shows at {seen:.3g} m"
        return f"the object would be {place} (in another unit?)"
    return ""


def _read_targets(path: Path) -> list[Target]:
    """Returns the entries of a file of targets; raises InvalidFile."""
    entries = decode(read_bytes(path, MAX_BYTES), list[TargetForm], str(path))
    return [Target(each.scene_id, str(each.im_id), str(each.obj_id), each.inst_count) for each in entries]
