"""Images in which to find an object, and opening them: an image, a folder of them, a BOP scene, or a robot's recording.

A folder is as handsight, FoundationPose, SAM-6D, MegaPose or TUM lay it out (`recording/folder.py`). A BOP scene, or a
split with scenes in it, is as in https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

import glob
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.objects.library.documents import INFO
from handsight.observation import Detection2D
from handsight.recording.folder import ImageFolder, camera_file, image_number, read_folder
from handsight.recording.open import open_recording
from handsight.rig import Rig
from handsight.vision import read_color
from handsight.vision.camera_file import CameraFile, Size, read_camera_file
from handsight.vision.object.locate import search_mask
from handsight.vision.pixels import MILLIMETRE, Color, measured_depth

CAMERAS = "scene_camera.json"
Box = tuple[float, float, float, float]
"""First column and row, last column and row, both included [pixels]."""


class ImageName(NamedTuple):
    """How other programs' files may call an image."""

    scene: int | None
    """BOP's number of its scene; None: it is of none."""
    stem: str
    """The file's name without its ending; its digits at the end are the image's number."""

    @property
    def text(self) -> str:
        """The name for messages."""
        number = image_number(self.stem) or self.stem or "without a name"
        return number if self.scene is None else f"{self.scene}/{number}"


NO_NAME = ImageName(None, "")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame:
    """One image of a depth camera."""

    name: str
    """The name of the image in messages and answers."""
    camera: Camera
    depth: Depth
    """(h, w) depth along the optical axis [m], NaN where unknown."""
    image: ImageName = NO_NAME
    """How other programs' files may call it."""
    notes: tuple[str, ...] = ()
    """What was taken for what, and what was not used, in sentences."""
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
    unit_else: float | None = None
    """By how much depths are larger in millimetres a step than in the unit that the camera's file states."""

    def in_millimetres(self) -> "Frame":
        """Returns the frame with whole numbers as millimetres, whatever the camera's file states, and says so."""
        note = "the unit in the camera's file does not fit what is seen: in millimetres the object is found"
        return replace(
            self,
            depth=np.float32(self.unit_else or 1.0) * self.depth,
            notes=(*self.notes, note),
            unit_else=None,
        )


class Unread(NamedTuple):
    """An image that cannot be read."""

    name: str
    reason: str
    """The file, what was expected, and what came."""


