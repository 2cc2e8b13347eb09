"""What other programs say of images, in the files of the BOP benchmark: detections, poses, and which objects to find.

Detections are those that CNOS writes, with masks in COCO's run-length encoding. The formats:
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md and .../bop_challenge_2023/README.md
"""

import csv
import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Mask
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.observation import MAX_PIXEL, Detection2D
from handsight.recording.frames import Frame, Unread

BOP_COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
"""The columns of a file of BOP results; t is in millimetres."""
Number = Annotated[int, Meta(ge=0, lt=10**9)]
Place = Annotated[float, Meta(ge=-MAX_PIXEL, le=MAX_PIXEL)]
Extent = Annotated[float, Meta(ge=0, le=MAX_PIXEL)]
ImageNumber = tuple[int, int]
"""BOP's numbers of the scene and of the image."""


MAX_BYTES = 1 << 29  # of a file of detections or targets
MAX_STARTS = 10  # poses of an object in an image that are used, those with the highest scores


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
    rows, found = csv.reader(text.splitlines(), strict=True), list[BopResult]()
    try:
        for row in rows:
            names = [cell.strip() for cell in row]
            if rows.line_num == 1 and names and not any(re.search(r"\d", name) for name in names[:3]):
                if names != BOP_COLUMNS.split(","):
                    raise ValueError(f"expected the columns {BOP_COLUMNS}, got {','.join(names)[:100]}")
            elif row:
                found.append(_result(row))
    except (ValueError, OverflowError, csv.Error, HandsightError) as error:
        raise InvalidFile(f"{path}: line {rows.line_num}: {error}") from None
    return found


def _result(row: list[str]) -> BopResult:
    """Returns the result of one row; raises ValueError or InvalidInput."""
    names = BOP_COLUMNS.split(",")
    if len(row) != len(names):
        raise ValueError(f"expected {len(names)} columns, {BOP_COLUMNS}, got {len(row)}")
    numbers = dict[str, Array]()
    for name, cell, count in zip(names, row, (1, 1, 1, 1, 9, 3, 1), strict=True):
        is_integer = name.endswith("_id")
        try:
            numbers[name] = np.array([int(cell)] if is_integer else [float(word) for word in cell.split()])
        except ValueError:
            numbers[name] = np.zeros(0)
        if len(numbers[name]) != count or not np.isfinite(numbers[name].astype(float)).all():
            kind = "a whole number" if is_integer else f"{count} finite number{'s' * (count > 1)}"
            raise ValueError(f"{name}: expected {kind}, got {cell[: 40 if is_integer else 60]!r}")
    try:
        R = se3.rounded(se3.compose(numbers["R"].reshape(3, 3), np.zeros(3)), "R")[:3, :3]
    except InvalidInput:
        raise ValueError(f"R: expected a rotation, got {row[4][:60]!r}") from None
    T = se3.check(se3.compose(R, 1e-3 * numbers["t"]), "t")
    score, seconds = float(numbers["score"][0]), float(numbers["time"][0])
    scene, image, number = (int(numbers[name][0]) for name in names[:3])
    return BopResult(scene, image, number, score, T, seconds if seconds >= 0 else None)


class RunLengths(msgspec.Struct):
    """`RunLengths` are a mask in COCO's encoding."""

    size: tuple[Number, Number]
    """Rows and columns."""
    counts: list[Number] | str
    """How many pixels are alternately not in the mask and in it, column by column; or these as COCO's text."""

    def mask(self, camera: Camera) -> Mask:
        """Returns the mask (h, w); raises InvalidInput where it is not of the camera's images."""
        (h, w), (width, height) = self.size, camera.size
        if (h, w) != (height, width):
            raise InvalidInput(f"size: expected {height} rows, {width} columns as the image, got {h}, {w}")
        counts = _run_lengths(self.counts) if isinstance(self.counts, str) else self.counts
        if sum(counts) != h * w or min(counts, default=0) < 0:
            raise InvalidInput(f"counts: expected runs of {h * w} pixels in all, got {sum(counts)}")
        inside = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
        return np.asarray(inside.reshape(w, h).T)


