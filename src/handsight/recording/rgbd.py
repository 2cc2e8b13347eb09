"""Depth images of 16 bits beside their camera's JSON, alone or in a folder, to `Frame`s.

A folder has `camera.json` and depth images in `depth/`, with colour under the same names in `rgb/` or `color/`, where
there is any; or depth images side by side, which have `depth` in their names.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handsight.camera import Camera
from handsight.checks import Mask
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.recording.frames import Frame, Frames, Unread
from handsight.vision import read_camera, read_color, read_depth
from handsight.vision.pixels import MILLIMETRE, Color

CAMERA = "camera.json"
COLORS = ("rgb", "color")
ENDINGS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """A `Beside` is what goes with depth images, where it is told."""

    camera: Path | None = None
    """None: `camera.json` beside the images."""
    depth_scale: float = MILLIMETRE
    """Metres of a step of depth."""
    color: Path | None = None
    """Of one depth image."""
    mask: Path | None = None
    """An image that is not 0 where the object may be, for all pictures; or a folder of such under their names."""


def depth_file(path: Path, beside: Beside) -> Frames:
    """Returns the one frame of a depth image; raises InvalidFile, InvalidInput, MissingExtra."""
    camera = read_camera(beside.camera or path.with_name(CAMERA))
    return Frames(1, iter([_frame(path, camera, beside.color, beside)]))


def depth_folder(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a folder by their names; raises InvalidFile where it has none, or no camera."""
    if beside.color is not None:
        raise InvalidInput(f"color: expected beside one depth image, got {path}, a folder of them")
    inner = path / "depth"
    files = images(inner) if inner.is_dir() else [file for file in images(path) if "depth" in file.name]
    if not files:
        raise InvalidFile(f"{path}: expected depth images, depth/*.png or *depth*.png, got none")
    camera = read_camera(beside.camera or path / CAMERA)

    def read(file: Path) -> Frame:
        color = color_beside(path, file.stem, COLORS) if inner.is_dir() else None
        return _frame(file, camera, color, beside)

    return Frames(len(files), read_each(files, read))


def images(folder: Path) -> list[Path]:
    """Returns the PNGs of a folder by their names."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() == ".png")


def read_each(files: list[Path], read: Callable[[Path], Frame]) -> Iterator[Frame | Unread]:
    """Yields what `read` makes of each, and what it refuses."""
    for file in files:
        try:
            yield read(file)
        except HandsightError as error:
            yield Unread(str(file), str(error))


def color_beside(folder: Path, stem: str, folders: tuple[str, ...]) -> Path | None:
    """Returns the colour image of that name; None where there is none."""
    places = (folder / name / f"{stem}{ending}" for name in folders for ending in ENDINGS)
    return next((place for place in places if place.exists()), None)


def mask_of(mask: Path | None, stem: str, camera: Camera) -> Mask | None:
    """Returns where the object may be in the picture of that name; raises InvalidFile, MissingExtra."""
    if mask is None:
        return None
    shown: Color = read_color(mask / f"{stem}.png" if mask.is_dir() else mask, camera=camera)
    return np.asarray(shown.any(axis=2))


def _frame(depth: Path, camera: Camera, color: Path | None, beside: Beside) -> Frame:
    return Frame(
        name=depth.name,
        camera=camera,
        depth=read_depth(depth, beside.depth_scale, camera=camera),
        color=None if color is None else read_color(color, camera=camera),
        wanted=mask_of(beside.mask, depth.stem, camera),
    )
