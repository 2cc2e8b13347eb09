"""Real depth images with the true poses of the objects in them, and how poses and covariances are judged on them.

Two layouts are read, and any folder of either can be given: scenes of frames with `depth.png`, `label.png` and
`frame.json` (fx, fy, cx, cy, depth_scale [m], labels and T_camera_object by the object's name), whose meshes are in
`meshes/` or in `ycb_meshes` beside it; and BOP's scenes (`scene_camera.json`, `scene_gt.json`, `depth/`,
`mask_visib/`), whose objects are the data set's library. An object has the symmetries that its library declares; one
without a library those that its surface shows.
"""

import functools
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.objects import Library, ObjectWarning, nearest, propose_symmetries, tangents
from handsight.vision import read_color, read_depth
from testbed import bop, ycb
from testbed.report import Array
from testbed.sight import LOOKS_ALIKE

TOLD = ("whole image", "box", "mask")
"""Where an object is looked for: anywhere, in the box around its visible pixels, or in these."""
BOX_WIDER, MASK_WIDER = 8, 4
"""Pixels by which box and mask are wider than the object."""
LEAST_VISIBLE = 0.1
"""Of an object's silhouette, for it to be looked for, as in BOP."""


@dataclass(frozen=True, eq=False)
class Instance:
    """An object in an image, where it truly is."""

    name: str
    T_camera_object: Array
    """(4, 4)"""
    visible: Array
    """(h, w) its pixels."""
    share: float
    """Of its silhouette that is visible."""


@dataclass(frozen=True, eq=False)
class RealFrame:
    """A depth image, and all known objects in it."""

    scene: str
    name: str
    camera: Camera
    depth: Array
    """(h, w) [m], NaN where unknown."""
    instances: tuple[Instance, ...]

    def wanted(self, instance: Instance, told: str) -> Array | None:
        """Returns the pixels (h, w) in which an object is looked for; None: all."""
        if told == "mask":
            return np.asarray(binary_dilation(instance.visible, iterations=MASK_WIDER))
        if told == "box":
            rows, columns = np.nonzero(instance.visible)
            inside = np.zeros(self.depth.shape, dtype=bool)
            top, left = max(rows.min() - BOX_WIDER, 0), max(columns.min() - BOX_WIDER, 0)
            inside[top : rows.max() + BOX_WIDER + 1, left : columns.max() + BOX_WIDER + 1] = True
            return inside
        return None


