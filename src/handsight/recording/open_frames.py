"""Opening of depth images as `Frames`: an image, a folder of them, a BOP scene, or a robot's recording.

A folder has `camera.json` and depth images of 16 bits. They are either in `depth/`, with optional colour images under
the same names in `rgb/` or `color/`; or in the folder itself, with `depth` in their names. A BOP scene, or a split with
scenes in it, is as in https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

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
from handsight.recording.frames import Beside, Frame, Frames, color_beside, read_each
from handsight.recording.robot_images import recorded_frames
from handsight.rig import Rig
from handsight.vision import read_camera, read_color, read_depth
from handsight.vision.pixels import MILLIMETRE

CAMERAS = "scene_camera.json"


def is_recording(path: Path) -> bool:
    """Returns whether a path is a robot's recording, which needs a rig."""
    return path.suffix.lower() in (".mcap", ".bag", ".db3") or (path / "metadata.yaml").exists()


def open_frames(path: Path, beside: Beside, rig: Rig | None = None) -> Frames:
    """Returns the frames of a depth image, a folder of them, a BOP scene or split, or, with a rig, a recording.

    Raises InvalidFile for any other path, and the errors of the readers.
    """
    try:
        if is_recording(path):
            if rig is None:
                raise InvalidInput(f"rig: expected beside the recording {path}, got none")
            if beside != Beside():
                what = "expected no camera, colour, mask or depth scale beside a recording"
                raise InvalidInput(f"{path}: {what}")
            return recorded_frames(path, rig)
        if path.is_dir():
            # The folder itself is a scene, else the folders in it may be.
            scenes = [path] if (path / CAMERAS).is_file() else sorted(path.iterdir())
            if scenes := [folder for folder in scenes if (folder / CAMERAS).is_file()]:
                return _bop_frames(path, scenes, beside)
        return _depth_images(path, beside)
    except OSError as error:
        raise InvalidFile(f"{error.filename or path}: {error.strerror or error}") from None


def _depth_images(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a folder in the order of their names, or of one image; raises InvalidFile, InvalidInput."""
    folder, files, in_folders = path.parent, [path], False
    if path.is_dir():
        if beside.color is not None:
            raise InvalidInput(f"color: expected beside one depth image, got {path}, a folder of them")
        folder, in_folders = path, (path / "depth").is_dir()
        inside = path / "depth" if in_folders else path
        pngs = sorted(file for file in inside.iterdir() if file.suffix.lower() == ".png")
        files = [file for file in pngs if in_folders or "depth" in file.name]
        if not files:
            raise InvalidFile(f"{path}: expected depth images, depth/*.png or *depth*.png, got none")
    camera = read_camera(beside.camera or folder / "camera.json")

    def read(file: Path) -> Frame:
        color = color_beside(folder, file.stem, ("rgb", "color")) if in_folders else beside.color
        return Frame(
            name=file.name,
            camera=camera,
            depth=read_depth(file, beside.depth_scale, camera=camera),
            color=None if color is None else read_color(color, camera=camera),
            wanted=beside.wanted(file.stem, camera),
        )

    return Frames(len(files), read_each(files, read) if folder is path else iter([read(path)]))


class ImageCamera(msgspec.Struct):
    """An `ImageCamera` is an image's entry in the file of cameras; other keys are ignored."""

    cam_K: tuple[float, float, float, float, float, float, float, float, float]
    """(3, 3) camera matrix, row by row [pixels]."""
    depth_scale: Annotated[float, Meta(gt=0)]
    """Millimetres per step of depth."""


def _bop_frames(path: Path, scenes: list[Path], beside: Beside) -> Frames:
    """Returns the frames of scenes, in the order of the image numbers; raises InvalidFile, InvalidInput.

    A user may add only a mask, as camera, depth scale and colour images are part of the scenes.
    """
    if beside.camera is not None or beside.color is not None or beside.depth_scale != MILLIMETRE:
        raise InvalidInput(f"{path}: expected no camera, colour and depth scale beside a BOP scene, got one")
    images = dict[Path, tuple[Path, int, ImageCamera]]()
    for scene in scenes:
        file, most_bytes = scene / CAMERAS, 100_000_000  # the size for a hundred thousand images
        cameras = decode(read_bytes(file, most_bytes), dict[str, ImageCamera], str(file))
        if wrong := next((key for key in cameras if not _is_number(key)), None):
            raise InvalidFile(f"{file}: expected numbers of images as keys, got {wrong!r:.80}")
        if not cameras:
            raise InvalidFile(f"{file}: expected a camera for each image, got none")
        for key in sorted(cameras, key=int):
            images[scene / "depth" / f"{int(key):06d}.png"] = scene, int(key), cameras[key]

    def read(file: Path) -> Frame:
        scene, image, entry = images[file]
        depth = read_depth(file, MILLIMETRE * entry.depth_scale)
        height, width = depth.shape
        try:
            camera = _camera(entry.cam_K, (width, height))
        except InvalidInput as error:
            message = str(error).removeprefix("matrix: ")
            raise InvalidFile(f"{scene / CAMERAS}: {image}.cam_K: {message}") from None
        color = color_beside(scene, file.stem, ("rgb", "gray"))
        return Frame(
            name=f"{scene.name}/{file.stem}",
            camera=camera,
            depth=depth,
            color=None if color is None else read_color(color, camera=camera),
            wanted=beside.wanted(file.stem, camera),
            number=(int(scene.name) if _is_number(scene.name) else 0, image),
        )

    # The data set's folder is two levels above a scene (data set, split, scene), and may have models.
    above = scenes[0].resolve().parents[1:2]
    library = next((folder for folder in above if (folder / "models" / INFO).is_file()), None)
    return Frames(len(images), read_each(list(images), read), library)


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdecimal() and len(key) < 10


@lru_cache(maxsize=8)
def _camera(K: tuple[float, ...], size: tuple[int, int]) -> Camera:
    """Returns the camera with this matrix and size; cached, as its rays are expensive."""
    return Camera(np.array(K).reshape(3, 3), size)
