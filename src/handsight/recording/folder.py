"""What is what in a folder of images, as pose estimators and data sets lay it out.

FoundationPose has `depth/`, `rgb/`, `masks/`, `cam_K.txt`, `mesh/` and `ob_in_cam/`; SAM-6D `depth.png`, `rgb.png`,
`camera.json` and a mesh; MegaPose `image_depth.png`, `image_rgb.png`, `camera_data.json` and `meshes/`; TUM's RGB-D
recordings `depth/`, `rgb/` and lists of stamps; handsight's own folders `depth/`, `rgb/` and `camera.json`, or images
with `depth` in their names.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from handsight.errors import InvalidFile
from handsight.objects.files.read import READERS

DEPTH_ENDINGS = (".png", ".tif", ".tiff", ".npy", ".exr")
COLOR_ENDINGS = (".png", ".jpg", ".jpeg")
COLOR_FOLDERS = ("rgb", "color", "colour", "image", "images")
MASK_FOLDERS = ("masks", "mask")
POSE_PLACES = (
    "ob_in_cam",
    "detection_pem.json",
    "outputs/object_data.json",
    "sam6d_results/detection_pem.json",
)
"""Where estimators write poses of the object, not of the camera."""
MESH_FOLDERS = ("mesh", "meshes", "model", "models")
CAMERA = re.compile(r"camera|cam_|intrinsic|^K\.")
"""How names of a camera's file look; `handsight.vision.camera_file` reads it."""
TUM_SCALE = 1 / 5000
"""Metres of a step of depth in TUM's recordings."""
TUM_GAP = 0.03
"""Longest time between a depth image and its colour image there [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFolder:
    """The files of a folder of images, by what they are."""

    depth: tuple[Path, ...]
    color: Mapping[str, Path] = field(default_factory=dict)
    """By the name of the depth image, without its ending; so are masks."""
    masks: Mapping[str, Path] = field(default_factory=dict)
    camera: Path | None = None
    poses: Path | None = None
    """Poses of the object by an estimator, as `read_poses` takes them."""
    meshes: tuple[Path, ...] = ()
    depth_scale: float | None = None
    """Metres of a step of depth, where the layout says it; None: it does not."""

    def sentence(self, folder: Path) -> str:
        """Returns what was taken for what, in words."""

        def places(paths: Iterable[Path]) -> str:
            return ", ".join(dict.fromkeys(_place(path, folder) for path in paths))

        parts = [f"{places(self.depth)} for depth ({len(self.depth)} images)"]
        if self.depth_scale is not None:
            parts[0] += f" in steps of {1e3 * self.depth_scale:g} mm"
        for what, of in (("colour", self.color), ("masks", self.masks)):
            if of:
                parts.append(f"{places(of.values())} for {what} of {len(of)}")
        for what, path in (("the camera", self.camera), ("poses of the object", self.poses)):
            if path is not None:
                parts.append(f"{path.relative_to(folder)} for {what}")
        if self.meshes:
            parts.append(f"{places(self.meshes)} for the object's mesh")
        return f"{folder}: took {'; '.join(parts)}"


def read_folder(folder: Path) -> ImageFolder:
    """Returns what is what in a folder; raises InvalidFile where it has no depth images."""
    depth = _images(folder, ("depth",), "depth", DEPTH_ENDINGS)
    if not depth:
        expected = f"expected depth images, depth/* or *depth* ({', '.join(DEPTH_ENDINGS)})"
        raise InvalidFile(f"{folder}: {expected}, got none")
    color = _images(folder, COLOR_FOLDERS, "rgb|color|colour", COLOR_ENDINGS)
    is_tum = (folder / "depth.txt").is_file() and (folder / "rgb.txt").is_file()
    return ImageFolder(
        depth=depth,
        color=_by_stamp(depth, color) if is_tum else _by_name(depth, color),
        masks=_by_name(depth, _images(folder, MASK_FOLDERS, "mask", COLOR_ENDINGS)),
        camera=camera_file(folder),
        poses=next((place for name in POSE_PLACES if (place := folder / name).exists()), None),
        meshes=tuple(_meshes(folder)),
        depth_scale=TUM_SCALE if is_tum else None,
    )


def _place(path: Path, folder: Path) -> str:
    inside = path.relative_to(folder)
    return f"{inside.parts[0]}/" if len(inside.parts) > 1 else inside.name


def _images(folder: Path, folders: tuple[str, ...], word: str, endings: tuple[str, ...]) -> tuple[Path, ...]:
    """Returns the images in the first of some folders that there is, else those in the folder itself whose names have
    a word in them; in the order of their names."""
    inside = next((folder / name for name in folders if (folder / name).is_dir()), None)
    files = sorted(file for file in (inside or folder).iterdir() if file.suffix.lower() in endings)
    if inside is None:
        files = [file for file in files if re.search(word, file.stem)]
    return tuple(files)


def _by_name(depth: tuple[Path, ...], others: tuple[Path, ...]) -> dict[str, Path]:
    """Returns the image of each depth image: that of the same name, of the same number at its end, or the only one
    beside a single depth image."""
    if len(depth) == len(others) == 1:
        return {depth[0].stem: others[0]}
    names = {other.stem: other for other in others}
    numbers = {number: other for other in others if (number := image_number(other.stem))}
    pairs = ((image.stem, names.get(image.stem) or numbers.get(image_number(image.stem))) for image in depth)
    return {name: other for name, other in pairs if other is not None}


def image_number(name: str) -> str:
    """Returns the digits at the end of an image's name, without leading zeros; empty where it ends in none."""
    digits = re.search(r"\d+$", name)
    return str(int(digits[0])) if digits else ""


def _by_stamp(depth: tuple[Path, ...], others: tuple[Path, ...]) -> dict[str, Path]:
    """Returns the image nearest in time of each depth image, where names are stamps [s]."""
    try:
        stamps = {float(other.stem): other for other in others}
        pairs = [
            (image.stem, min(stamps, key=lambda stamp: abs(stamp - float(image.stem)))) for image in depth
        ]
    except ValueError:
        return _by_name(depth, others)
    return {name: stamps[stamp] for name, stamp in pairs if abs(stamp - float(name)) <= TUM_GAP}


def camera_file(folder: Path) -> Path | None:
    """Returns the file of the depth images' camera, None where there is none: `camera.json`, else the one with such a
    name, preferably with `depth` in it."""
    if (folder / "camera.json").is_file():
        return folder / "camera.json"
    inside = [folder, *(folder / name for name in ("intrinsic", "intrinsics") if (folder / name).is_dir())]
    files = [file for place in inside for file in sorted(place.iterdir())]
    named = [
        file
        for file in files
        if CAMERA.search(file.name) and file.suffix in (".json", ".txt", ".yaml", ".yml")
    ]
    return next((file for file in named if "depth" in file.name), named[0] if named else None)


def _meshes(folder: Path) -> Iterator[Path]:
    """Yields the mesh files in the folder, else those in a folder of meshes."""
    for place in (folder, *(folder / name for name in MESH_FOLDERS)):
        files = sorted(place.rglob("*")) if place != folder and place.is_dir() else sorted(folder.iterdir())
        found = [file for file in files if file.suffix.lower() in READERS and file.is_file()]
        if found:
            yield from found
            return
