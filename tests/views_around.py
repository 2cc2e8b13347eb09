"""Depth images of an object from all around, drawn, by one camera with errors of its own as `simulation.camera` has them."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.simulation import add_depth_noise
from handsight.vision import STRUCTURED_LIGHT
from sight_scenes import CAMERA, drawn

Array = np.ndarray
Rng = np.random.Generator
Shape = tuple[Array, Array]
"""Vertices and faces."""

CENTER = np.array([0, 0, 0.05])


def path(n: int, rng: Rng, *, turns: float = 1.0, distance: float = 0.45) -> Array:
    """T_camera_table (n, 4, 4) of a camera that goes around the table's middle, up and down."""
    begin, Ts = rng.uniform(0, 2 * np.pi), []
    for share in np.arange(n) / n:
        around, height = begin + 2 * np.pi * turns * share, np.deg2rad(40 + 20 * np.sin(4 * np.pi * share))
        away = distance * (1 + 0.12 * np.sin(6 * np.pi * share))
        flat = np.cos(height) * np.array([np.cos(around), np.sin(around), 0])
        eye = CENTER + away * (flat + np.sin(height) * np.array([0, 0, 1]))
        z = (CENTER - eye) / away
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        Ts.append(se3.inverse(se3.compose(np.column_stack([x, np.cross(z, x), z]), eye)))
    return np.stack(Ts)


def pictures(Ts_camera_table: Array, shape: Shape, rng: Rng, *, camera: Any = CAMERA) -> list[Array]:
    """Depth images of a shape that stands on the table, 0 where there is none; the camera's constant error is one."""
    return spoiled((drawn(T, [shape], [np.eye(4)], camera).depth for T in Ts_camera_table), rng)


def spoiled(clean: Iterable[Array], rng: Rng) -> list[Array]:
    """Depth images with the errors of one camera, 0 where there is none."""
    noise, own = replace(STRUCTURED_LIGHT, nearest=0.1), int(rng.integers(2**31))
    return [np.nan_to_num(add_depth_noise(depth, noise, rng, own)) for depth in clean]


def turned_before(n: int, distance: float = 0.45) -> Array:
    """T_camera_thing (n, 4, 4) of a camera at whose middle a thing is turned, by n views all around it."""
    Ts = []
    for k in np.arange(n):
        height = 0.9 * np.cos(2 * np.pi * k / n + 0.3)
        around = 4 * np.pi * k / n
        z = -np.array([*np.sqrt(1 - height**2) * np.array([np.cos(around), np.sin(around)]), height])
        x = np.cross(z, [0.3, 1.0, 0.2])
        x /= np.linalg.norm(x)
        Ts.append(se3.inverse(se3.compose(np.column_stack([x, np.cross(z, x), z]), -distance * z)))
    return np.stack(Ts)


def pictures_of(Ts_camera_thing: Array, shape: Shape, rng: Rng, *, camera: Any = CAMERA) -> list[Array]:
    """Depth images of a shape before a wall at 2 m, as `pictures`."""
    clean = (camera.draw(se3.apply(T, shape[0]), shape[1]).depth for T in Ts_camera_thing)
    return spoiled((np.where(np.isfinite(depth), depth, 2.0).astype(np.float32) for depth in clean), rng)


def standing(model: hs.ObjectModel) -> Shape:
    """Vertices and faces of a model that stands on its lowest point in the table's middle."""
    low, high = model.bounds_object
    return np.array(model.vertices) - [*(low + high)[:2] / 2, low[2]], model.faces


def wrong(Ts: Array, rng: Rng, position: float = 4e-3, degrees: float = 2.0) -> Array:
    """Poses that are off by so much [m, rad], root mean square, each on its own."""
    off = np.repeat([position, np.deg2rad(degrees)], 3) / np.sqrt(3) * rng.normal(size=(len(Ts), 6))
    return np.stack([se3.moved(T, each) for T, each in zip(Ts, off, strict=True)])


CAN = hs.ObjectModel.cylinder(0.033, 0.115)