@dataclass(frozen=True, eq=False)
class RealFrames:
    """`RealFrames` are the scenes of a folder, whose frames are read one by one."""

    models: dict[str, hs.ObjectModel]
    """All objects that may be there, by name."""
    scenes: dict[str, list[Callable[[], RealFrame]]]
    """Of each scene what reads its frames, in order."""

    def some(self, most: int) -> list[Callable[[], RealFrame]]:
        """Returns at most so many frames of each scene, evenly spread."""
        chosen = []
        for frames in self.scenes.values():
            step = max(1, -(-len(frames) // most))
            chosen += frames[::step]
        return chosen


def default_folder() -> Path:
    """Returns the folder of real frames; without it prints why, and ends the program with exit code 0."""
    folder = ycb.data_folder()
    if folder is None or not (folder / "ycbv_frames").is_dir():
        print("skipped: the real frames are not here: set HANDSIGHT_DATA to the folder of ycbv_frames.")
        sys.exit(0)
    return folder / "ycbv_frames"


def open_folder(folder: Path, objects: Path | None = None) -> RealFrames:
    """Returns the frames of a folder in one of the two layouts; a scene's own folder will do.

    objects: folder of their meshes, or library; None: as the layout has it. Raises ValueError where it has neither.
    """
    scenes = [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]
    if inside := [scene for scene in scenes if (scene / "scene_gt.json").is_file()]:
        library = Library(objects or inside[0].resolve().parents[1])
        models = library_models(library)
        numbers = {entry.number: entry.name for entry in library.entries()}
        return RealFrames(models, {scene.name: bop_scene(scene, models, numbers) for scene in inside})
    inside = [scene for scene in scenes if any(scene.glob("*/frame.json"))]
    if not inside:
        raise ValueError(f"{folder}: expected scenes with scene_gt.json or frames with frame.json, got none")
    above = inside[0].resolve().parent
    models = mesh_models([objects] if objects else [above / "meshes", above.parent / "ycb_meshes"])
    return RealFrames(models, {scene.name: frame_scene(scene, models) for scene in inside})


def mesh_models(folders: Sequence[Path]) -> dict[str, hs.ObjectModel]:
    """Returns the objects of folders of meshes [m] by their files' names, with the symmetries of their surfaces."""
    found = {}
    for path in sorted(
        (path for folder in folders for path in folder.glob("*.ply")), key=lambda path: path.stem
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ObjectWarning)  # the marker's mesh has triangles without area
            model = hs.ObjectModel.from_file(path)
        found[path.stem] = model.with_symmetries(propose_symmetries(model, LOOKS_ALIKE * model.diameter))
    return found


def library_models(library: Library) -> dict[str, hs.ObjectModel]:
    """Returns the objects of a library by name, with the symmetries that it declares."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ObjectWarning)
        return {entry.name: library.model(entry.name) for entry in library.entries()}


def frame_scene(scene: Path, models: dict[str, hs.ObjectModel]) -> list[Callable[[], RealFrame]]:
    """Returns what reads the frames of a scene of folders with `frame.json`."""

    def read(folder: Path) -> RealFrame:
        entry = json.loads((folder / "frame.json").read_text(encoding="utf-8"))
        depth = read_depth(folder / "depth.png", entry["depth_scale"])
        K = np.array([[entry["fx"], 0, entry["cx"]], [0, entry["fy"], entry["cy"]], [0, 0, 1]])
        camera = Camera(K, depth.shape[::-1])
        labels = read_color(folder / "label.png", camera=camera)[..., 0]
        truths = [(name, np.array(T)) for name, T in entry["T_camera_object"].items()]
        masks = [labels == entry["labels"][name] for name, _ in truths]
        return RealFrame(scene.name, folder.name, camera, depth, instances(camera, models, truths, masks))

    return [functools.partial(read, path.parent) for path in sorted(scene.glob("*/frame.json"))]


def bop_scene(
    scene: Path, models: dict[str, hs.ObjectModel], numbers: dict[int, str]
) -> list[Callable[[], RealFrame]]:
    """Returns what reads the images of a BOP scene; the visible pixels are drawn where it has no `mask_visib`."""
    cameras, truths = (
        json.loads((scene / name).read_text(encoding="utf-8"))
        for name in ("scene_camera.json", "scene_gt.json")
    )

    def read(image: str) -> RealFrame:
        depth = read_depth(scene / f"depth/{int(image):06d}.png", 1e-3 * cameras[image]["depth_scale"])
        camera = Camera(np.array(cameras[image]["cam_K"]).reshape(3, 3), depth.shape[::-1])
        known, masks = list[tuple[str, Array]](), list[Array | None]()
        for k, entry in enumerate(truths[image]):
            U, _, Vt = np.linalg.svd(np.array(entry["cam_R_m2c"]).reshape(3, 3))  # the numbers are rounded
            T = se3.compose(U @ Vt, 1e-3 * np.array(entry["cam_t_m2c"]))
            known.append((numbers[entry["obj_id"]], T))
            file = scene / f"mask_visib/{int(image):06d}_{k:06d}.png"
            masks.append(np.asarray(read_color(file, camera=camera).any(axis=2)) if file.is_file() else None)
        given = [mask for mask in masks if mask is not None]
        visible = given if len(given) == len(known) else drawn_masks(camera, models, known, depth)
        return RealFrame(scene.name, image, camera, depth, instances(camera, models, known, visible))

    return [functools.partial(read, image) for image in sorted(truths, key=int)]


def drawn_masks(
    camera: Camera, models: dict[str, hs.ObjectModel], truths: Sequence[tuple[str, Array]], depth: Array
) -> list[Array]:
    """Returns the pixels (h, w) of each object that no other one, and nothing measured, is in front of."""
    drawn = np.stack([bop.drawn(models[name], camera, T) for name, T in truths])
    far = np.where(drawn > 0, drawn, np.inf)
    clear = (drawn > 0) & ~(depth + bop.BEHIND < drawn)
    return list(clear & (far == far.min(axis=0)))


def instances(
    camera: Camera,
    models: dict[str, hs.ObjectModel],
    truths: Sequence[tuple[str, Array]],
    masks: Sequence[Array],
) -> tuple[Instance, ...]:
    """Returns the objects of which enough is visible."""
    found = []
    for (name, T), mask in zip(truths, masks, strict=True):
        share = float(mask.sum() / max((bop.drawn(models[name], camera, T) > 0).sum(), 1))
        if share >= LEAST_VISIBLE:
            found.append(Instance(name, T, mask, min(share, 1.0)))
    return tuple(found)


# How poses are judged


@functools.lru_cache(maxsize=128)
def surface(model: hs.ObjectModel) -> Array:
    """Returns the samples (1000, 3) of the surface by which ADD-S is measured."""
    return np.asarray(model.sample(1000, 1)[0])


def add_s(model: hs.ObjectModel, T_true: Array, T: Array) -> float:
    """Returns the mean distance of the surface at T from the true one [diameters]."""
    at = se3.apply(se3.inverse(T_true) @ T, surface(model))
    return float(np.abs(model.evaluate(at).distance).mean() / model.diameter)


def squared_error(
    model: hs.ObjectModel, T_true: Array, T: Array, covariance: Array, sigma_truth: float = 0.0
) -> tuple[float, int]:
    """Returns the squared error of a pose by its covariance (6, 6), and its degrees of freedom.

    It is modulo the symmetries: turns about continuous axes do not count. sigma_truth: standard deviation of the true
    pose's own position at the object's centre along each axis, and of its rotation times the radius [m].
    """
    off = se3.difference(nearest(model.symmetries, T_true, T, model.radius), T)
    J = np.eye(6)  # from the centre to the object's origin
    J[:3, 3:] = se3.skew(T[:3, :3] @ model.center_object)
    own = np.diag(np.repeat([1.0, model.radius**-2], 3)) * sigma_truth**2
    P = np.linalg.inv(covariance + J @ own @ J.T)
    free = tangents(model.symmetries, T)
    if len(free):
        W = free @ P
        P = P - W.T @ np.linalg.solve(W @ free.T, W)
    return float(off @ P @ off), 6 - len(free)
