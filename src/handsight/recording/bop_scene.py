"""Scenes as the BOP benchmark has them, to `Frame`s: one scene's folder, or a split's with scenes in it.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from handsight.camera import Camera
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.objects.library.index import INFO
from handsight.recording.frames import Frame, Frames, Unread
from handsight.recording.rgbd import Beside, color_beside, mask_of, read_each
from handsight.vision import read_color, read_depth
from handsight.vision.pixels import MILLIMETRE

CAMERAS = "scene_camera.json"
LARGEST_DOCUMENT = 100_000_000
"""Bytes of a scene's cameras; what is known of a hundred thousand images."""
COLORS = ("rgb", "gray")
ABOVE = 2
"""A data set's `models` lie so many folders above a scene: data set, split, scene."""


class ImageCamera(msgspec.Struct):
    """An `ImageCamera` is what the file says of an image; keys that nobody here asks for are left alone."""

    cam_K: tuple[float, float, float, float, float, float, float, float, float]
    """3 x 3, row by row [pixels]."""
    depth_scale: Annotated[float, Meta(gt=0)]
    """Millimetres of a step of depth."""


def is_scenes(path: Path) -> bool:
    """Returns whether a folder is a scene, or has scenes in it."""
    return bool(_scenes(path))


def bop_scenes(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a scene, or of all scenes of a split, by their numbers; raises InvalidFile.

    What is told beside is the mask only; the rest stands in the scene.
    """
    if beside.camera is not None or beside.color is not None or beside.depth_scale != MILLIMETRE:
        raise InvalidInput(f"{path}: expected no camera, colour and depth scale beside a BOP scene, got one")
    scenes = [(scene, _cameras(scene)) for scene in _scenes(path)]
    count = sum(len(cameras) for _, cameras in scenes)
    each = (frame for scene, cameras in scenes for frame in _frames(scene, cameras, beside))
    return Frames(count, each, _library(scenes[0][0]))


def _scenes(path: Path) -> list[Path]:
    if (path / CAMERAS).is_file():
        return [path]
    return sorted(folder for folder in path.iterdir() if (folder / CAMERAS).is_file())


def _library(scene: Path) -> Path | None:
    """Returns the data set's folder, where it has models."""
    root = scene.resolve().parents[ABOVE - 1 :][:1]
    return next((folder for folder in root if (folder / "models" / INFO).is_file()), None)


def _cameras(scene: Path) -> dict[int, ImageCamera]:
    where = scene / CAMERAS
    found = decode(read_bytes(where, LARGEST_DOCUMENT), dict[str, ImageCamera], str(where))
    if wrong := next((key for key in found if not _is_number(key)), None):
        raise InvalidFile(f"{where}: expected numbers of images as keys, got {wrong!r:.80}")
    if not found:
        raise InvalidFile(f"{where}: expected a camera for each image, got none")
    return {int(key): camera for key, camera in sorted(found.items(), key=lambda pair: int(pair[0]))}


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdecimal() and len(key) < 10


def _frames(scene: Path, cameras: dict[int, ImageCamera], beside: Beside) -> Iterator[Frame | Unread]:
    number = int(scene.name) if _is_number(scene.name) else 0
    files = {scene / "depth" / f"{image:06d}.png": image for image in cameras}

    def read(file: Path) -> Frame:
        return _frame(file, (number, files[file]), cameras[files[file]], beside)

    return read_each(list(files), read)


def _frame(file: Path, number: tuple[int, int], of: ImageCamera, beside: Beside) -> Frame:
    depth = read_depth(file, MILLIMETRE * of.depth_scale)
    height, width = depth.shape
    scene = file.parents[1]
    try:
        camera = _camera(of.cam_K, (width, height))
    except InvalidInput as error:
        message = str(error).removeprefix("matrix: ")
        raise InvalidFile(f"{scene / CAMERAS}: {number[1]}.cam_K: {message}") from None
    color = color_beside(scene, file.stem, COLORS)
    return Frame(
        name=f"{scene.name}/{file.stem}",
        camera=camera,
        depth=depth,
        color=None if color is None else read_color(color, camera=camera),
        wanted=mask_of(beside.mask, file.stem, camera),
        number=number,
    )


@lru_cache(maxsize=8)
def _camera(K: tuple[float, ...], size: tuple[int, int]) -> Camera:
    """Returns the camera of one data set's images; its rays are worked out once."""
    return Camera(np.array(K).reshape(3, 3), size)
