"""Where detectors have objects in images, from their files, told apart by their content.

What is read: results as CNOS, SAM-6D and COCO have them (JSON, a list), COCO's ground truth (JSON, with `annotations`),
and YOLO's text, one file an image. Masks are COCO's run lengths, not compressed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from handsight.camera import Camera
from handsight.checks import Mask
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_bytes, read_text
from handsight.msgspec_errors import JsonObject, convert, decode_json
from handsight.observation import MAX_PIXEL, Detection2D
from handsight.vision.object.locate import search_mask

MAX_BYTES = 1 << 29
"""Of a file."""
Number = Annotated[int, Meta(ge=0, lt=10**9)]
Place = Annotated[float, Meta(ge=-MAX_PIXEL, le=MAX_PIXEL)]
Extent = Annotated[float, Meta(ge=0, le=MAX_PIXEL)]
Share = Annotated[float, Meta(ge=0, le=1)]


class RunLengths(msgspec.Struct):
    """A mask in COCO's encoding, not compressed."""

    size: tuple[Number, Number]
    """Rows and columns."""
    counts: list[Number]
    """How many pixels are alternately not in the mask and in it, column by column."""

    def mask(self, camera: Camera) -> Mask:
        """Returns the mask (h, w); raises InvalidInput where it is not of the camera's images."""
        width, height = camera.size
        if self.size != (height, width):
            raise InvalidInput(f"size: expected {height} rows, {width} columns as the image, got {self.size}")
        inside = np.arange(len(self.counts)) % 2 == 1
        if sum(self.counts) != height * width:
            came = f"{sum(self.counts)} in all"
            raise InvalidInput(f"counts: expected runs of {height * width} pixels, got {came}")
        return np.repeat(inside, self.counts).reshape(width, height).T


class ResultForm(msgspec.Struct):
    """A detector's result; other keys, such as `time`, are ignored."""

    image_id: Number
    category_id: Number
    bbox: tuple[Place, Place, Extent, Extent]
    """First column and row, width and height [pixels]."""
    score: Share | None = None
    scene_id: Number | None = None
    segmentation: RunLengths | None = None


class ImageForm(msgspec.Struct):
    """An image of COCO's ground truth."""

    id: Number
    file_name: str


class CategoryForm(msgspec.Struct):
    """A category of COCO's ground truth."""

    id: Number
    name: str


class TruthForm(msgspec.Struct):
    """COCO's ground truth."""

    annotations: list[ResultForm]
    images: list[ImageForm] = []
    categories: list[CategoryForm] = []


@dataclass(frozen=True, slots=True, eq=False)
class GivenDetection:
    """Where a detector has an object in an image."""

    scene: int | None
    """BOP's number of the scene; None: the file has none."""
    image: str
    """The image's name without its ending, or its number as text."""
    object: str
    """The object's name or number as text."""
    score: float | None
    box: tuple[float, float, float, float]
    """First column and row, width and height [pixels]; or shares of the image's sides."""
    in_shares: bool = False
    mask: RunLengths | None = None

    def detection(self, name: str, camera: Camera) -> Detection2D:
        """Returns it as a detection of that object in a camera's image; raises InvalidInput."""
        u, v, width, height = self.box
        if self.in_shares:
            columns, rows = camera.size
            u = columns * u - 0.5
            v = rows * v - 0.5
            width = columns * width
            height = rows * height
        box = u, v, u + width, v + height
        search_mask(camera, box, None)  # raises where it is outside the image
        mask = None if self.mask is None else self.mask.mask(camera)
        return Detection2D(name, None if self.score is None else max(self.score, 1e-6), box, mask)


def read_detections(path: Path) -> list[GivenDetection]:
    """Returns the detections in a file or a folder; see the top of this module for what is read.

    Raises InvalidFile, which names the file and the field or the line.
    """
    if path.is_dir():
        files = sorted(path.glob("*.txt"))
        if not files:
            raise InvalidFile(f"{path}: expected detections, a .txt for each image, got none")
        return [found for file in files for found in _yolo(file)]
    if path.suffix == ".txt":
        return list(_yolo(path))
    document = decode_json(read_bytes(path, MAX_BYTES), str(path))
    if isinstance(document, dict) and "annotations" in document:
        return list(_truth(document, str(path)))
    results = convert(document, list[ResultForm], str(path))
    return [_given(each, str(each.image_id), str(each.category_id)) for each in results]


def _given(result: ResultForm, image: str, name: str) -> GivenDetection:
    return GivenDetection(result.scene_id, image, name, result.score, result.bbox, mask=result.segmentation)


def _truth(document: JsonObject, where: str) -> Iterator[GivenDetection]:
    """Yields COCO's annotations, by the names of their images and categories. Polygons are left out: the box stays."""
    for entry in document["annotations"] if isinstance(document["annotations"], list) else ():
        if isinstance(entry, dict) and isinstance(entry.get("segmentation"), list):
            del entry["segmentation"]
    truth = convert(document, TruthForm, where)
    images = {image.id: Path(image.file_name).stem for image in truth.images}
    names = {category.id: category.name for category in truth.categories}
    for each in truth.annotations:
        image = images.get(each.image_id, str(each.image_id))
        yield _given(each, image, names.get(each.category_id, str(each.category_id)))


def _yolo(path: Path) -> Iterator[GivenDetection]:
    """Yields the lines of YOLO's text: a class, the box's middle and size as shares of the image's sides, and a score.

    Raises InvalidFile, which names the line.
    """
    for number, line in enumerate(read_text(path, MAX_BYTES).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[1:]]
            fits = len(values) in (4, 5) and all(0 <= value <= 1 for value in values) and words[0].isdecimal()
        except ValueError:
            fits = False
        if not fits:
            expected = "expected class, x, y, width, height in shares of the image, and maybe a score"
            raise InvalidFile(f"{path}: line {number}: {expected}, got {line!r:.80}")
        x, y, width, height = values[:4]
        box = x - width / 2, y - height / 2, width, height
        yield GivenDetection(
            None, path.stem, words[0], values[4] if values[4:] else None, box, in_shares=True
        )