class Frames(NamedTuple):
    """Images that are read one by one, as the iterator advances."""

    total: int | None
    """Number of images; None: it is known only at the end."""
    each: Iterator[Frame | Unread]
    library: Path | None = None
    """Folder of the library of their objects; None: the data set has none."""
    images: tuple[ImageName, ...] = ()
    """All images, where they are known beforehand."""
    folder: ImageFolder | None = None
    """What was taken for what in a folder of images; None: it is no such folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """What a user declares about depth images: the files that belong to them, and their unit."""

    camera: Path | None = None
    """The file of the camera; None: the one beside the images."""
    resized: bool = False
    """Whether the images have another size than their camera, which is then scaled."""
    depth_scale: float | None = None
    """Metres per step of depth; None: whole numbers are millimetres, floats are metres."""
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
        place = self.mask if self.mask.exists() else folder / self.mask
        one = place / f"{stem}.png" if place.is_dir() else place
        several = sorted(place.glob(f"{glob.escape(stem)}_[0-9]*.png"))
        if one.exists() or not several:
            return replace(frame, wanted=_mask(one, frame.camera))
        truth = place.parent / "scene_gt.json"
        objects = _objects(truth).get(str(int(stem)), []) if stem.isdecimal() and truth.is_file() else []
        numbers = dict(enumerate(objects))
        found = list[Detection2D]()
        for path in several:
            pixels = _pixels(path, frame.camera)
            index = path.stem.rpartition("_")[2]
            if pixels.any():  # else it is hidden
                label = numbers.get(int(index), "") if index.isdecimal() else ""
                found.append(Detection2D(label, mask=pixels))
        return replace(frame, detections=tuple(found))


def _pixels(path: Path, camera: Camera) -> Mask:
    """Returns the pixels (h, w) of an image that are not 0; raises InvalidFile, MissingExtra."""
    return np.asarray(read_color(path, camera=camera).any(axis=2))


def read_each(files: list[Path], read: Callable[[Path], Frame]) -> Iterator[Frame | Unread]:
    """Yields the frame of each file, or an `Unread` with the reason where `read` raises a HandsightError."""
    for file in files:
        try:
            yield read(file)
        except HandsightError as error:
            yield Unread(str(file), str(error))


def color_beside(camera: Camera, folder: Path, stem: str, folders: tuple[str, ...]) -> Color | None:
    """Returns the colour image of that name in one of the folders; None where there is none. Raises InvalidFile."""
    places = (folder / name / f"{stem}{end}" for name in folders for end in (".png", ".jpg", ".jpeg"))
    place = next((place for place in places if place.exists()), None)
    return None if place is None else read_color(place, camera=camera)


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
    is_folder = path.is_dir()
    folder = path if is_folder else path.parent
    found = read_folder(path) if is_folder else ImageFolder(depth=(path,), camera=_camera_beside(path))
    intrinsics = beside.camera or found.camera or folder / "camera.json"
    cameras = _Cameras(intrinsics, resized=beside.resized)
    above = not is_folder and beside.camera is None and intrinsics.parent != folder

    def read(file: Path) -> Frame:
        step, stated = cameras.step(file.stem)
        if step is None:
            step = found.depth_scale or MILLIMETRE
        depth, note, of_step = _depth(file, beside.depth_scale, step, stated)
        camera = cameras.camera(depth.shape[::-1], file.stem)
        color = found.color.get(file.stem)
        shown = None if color is None else read_color(color, camera=camera)
        took = f"took {intrinsics} for the camera" if above else ""
        notes = tuple(each for each in (took, of_step, note) if each)
        name = ImageName(None, file.stem)
        doubted = of_step == stated != "" and step != MILLIMETRE
        frame = Frame(
            name=file.name,
            image=name,
            camera=camera,
            depth=depth,
            notes=notes,
            color=shown,
            unit_else=MILLIMETRE / step if doubted else None,
        )
        if beside.mask is None and file.stem in found.masks:
            return replace(frame, wanted=_mask(found.masks[file.stem], camera))
        return beside.masked(frame, folder, file.stem)

    images = tuple(ImageName(None, file.stem) for file in found.depth)
    if not is_folder:
        return Frames(1, iter([read(path)]), images=images)
    return Frames(len(images), read_each(list(found.depth), read), images=images, folder=found)


class _Cameras:
    """The cameras of images by a file, read when the first one is asked for; images of one camera share its rays, which
    are expensive."""

    def __init__(self, path: Path, *, resized: bool = False) -> None:
        self.path = path
        self.resized = resized
        self._known = dict[tuple[Size, str], Camera]()

    @cached_property
    def file(self) -> CameraFile:
        """All cameras of the file; raises InvalidFile."""
        return read_camera_file(self.path)

    def step(self, stem: str) -> tuple[float | None, str]:
        """Returns the metres of a step of depth of an image, and a sentence on how the file states them."""
        return self.file.step(stem)

    def camera(self, size: Size, stem: str) -> Camera:
        """Returns the camera of an image; raises InvalidFile."""
        key = size, image_number(stem)
        if key not in self._known:
            camera = self.file.camera(size, stem, resized=self.resized)
            same = (known for known in self._known.values() if known.equals(camera))
            self._known[key] = next(same, camera)
        return self._known[key]


def _depth(file: Path, scale: float | None, step: float, stated: str) -> tuple[Depth, str, str]:
    """Returns the depth in a file, what was taken for no measurement, and how its unit was taken from the camera's
    file, which `stated` says; `scale` is the unit that a user gives. Raises InvalidFile."""
    try:
        depth, note, whole = measured_depth(file, scale, step=step)
    except InvalidFile as error:
        raise InvalidFile(f"{error}; {stated}" if stated and scale is None else str(error)) from None
    if not stated or not whole or scale == step:
        return depth, note, ""
    return depth, note, stated if scale is None else f"--depth-scale {scale:g} is used, not {stated}"


def _camera_beside(image: Path) -> Path | None:
    """Returns the file of the camera beside an image, or beside the folder that it is in, as in `read_folder`."""
    return camera_file(image.parent) or camera_file(image.parent.parent)


def _mask(path: Path, camera: Camera) -> Mask:
    """Returns the pixels that are not 0 in an image; raises InvalidFile where there are none."""
    pixels = _pixels(path, camera)
    if not pixels.any():
        raise InvalidFile(f"{path}: expected a mask with pixels that are not 0, got none")
    return pixels


def _bop_frames(path: Path, scenes: list[Path], beside: Beside) -> Frames:
    """Returns the frames of scenes, in the order of the image numbers; raises InvalidFile, InvalidInput.

    A user may add only a mask, as camera, depth scale and colour images are part of the scenes.
    """
    if beside.camera is not None or beside.depth_scale is not None or beside.resized:
        raise InvalidInput(f"{path}: expected no camera and depth scale beside a BOP scene, got one")
    images = dict[Path, tuple[Path, _Cameras]]()
    for scene in scenes:
        cameras = _Cameras(scene / CAMERAS)
        wrong = [key for key in cameras.file.found if not _is_number(key)]
        if wrong:
            expected = "expected cameras by the numbers of images"
            raise InvalidFile(f"{cameras.path}: {expected}, got {wrong[0]!r:.80}")
        for key in sorted(cameras.file.found, key=int):
            images[scene / "depth" / f"{int(key):06d}.png"] = scene, cameras

    def read(file: Path) -> Frame:
        scene, cameras = images[file]
        image = int(file.stem)
        step, _ = cameras.step(file.stem)
        if step is None:
            raise InvalidFile(
                f"{cameras.path}: {image}.depth_scale: expected millimetres a step, got nothing"
            )
        depth, note, _ = measured_depth(file, step=step)
        camera = cameras.camera(depth.shape[::-1], file.stem)
        color = color_beside(camera, scene, file.stem, ("rgb", "gray"))
        number = int(scene.name) if _is_number(scene.name) else 0, image
        name = f"{scene.name}/{file.stem}"
        notes = (note,) if note else ()
        image_name = ImageName(number[0], file.stem)
        frame = Frame(
            name=name, image=image_name, camera=camera, depth=depth, notes=notes, color=color, number=number
        )
        return beside.masked(frame, scene, file.stem)

    # The data set's folder is two levels above a scene (data set, split, scene), and may have models.
    above = scenes[0].resolve().parents[1:2]
    library = next((folder for folder in above if (folder / "models" / INFO).is_file()), None)
    scene_of = {scene: int(scene.name) if _is_number(scene.name) else 0 for scene in scenes}
    names = tuple(ImageName(scene_of[scene], file.stem) for file, (scene, _) in images.items())
    return Frames(len(images), read_each(list(images), read), library, names)


class InstanceForm(msgspec.Struct):
    """An entry of `scene_gt.json`, of which only the object's number is used."""

    obj_id: int


