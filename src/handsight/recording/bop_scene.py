"""Scenes of the BOP benchmark as `Frame`s: one scene's folder, or a split's with scenes in it.

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
from handsight.objects.library.documents import INFO
from handsight.recording.frames import Beside, Frame, Frames, Unread, color_beside, read_each
from handsight.vision import read_color, read_depth
from handsight.vision.pixels import MILLIMETRE

CAMERAS = "scene_camera.json"
LARGEST_DOCUMENT = 100_000_000
"""Bytes of a scene's cameras, as of a hundred thousand images."""
COLORS = ("rgb", "gray")
ABOVE = 2
"""A data set's `models` lie so many folders above a scene: data set, split, scene."""


class ImageCamera(msgspec.Struct):
    """An `ImageCamera` is an image's entry in the file; other keys are ignored."""

    cam_K: tuple[float, float, float, float, float, float, float, float, float]
    """3 x 3, row by row [pixels]."""
    depth_scale: Annotated[float, Meta(gt=0)]
    """Millimetres of a step of depth."""


def is_scenes(path: Path) -> bool:
    """Returns whether a folder is a scene, or has scenes in it."""
    return bool(_scenes(path))


def bop_scenes(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a scene, or of all scenes of a split, by their numbers; raises InvalidFile.

    Only a mask may be declared beside them; the rest is in the scene.
    """
    if beside.camera is not None or beside.color is not None or beside.depth_scale != MILLIMETRE:
        raise InvalidInput(f"{path}: expected no camera, colour and depth scale beside a BOP scene, got one")
    scenes = list[tuple[Path, dict[int, ImageCamera]]]()
    for scene in _scenes(path):
        file = scene / CAMERAS
        found = decode(read_bytes(file, LARGEST_DOCUMENT), dict[str, ImageCamera], str(file))
        if wrong := next((key for key in found if not _is_number(key)), None):
            raise InvalidFile(f"{file}: expected numbers of images as keys, got {wrong!r:.80}")
        if not found:
            raise InvalidFile(f"{file}: expected a camera for each image, got none")
        cameras = {int(key): camera for key, camera in found.items()}
        scenes.append((scene, dict(sorted(cameras.items()))))
    count = sum(len(cameras) for _, cameras in scenes)
    each = (frame for scene, cameras in scenes for frame in _frames(scene, cameras, beside))
    # The data set's folder, where it has models and is that far above.
    above = scenes[0][0].resolve().parents[ABOVE - 1 :][:1]
    library = next((folder for folder in above if (folder / "models" / INFO).is_file()), None)
    return Frames(count, each, library)


def _scenes(path: Path) -> list[Path]:
    if (path / CAMERAS).is_file():
        return [path]
    return sorted(folder for folder in path.iterdir() if (folder / CAMERAS).is_file())


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdecimal() and len(key) < 10


def _frames(scene: Path, cameras: dict[int, ImageCamera], beside: Beside) -> Iterator[Frame | Unread]:
    number = int(scene.name) if _is_number(scene.name) else 0
    files = {scene / "depth" / f"{image:06d}.png": image for image in cameras}

    def read(file: Path) -> Frame:
        image = files[file]
        depth = read_depth(file, MILLIMETRE * cameras[image].depth_scale)
        height, width = depth.shape
        try:
            camera = _camera(cameras[image].cam_K, (width, height))
        except InvalidInput as error:
            message = str(error).removeprefix("matrix: ")
            raise InvalidFile(f"{scene / CAMERAS}: {image}.cam_K: {message}") from None
        color = color_beside(scene, file.stem, COLORS)
        return Frame(
            name=f"{scene.name}/{file.stem}",
            camera=camera,
            depth=depth,
            color=None if color is None else read_color(color, camera=camera),
            wanted=beside.wanted(file.stem, camera),
            number=(number, image),
        )

    return read_each(list(files), read)


@lru_cache(maxsize=8)
def _camera(K: tuple[float, ...], size: tuple[int, int]) -> Camera:
    """Returns the camera of one data set's images; its rays are computed once."""
    return Camera(np.array(K).reshape(3, 3), size)
