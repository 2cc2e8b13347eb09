"""Folders of drawn depth images, as a user or the BOP benchmark lays them out."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

import handsight as hs
from handsight import se3
from handsight.objects import Shape, ply_bytes
from testbed.sight_scenes import CAMERA, drawn, letter, looking, noisy, on_table

Array = np.ndarray
Drawer = Callable[[], tuple[Array, Array]]
"""Makes vertices and faces."""

K = CAMERA.matrix
INTRINSICS = {
    "fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2],
    "width": CAMERA.size[0], "height": CAMERA.size[1],
}  # fmt: skip
"""As a camera's file has them."""


def picture(seed: int, *, empty: bool = False, shape: Drawer = letter) -> tuple[Array, Array]:
    """Depth (h, w) [m] of a letter, or another shape, on a table, or of the table alone, and T_camera_object (4, 4)."""
    rng = np.random.default_rng([seed, 11])
    T, Ts = looking(rng, 0.45), on_table(rng, [shape()])
    depth, _ = drawn(T, [] if empty else [shape()], Ts[:0] if empty else Ts)
    return noisy(depth, rng), T @ Ts[0]


def brick() -> tuple[Array, Array]:
    """Vertices and faces of another object that stands on a table."""
    model = hs.ObjectModel.box((0.09, 0.055, 0.035))
    return model.vertices - [0, 0, model.bounds_object[0, 2]], model.faces


def three_touching(seed: int) -> tuple[Array, list[tuple[str, Array]]]:
    """Depth (h, w) [m] of a letter and two equal bricks beside it that touch it, and (name in the data set,
    T_camera_object) of each."""
    rng, shapes = np.random.default_rng([seed, 12]), [letter(), brick(), brick()]
    T, Ts = looking(rng, 0.5), np.tile(np.eye(4), (3, 1, 1))
    Ts[1, :3, :3] = se3.rotation_exp(np.array([0, 0, np.pi / 2]))
    Ts[1:, :2, 3] = (0.075, 0.0), (-0.01, 0.06)
    depth, _ = drawn(T, shapes, Ts)
    names = "obj_000003", "obj_000007", "obj_000007"
    return noisy(depth, rng), list(zip(names, T @ Ts, strict=True))


def write_mesh(path: Path, scale: float = 1.0, shape: Drawer = letter) -> Path:
    """The letter's mesh, or another shape's; `scale`: units of the file in a metre."""
    path.parent.mkdir(parents=True, exist_ok=True)
    vertices, faces = shape()
    path.write_bytes(ply_bytes(Shape(vertices, faces), scale))
    return path


def write_depth(path: Path, depth: Array, step: float = 1e-3) -> Path:
    """A PNG of 16 bits; `step`: metres of a number."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(depth / step).astype(np.uint16)).save(path)
    return path


def write_color(path: Path, size: tuple[int, int] = CAMERA.size) -> Path:
    """A grey picture of that width and height."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((*size[::-1], 3), 90, np.uint8)).save(path)
    return path


def folder_of(folder: Path, depths: Sequence[Array]) -> Path:
    """depth/NAME.png with colour and the camera, the letter's mesh beside."""
    for k, depth in enumerate(depths):
        write_depth(folder / "frames/depth" / f"{k:04d}.png", depth)
        write_color(folder / "frames/rgb" / f"{k:04d}.png")
    (folder / "frames/camera.json").write_text(json.dumps(INTRINSICS))
    write_mesh(folder / "letter.ply")
    return folder / "frames"


def bop_of(
    folder: Path, depths: Sequence[Array], shapes: dict[int, Drawer] | None = None, step: float = 1e-4
) -> Path:
    """A BOP data set: its models, a letter of number 3 unless told, and a split with one scene."""
    infos = {}
    for number, shape in (shapes or {3: letter}).items():
        write_mesh(folder / f"models/obj_{number:06d}.ply", 1000.0, shape)
        vertices, _ = shape()
        diameter = 1e3 * float(np.linalg.norm(vertices[:, None] - vertices[None], axis=2).max())
        infos[str(number)] = {"diameter": diameter}
    (folder / "models/models_info.json").write_text(json.dumps(infos))
    scene = folder / "test/000048"
    for k, depth in enumerate(depths):
        write_depth(scene / "depth" / f"{k:06d}.png", depth, step)
    write_color(scene / "rgb/000000.png")
    cameras = {str(k): {"cam_K": K.ravel().tolist(), "depth_scale": 1e3 * step} for k in range(len(depths))}
    (scene / "scene_camera.json").write_text(json.dumps(cameras))
    return scene


def off_mm(T: Array, T_true: Array) -> float:
    """How far the letter's points are off at most [mm]."""
    points, _ = letter()
    off = np.linalg.norm(se3.apply(T, points) - se3.apply(T_true, points), axis=1)
    return 1e3 * float(off.max())


def bop_with_truths(folder: Path) -> tuple[Path, tuple[Array, Array]]:
    """A scene of a BOP data set with two images, and the true poses T_camera_object in them: a letter, a brick."""
    (first, T), (second, other) = picture(1), picture(2, shape=brick)
    bop_of(folder, [first, second], {3: letter, 7: brick})
    scene = folder / "test/000048"
    truths = {}
    for k, (number, at) in enumerate(((3, T), (7, other))):
        rotation = at[:3, :3].ravel().round(8).tolist()
        millimetres = (1e3 * at[:3, 3]).tolist()
        truths[str(k)] = [{"obj_id": number, "cam_R_m2c": rotation, "cam_t_m2c": millimetres}]
    (scene / "scene_gt.json").write_text(json.dumps(truths))
    return scene, (T, other)