@lru_cache(maxsize=8)
def _objects(path: Path) -> dict[str, list[str]]:
    """Returns the numbers of the objects in each image of a `scene_gt.json`, as text; raises InvalidFile."""
    document = decode(read_bytes(path, 1 << 28), dict[str, list[InstanceForm]], str(path))
    return {key: [str(each.obj_id) for each in instances] for key, instances in document.items()}


def _is_number(key: str) -> bool:
    return key.isascii() and key.isdecimal() and len(key) < 10


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

        pixels = HandPixels(rig)
        camera = None
        hints = {name: SearchHints(spec.label or name) for name, spec in rig.objects.items()}
        with open_recording(path, rig) as recording:
            for observation in recording.observations():
                depth = observation.depth
                color = observation.color
                hints = {name: hint.after(observation) for name, hint in hints.items()}
                if depth is None:
                    continue
                camera = camera or recording.camera()
                camera.check_size(depth, f"{path}: depth")
                found = [replace(each, label=name) for name in hints for each in hints[name].detections]
                yield Frame(
                    name=f"{observation.stamp:.3f} s",
                    image=NO_NAME,
                    camera=camera,
                    depth=depth,
                    color=color if color is not None and color.shape[:2] == depth.shape else None,
                    detections=tuple(found) or None,
                    hand=pixels.mask(camera, np.nan_to_num(depth), observation),
                )
        if camera is None:
            raise InvalidFile(f"{path}: expected depth images on {rig.topics.depth}, got none")

    return Frames(None, each())
