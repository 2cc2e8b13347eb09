"""Objects pressed into a gel whose indentation is an image, as GelSight Mini's and DIGIT's are. Synthetic.

The gel is a membrane on springs: it lies on the object where it is pushed, and around it falls back within a length of
its own, so that the image shows more than the object. Images are blurred, their noise is correlated from pixel to
pixel, their scale is off, and some pixels are dead.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

import handsight as hs
import pad_scenes
import scenes
from handsight import se3
from handsight.checks import Array
from handsight.contact import Gel

Rng = np.random.Generator
ROWS, COLUMNS, PITCH = 60, 80, 2.4e-4
"""Of an image: 14 by 19 mm. A camera's has four times as many each way."""
DEEP = (3e-4, 1e-3)
"""Of the deepest place, from and to [m]."""
HANGING = (5e-4, 1.5e-3)
"""Length within which the gel falls back beside the object, from and to [m]."""
NOISE, ACROSS, SCALE, BLUR = 2e-5, 2.0, 0.08, 1.5e-4
"""Of a pixel [m], correlated over so many pixels; of all of them, as a share; of the image's sharpness [m]."""
PAD = pad_scenes.Shape(COLUMNS * PITCH, ROWS * PITCH)


def gel(**fields: Any) -> Gel:
    """The gel, in the palm's axes."""
    given: Any = {"threshold": 1.5e-4} | fields
    return Gel.grid(frame="palm", T_frame_grid=np.eye(4), rows=ROWS, columns=COLUMNS, pitch=PITCH, **given)


@dataclass(frozen=True, eq=False)
class GelScene:
    """An object pressed into a gel, in the frame of the rig's gel, which is off by the mount's error."""

    image: Array
    """(ROWS, COLUMNS) indentations [m]"""
    T_gel_object: Array
    """As the rig has it: by the mount's error wrong."""
    T_true: Array
    """Where the image says."""
    vision: hs.PosePrior
    tips: hs.Contacts


def places() -> Array:
    """(ROWS, COLUMNS, 2) the pixels' places on the gel [m]."""
    x, y = (PITCH * (np.arange(n) - (n - 1) / 2) for n in (COLUMNS, ROWS))
    return np.stack(np.meshgrid(x, y), axis=2)


def pressed(model: hs.ObjectModel, rng: Rng, *, tilt: float = pad_scenes.TILT) -> GelScene:
    """A press at a random pose."""
    scene = pad_scenes.touching(model, PAD, rng, deep=rng.uniform(*DEEP), tilt=tilt)
    image = hanging(rigid(model, scene.T_true), rng.uniform(*HANGING))
    image = gaussian_filter(image, BLUR / PITCH)
    noise = gaussian_filter(rng.normal(size=image.shape), ACROSS)
    image = image * (1 + SCALE * rng.normal()) + NOISE * noise / noise.std()
    image[rng.random(image.shape) < 0.005] = np.nan
    return GelScene(image, scene.T_palm_object, scene.T_true, scene.vision, scene.tips)


def rigid(model: hs.ObjectModel, T_gel_object: Array) -> Array:
    """How deep the object's underside is below the gel's surface (ROWS, COLUMNS), 0 where it is above [m]."""
    xy, lowest = places().reshape(-1, 2), -2e-3
    z = np.full(len(xy), lowest)
    for _ in range(60):  # sphere tracing along +z
        points = se3.apply(se3.inverse(T_gel_object), np.column_stack([xy, z]))
        z = np.minimum(z + 0.8 * model.evaluate(points).distance, 0.0)
    return np.asarray(np.maximum(-z, 0).reshape(ROWS, COLUMNS))


def hanging(least: Array, length: float) -> Array:
    """The membrane's depth (ROWS, COLUMNS): nowhere less than the object's, and in balance where it is free [m]."""
    depth, k = least.copy(), (PITCH / length) ** 2
    parity = np.indices(least.shape).sum(axis=0) % 2
    for step in range(160):
        around = np.pad(depth, 1, mode="edge")
        mean = (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]) / (4 + k)
        relaxed = np.maximum(depth + 1.5 * (mean - depth), least)
        depth = np.where(parity == step % 2, relaxed, depth)
    return depth


def errors(model: hs.ObjectModel, patch: np.void, T_gel_object: Array) -> dict[str, float]:
    """Distance to the surface [mm], angle of the normal [deg], and their square by the covariance, per freedom."""
    R = T_gel_object[:3, :3]
    found = model.evaluate(se3.apply(se3.inverse(T_gel_object), patch["point"][None]))
    gradient, H = R @ found.gradient[0], R @ found.hessian[0] @ R.T
    normal = gradient / np.linalg.norm(gradient)
    K = (np.eye(3) - np.outer(normal, normal)) @ H / np.linalg.norm(gradient)
    to_residual = np.block([[gradient[None], np.zeros((1, 3))], [K, -np.eye(3)]])
    across = np.linalg.svd(normal[None])[2][1:]
    three = np.zeros((3, 4))
    three[0, 0], three[1:, 1:] = 1, across
    residual = three @ np.concatenate([found.distance, normal - patch["normal"]])
    S = three @ to_residual @ patch["covariance"] @ to_residual.T @ three.T
    return {
        "point": 1e3 * abs(found.distance[0]),
        "normal": float(np.degrees(np.arccos(np.clip(normal @ patch["normal"], -1, 1)))),
        "nees": float(residual @ np.linalg.solve(S, residual)) / 3,
    }


BODIES: dict[str, Any] = {
    "marble": (lambda: hs.ObjectModel.sphere(0.010), pad_scenes.TILT),
    "rod": (lambda: hs.ObjectModel.cylinder(0.006, 0.08), np.deg2rad(3)),
    "can": (scenes.can, pad_scenes.TILT),
    "box": (scenes.box, pad_scenes.TILT),
    "box's face": (scenes.box, np.deg2rad(2)),
    "wedge": (pad_scenes.wedge, pad_scenes.TILT),
    "prism": (pad_scenes.prism, pad_scenes.TILT),
    "egg": (pad_scenes.egg, pad_scenes.TILT),
}
"""Objects, and the angle up to which they are tilted."""
HELD_OUT = pad_scenes.OBJECTS_HELD_OUT
"""Bodies that were first drawn when all constants were chosen."""