def _run_lengths(text: str) -> list[int]:
    """Returns the run lengths in COCO's text; raises InvalidInput.

    Each number is written in digits of five bits, the lowest first, as characters from `0` on; a sixth bit says that
    more follow, and the highest bit of the last digit is the sign. From the fourth number on, each is the difference
    to the one two before it (`rleToString` in https://github.com/cocodataset/cocoapi/blob/master/common/maskApi.c).
    """
    counts, value, shift = list[int](), 0, 0
    for character in text:
        digit = ord(character) - 48
        if not 0 <= digit < 64 or shift > 30:
            came = f"{character!r} after {len(counts)} numbers"
            raise InvalidInput(f"counts: expected COCO's run lengths, got {came}")
        value |= (digit & 31) << shift
        shift += 5
        if not digit & 32:
            value -= (digit & 16) << (shift - 4) if digit & 16 else 0
            counts.append(value + counts[-2] if len(counts) > 2 else value)
            value = shift = 0
    if shift:
        came = f"a text that ends in number {len(counts)}"
        raise InvalidInput(f"counts: expected COCO's run lengths, got {came}")
    return counts


class DetectionForm(msgspec.Struct):
    """A `DetectionForm` is an entry of a file of detections; other keys, such as `time`, are ignored."""

    scene: Number = msgspec.field(name="scene_id")
    image: Number = msgspec.field(name="image_id")
    object: Number = msgspec.field(name="category_id")
    bbox: tuple[Place, Place, Extent, Extent]
    """First column and row, width and height [pixels]."""
    score: Annotated[float, Meta(ge=0, le=1)]
    segmentation: RunLengths | None = None


class TargetForm(msgspec.Struct):
    """A `TargetForm` is an entry of `test_targets_bop19.json`: how often an object is in an image."""

    scene: Number = msgspec.field(name="scene_id")
    image: Number = msgspec.field(name="im_id")
    object: Number = msgspec.field(name="obj_id")
    inst_count: Annotated[int, Meta(ge=1, le=10_000)] = 1


def read_detections(path: str | os.PathLike[str]) -> list[DetectionForm]:
    """Returns the detections of a JSON file as CNOS writes it; raises InvalidFile."""
    return decode(read_bytes(path, MAX_BYTES), list[DetectionForm], str(path))


def read_targets(path: str | os.PathLike[str]) -> list[TargetForm]:
    """Returns which objects to find, of a file such as `test_targets_bop19.json`; raises InvalidFile."""
    return decode(read_bytes(path, MAX_BYTES), list[TargetForm], str(path))


Rows = dict[ImageNumber, list[tuple[str, int, Any]]]
"""By image: the name of an object, the index of an entry of a file about it, and that entry."""


