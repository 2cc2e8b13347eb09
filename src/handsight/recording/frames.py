"""Images in which to find an object, and opening them: an image, a folder of them, a BOP scene, or a robot's recording.

A folder has `camera.json` and depth images of 16 bits. They are either in `depth/`, with optional colour images under
the same names in `rgb/` or `color/`; or in the folder itself, with `depth` in their names. A BOP scene, or a split with
scenes in it, is as in https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

import glob
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.objects.library.documents import INFO
from handsight.observation import Detection2D
from handsight.recording.open import open_recording
from handsight.rig import Rig
from handsight.vision import read_camera, read_color, read_depth
from handsight.vision.object.locate import search_mask
from handsight.vision.pixels import MILLIMETRE, Color

CAMERAS = "scene_camera.json"
Box = tuple[float, float, float, float]
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
    detections: tuple[Detection2D, ...] | None = None
    """Where another detector has objects; None: none was asked."""
    starts: Mapping[str, Array] | None = None
    """Poses (k, 4, 4) in the camera from another estimator, by the object's name; None: none was asked."""
    targets: Mapping[str, int] | None = None
    """How often each object to find is in the image, by name; None: unknown."""


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
    """An image that is not 0 where the object may be, for all depth images; or a folder with one for each by
    name, or with one for each instance by BOP's names."""

    def masked(self, frame: Frame, folder: Path, stem: str) -> Frame:
        """Returns the frame of the image of that name, searched only where the mask is, or the instances are.

        folder: of the images, in which the folder of masks may be. With BOP's names (`mask_visib/000000_000001.png`) it
        has the pixels of each instance, whose object `scene_gt.json` beside it names. Raises InvalidFile, MissingExtra.
        """
        if self.mask is None:
            return frame
        place = folder / self.mask if not self.mask.exists() else self.mask
        one = place / f"{stem}.png" if place.is_dir() else place
        several = sorted(place.glob(f"{glob.escape(stem)}_[0-9]*.png")) if not one.exists() else []
        if not several:
            return replace(frame, wanted=np.asarray(read_color(one, camera=frame.camera).any(axis=2)))
        found, truth = list[Detection2D](), place.parent / "scene_gt.json"
        objects = _objects(truth).get(str(int(stem)), []) if stem.isdecimal() and truth.is_file() else []
        for path in several:
            pixels = np.asarray(read_color(path, camera=frame.camera).any(axis=2))
            index = path.stem.rpartition("_")[2]
            number = objects[int(index)] if index.isdecimal() and int(index) < len(objects) else ""
            if pixels.any():  # else it is hidden
                found.append(Detection2D(number, mask=pixels))
        return replace(frame, detections=tuple(found))


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
    """Returns the frame, searched only inside a box; raises InvalidInput for a box outside it."""
    try:
        inside = search_mask(frame.camera, box, frame.wanted)
    except InvalidInput as error:
        raise InvalidInput(f"{error} ({frame.name})") from None
    return replace(frame, wanted=inside)


def is_recording(path: Path) -> bool:
    """Returns whether a path is a robot's recording, which needs a rig."""
    return path.suffix.lower() in (".mcap", ".bag", ".db3") or (path / "metadata.yaml").exists()


def open_frames(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a depth image, a folder of them, or a BOP scene or split.

    Raises InvalidFile for any other path, and the errors of the readers.
    """
    try:
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
        depth = read_depth(file, beside.depth_scale, camera=camera)
        shown = None if color is None else read_color(color, camera=camera)
        frame = Frame(name=file.name, camera=camera, depth=depth, color=shown)
        return beside.masked(frame, folder, file.stem)

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
        shown = None if color is None else read_color(color, camera=camera)
        number = int(scene.name) if _is_number(scene.name) else 0, image
        name = f"{scene.name}/{file.stem}"
        frame = Frame(name=name, camera=camera, depth=depth, color=shown, number=number)
        return beside.masked(frame, scene, file.stem)

    # The data set's folder is two levels above a scene (data set, split, scene), and may have models.
    above = scenes[0].resolve().parents[1:2]
    library = next((folder for folder in above if (folder / "models" / INFO).is_file()), None)
    return Frames(len(images), read_each(list(images), read), library)


class InstanceForm(msgspec.Struct):
    """An `InstanceForm` is an entry of `scene_gt.json`, of which only the object's number is used."""

    obj_id: int


@lru_cache(maxsize=8)
def _objects(path: Path) -> dict[str, list[str]]:
    """Returns the numbers of the objects in each image of a `scene_gt.json`, as text; raises InvalidFile."""
    document = decode(read_bytes(path, 1 << 28), dict[str, list[InstanceForm]], str(path))
    return {key: [str(each.obj_id) for each in instances] for key, instances in document.items()}


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdecimal() and len(key) < 10


@lru_cache(maxsize=8)
def _camera(K: tuple[float, ...], size: tuple[int, int]) -> Camera:
    """Returns the camera with this matrix and size; cached, as its rays are expensive."""
    return Camera(np.array(K).reshape(3, 3), size)


def recorded_frames(path: Path, rig: Rig) -> Frames:
    """Returns the frames of a recording in order of stamp, with the recorded detections of the last second.

    The hand's pixels are those of its links, at the palm's pose that is detected (`detect_palm`), else at the pose by
    the calibration of the rig's camera. They are unknown without joint positions, and for a camera that is fixed in the
    world while the palm's pose in the world is unknown. Raises InvalidFile where the recording has no depth images, and
    InvalidInput where neither it nor the rig has their camera.
    """
    if rig.topics.depth is None:
        raise InvalidInput("rig: expected topics.depth, where the recording has its depth images, got none")

    def each() -> Iterator[Frame]:
        # They load the tracker, which images alone do not need.
        from handsight.recording.robot_images import HandPixels
        from handsight.tracking.hints import SearchHints

        pixels, camera = HandPixels(rig), None
        hints = {name: SearchHints(spec.label or name) for name, spec in rig.objects.items()}
        with open_recording(path, rig) as recording:
            for observation in recording.observations():
                depth, color = observation.depth, observation.color
                hints = {name: hint.after(observation) for name, hint in hints.items()}
                if depth is None:
                    continue
                camera = camera or recording.camera()
                if depth.shape != camera.size[::-1]:
                    (width, height), (h, w) = camera.size, depth.shape
                    message = f"expected depth of {width} x {height} pixels as its camera's, got {w} x {h}"
                    raise InvalidFile(f"{path}: {message}")
                found = [replace(each, label=name) for name in hints for each in hints[name].detections]
                yield Frame(
                    name=f"{observation.stamp:.3f} s",
                    camera=camera,
                    depth=depth,
                    color=color if color is not None and color.shape[:2] == depth.shape else None,
                    detections=tuple(found) or None,
                    hand=pixels.mask(camera, np.nan_to_num(depth), observation),
                )
        if camera is None:
            raise InvalidFile(f"{path}: expected depth images on {rig.topics.depth}, got none")

    return Frames(None, each())
