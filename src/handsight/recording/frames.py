"""Images in which to find an object: depth, colour, masks, and the files that belong to them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Mask
from handsight.errors import HandsightError, InvalidInput
from handsight.vision import read_color
from handsight.vision.pixels import MILLIMETRE, Color

Box = tuple[int, int, int, int]
"""First column and row, last column and row, both included [pixels]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame:
    """A `Frame` is one image of a depth camera."""

    name: str
    """The name of the image in messages and answers."""
    camera: Camera
    depth: Depth
    """(h, w) depth along the optical axis [m], NaN where unknown."""
    color: Color | None = None
    """(h, w, 3) red, green and blue, with the pixels of the depth."""
    wanted: Mask | None = None
    """(h, w) pixels in which the object may be; None: all."""
    hand: Mask | None = None
    """(h, w) pixels of the hand; None: unknown."""
    number: tuple[int, int] | None = None
    """BOP's numbers of the scene and of the image."""


class Unread(NamedTuple):
    """An `Unread` is an image that cannot be read."""

    name: str
    reason: str
    """The file, what was expected, and what came."""


class Frames(NamedTuple):
    """`Frames` are images that are read one by one, as the iterator advances."""

    total: int | None
    """Number of images; None: it is known only at the end."""
    each: Iterator[Frame | Unread]
    library: Path | None = None
    """Folder of the library of their objects; None: the data set has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """A `Beside` is what a user declares about depth images: the files that belong to them, and their unit."""

    camera: Path | None = None
    """The file of the camera; None: `camera.json` beside the images."""
    depth_scale: float = MILLIMETRE
    """Metres per step of depth."""
    color: Path | None = None
    """The colour image of a single depth image."""
    mask: Path | None = None
    """An image that is not 0 where the object may be, for all depth images; or a folder with one for each by name."""

    def wanted(self, stem: str, camera: Camera) -> Mask | None:
        """Returns the mask (h, w) of where the object may be in the image of that name; None: anywhere.

        Raises InvalidFile, MissingExtra.
        """
        if self.mask is None:
            return None
        path = self.mask / f"{stem}.png" if self.mask.is_dir() else self.mask
        return np.asarray(read_color(path, camera=camera).any(axis=2))


def read_each(files: list[Path], read: Callable[[Path], Frame]) -> Iterator[Frame | Unread]:
    """Yields the frame of each file, or an `Unread` with the reason where `read` raises a HandsightError."""
    for file in files:
        try:
            yield read(file)
        except HandsightError as error:
            yield Unread(str(file), str(error))


def color_beside(folder: Path, stem: str, folders: tuple[str, ...]) -> Path | None:
    """Returns the path of the colour image of that name in one of the folders; None where there is none."""
    endings = (".png", ".jpg", ".jpeg")
    places = (folder / name / f"{stem}{ending}" for name in folders for ending in endings)
    return next((place for place in places if place.exists()), None)


def within(frame: Frame, box: Box) -> Frame:
    """Returns the frame, searched only inside a box; raises InvalidInput for a box beyond its pixels."""
    left, top, right, bottom = box
    width, height = frame.camera.size
    if not (0 <= left <= right < width and 0 <= top <= bottom < height):
        expected = f"expected u0,v0,u1,v1 from 0,0 to {width - 1},{height - 1}"
        raise InvalidInput(f"box: {expected}, got {','.join(map(str, box))} ({frame.name})")
    inside = np.zeros((height, width), dtype=bool)
    inside[top : bottom + 1, left : right + 1] = True
    return replace(frame, wanted=inside if frame.wanted is None else inside & frame.wanted)