class Hints:
    """`Hints` are what files of other programs say of images: where objects are, their poses, and which to find."""

    def __init__(
        self,
        names: Sequence[str],
        numbers: Mapping[str, int],
        *,
        detections: Path | None = None,
        start: Path | None = None,
        targets: Path | None = None,
    ) -> None:
        """Reads the files; raises InvalidFile, also where a file has none of the objects that there are.

        names: of the objects to locate; numbers: those by which BOP's files call all objects that there are, by name.
        One object without a number is the one of a file that has only one.
        """
        self._name, self._alone = names[0], len(names) == 1 and names[0] not in numbers
        self._names = {number: name for name, number in numbers.items() if name in names}
        self._known = set(numbers.values())
        self.sentences: list[str] = []
        """What a user should know of the files."""
        self._place, self._chosen, by_image = detections, targets is not None, self._by_image
        self._detections = by_image(detections, "category_id", read_detections)
        self._starts = by_image(start, "obj_id", read_bop_results)
        self._targets = by_image(targets, "obj_id", read_targets)

    def _by_image(self, path: Path | None, key: str, read: Callable[[Path], list[Any]]) -> Rows:
        """Returns the entries of a file that are of the objects to locate, by image; none if there is no file."""
        if path is None:
            return {}
        rows, names = read(path), self._names
        came, known = {row.object for row in rows}, ", ".join(map(str, sorted(self._known)[:10]))
        if self._alone and len(came) == 1:
            names = dict.fromkeys(came, self._name)
        elif strange := sorted(came - self._known):
            listed = ", ".join(map(str, strange[:5]))
            if len(strange) == len(came):
                alone = f"one object only, as {self._name} has no number in a library"
                expected = f"one of {known}" if known else alone
                raise InvalidFile(f"{path}: {key}: expected {expected}, got {listed}")
            self.sentences.append(f"{path}: {key} {listed}: no such object; left out")
        found: Rows = defaultdict(list)
        for k, row in enumerate(rows):
            found[row.scene, row.image] += [(names[row.object], k, row)] if row.object in names else []
        return dict(found)

    def _of(self, frame: Frame, rows: Rows) -> list[tuple[str, int, Any]]:
        """Returns the entries about an image; raises InvalidInput where its number is unknown.

        An image of a folder has the last number in its name, and is of the only scene that there is.
        """
        if frame.number is not None:
            return rows.get(frame.number, [])
        scenes, digits = sorted({scene for scene, _ in rows}), re.findall(r"[0-9]+", Path(frame.name).stem)
        if len(scenes) > 1:
            listed, expected = ", ".join(map(str, scenes[:5])), "files of one scene beside images of none"
            raise InvalidInput(f"{frame.name}: expected {expected}, got {listed}")
        if not digits and len(rows) > 1:
            expected = "expected a number in its name, by which a file has it"
            raise InvalidInput(f"{frame.name}: {expected}, got none")
        return next((rows[each] for each in rows if not digits or each[1] == int(digits[-1])), [])

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
        """Returns a frame with what the files say of it; None: no target is in it. Raises HandsightError."""
        targets, Ts, detections = Counter[str](), defaultdict[str, list[Array]](list), frame.detections
        for name, _, target in self._of(frame, self._targets):
            targets[name] += target.inst_count
        if self._chosen and not targets:
            return None
        for name, _, result in sorted(self._of(frame, self._starts), key=lambda row: -row[2].score):
            Ts[name].append(result.T_camera_object)
        starts = {name: np.array(poses[:MAX_STARTS]) for name, poses in Ts.items()}
        if detections is not None:
            names = {str(number): name for number, name in self._names.items()}
            detections = tuple(replace(each, label=names.get(each.label, each.label)) for each in detections)
        if self._place is not None:
            found = (self._detection(frame, *row) for row in self._of(frame, self._detections))
            detections = (*(detections or ()), *found)
        return replace(frame, detections=detections, starts=starts or None, targets=dict(targets) or None)

    def _detection(self, frame: Frame, name: str, index: int, form: DetectionForm) -> Detection2D:
        """Returns a detection with its mask; raises InvalidFile."""
        mask, (u, v, width, height), (most_u, most_v) = None, form.bbox, frame.camera.size
        where = f"{self._place}: [{index}]"
        if u + width < 0 or v + height < 0 or u > most_u - 1 or v > most_v - 1:
            expected = f"expected a box that meets the image of {most_u} x {most_v} pixels"
            raise InvalidFile(f"{where}.bbox: {expected}, got {list(form.bbox)}")
        try:
            if form.segmentation is not None:
                mask = form.segmentation.mask(frame.camera)
        except InvalidInput as error:
            raise InvalidFile(f"{where}.segmentation.{error}") from None
        return Detection2D(name, max(form.score, 1e-6), (u, v, u + width, v + height), mask)
