"""Pads that say no more than that something touches them, and objects that do, at random poses. Synthetic."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter

import handsight as hs
from handsight import se3
from handsight.checks import Array
from handsight.contact import TactileSurface
from testbed import scenes

Rng = np.random.Generator
SOFT = 5e-4
"""How deep an object is pressed into a pad, at most [m]."""
MOUNT = 5e-4
"""By how much all of a pad is off along its normal, as its rig is wrong [m]."""
TILT = np.deg2rad(25.0)
"""Between the object's normal and the pad's, where they touch, at most, before the object is moved to touch [rad]."""


@dataclass(frozen=True)
class Shape:
    """A pad's surface over its rectangle: flat, bent about its y, or bent about both."""

    width: float
    length: float
    radius: float | None = None
    dome: bool = False

    def surface(self, rows: int, columns: int) -> tuple[Array, Array]:
        """Points (n, 3) and outward normals (n, 3) of a grid over the whole pad; +z leaves it [m]."""
        u, v = np.meshgrid((np.arange(columns) + 0.5) / columns - 0.5, (np.arange(rows) + 0.5) / rows - 0.5)
        x, y = self.width * u.ravel(), self.length * v.ravel()
        if self.radius is None:
            return np.column_stack([x, y, 0 * x]), np.tile([0.0, 0, 1], (len(x), 1))
        a, b = x / self.radius, y / self.radius if self.dome else 0 * y
        n = np.column_stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])
        points = self.radius * (n - [0, 0, 1.0])
        return (points if self.dome else points + np.outer(y, [0, 1.0, 0])), n

    def pad(self, **fields: Any) -> TactileSurface:
        """The pad as a rig has it: one taxel in its middle, which knows how far its rim falls back and turns."""
        points, normals = self.surface(5, 4)
        middle = points.mean(axis=0)
        turned = np.arccos(normals[:, 2]).max()
        given: Any = {
            "frame": "palm",
            "points": middle[None],
            "normals": [[0, 0, 1]],
            "pitch": np.hypot(self.width, self.length),
            "sigma_point": max(float(np.ptp(points[:, 2])) / 2, 1.5e-4),
            "sigma_normal": np.deg2rad(45) + turned / 2,
            "threshold": 0.5,
        }
        return TactileSurface(**given | fields)


SHAPES = {
    "finger pad": Shape(0.016, 0.022),
    "dome": Shape(0.022, 0.024, 0.012, dome=True),
    "palm": Shape(0.045, 0.060),
    "phalanx": Shape(0.020, 0.030, 0.011),
    "thumb": Shape(0.026, 0.020, 0.017, dome=True),
    "strip": Shape(0.010, 0.035),
}
HELD_OUT = ("thumb", "strip")
"""Pads that were first drawn when all constants were chosen."""


def wedge() -> hs.ObjectModel:
    """A mesh: a doorstop, 110 x 50 x 35 mm."""
    half, top = 0.025, 0.035
    corners = [[x, y, 0] for x in (0, 0.11) for y in (-half, half)]
    corners += [[0.0, y, top] for y in (-half, half)] + [[0.11, y, 0.008] for y in (-half, half)]
    mesh = trimesh.convex.convex_hull(np.array(corners) - [0.045, 0, 0.014])
    return hs.ObjectModel.from_mesh(mesh.vertices, mesh.faces)


def prism() -> hs.ObjectModel:
    """A mesh: a hexagonal bar, 46 mm wide, 100 mm long."""
    angle = np.arange(6) * np.pi / 3
    ends = [[0.023 * np.cos(a), 0.023 * np.sin(a), z] for a in angle for z in (-0.05, 0.05)]
    mesh = trimesh.convex.convex_hull(np.array(ends))
    return hs.ObjectModel.from_mesh(mesh.vertices, mesh.faces)


def egg() -> hs.ObjectModel:
    """A mesh: an ellipsoid, 44 x 52 x 70 mm."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    return hs.ObjectModel.from_mesh(mesh.vertices * [0.022, 0.026, 0.035], mesh.faces)


OBJECTS: dict[str, Any] = {"box": scenes.box, "can": scenes.can, "wedge": wedge, "prism": prism, "egg": egg}
OBJECTS_HELD_OUT = ("prism", "egg")
"""Objects that were first drawn when all constants were chosen."""


@dataclass(frozen=True, eq=False)
class PadScene:
    """An object that touches a pad, and is touched by two fingertips, in the pad's frame."""

    T_palm_object: Array
    """As the rig has it."""
    T_true: Array
    """Where the pad says."""
    vision: hs.PosePrior
    tips: hs.Contacts


def touching(
    model: hs.ObjectModel,
    shape: Shape,
    rng: Rng,
    *,
    error: tuple[float, float] = scenes.ERROR,
    deep: float | None = None,
    tilt: float = TILT,
) -> PadScene:
    """The object at a random pose at which it is pressed into the pad, by up to `SOFT` or as deep as is given [m], with
    two tips on its far side."""
    points, normals = shape.surface(24, 24)
    samples, outward = model.sample(400, int(rng.integers(1 << 30)))
    i, j = rng.integers(len(points)), rng.integers(len(samples))
    R = aligned(outward[j], -normals[i], rng)
    about = rng.normal(size=3)
    R = se3.rotation_exp(rng.uniform(0, tilt) * about / np.linalg.norm(about)) @ R
    T = se3.compose(R, points[i] - R @ samples[j])
    away, low, high = normals[i], -0.002, 0.15
    deep = rng.uniform(0, SOFT) if deep is None else deep
    for _ in range(40):
        middle = (low + high) / 2
        place = se3.compose(np.eye(3), middle * away) @ T
        low, high = (middle, high) if distance(model, place, points) < -deep else (low, middle)
    T = se3.compose(np.eye(3), high * away) @ T
    far = np.flatnonzero((outward @ T[:3, :3].T) @ normals[i] > 0.2)
    chosen = rng.choice(far, 2, replace=False)
    tips = scenes.touched(T, (samples[chosen], outward[chosen]), (1e-3, np.deg2rad(2)), rng)
    sigma = np.repeat(np.asarray(error) / np.sqrt(3), 3)
    vision = hs.PosePrior(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2))
    # The rig has the pad elsewhere along its normal: as if all else were off.
    wrong = se3.compose(np.eye(3), MOUNT * rng.normal() * normals.mean(axis=0))
    moved = hs.PosePrior(wrong @ vision.T_palm_object, vision.covariance)
    return PadScene(wrong @ T, T, moved, tips.moved(wrong))


def distance(model: hs.ObjectModel, T: Array, points: Array) -> float:
    """The signed distance of the nearest of the points to the object."""
    return float(model.evaluate(se3.apply(se3.inverse(T), points)).distance.min())


def aligned(a: Array, b: Array, rng: Rng) -> Array:
    """A rotation that maps a unit vector to another, with a random turn about it."""
    bases = []
    for unit in (a, b):
        basis = np.linalg.svd(unit[None])[2][::-1].T
        basis[:, 2] = unit
        basis[:, 0] *= np.sign(np.linalg.det(basis))
        bases.append(basis)
    spin = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
    return np.asarray(bases[1] @ spin @ bases[0].T)


def shrunk(before: Array, after: Array) -> float:
    """The size of a region by its information (6, 6), as a share of another's, without what stays unobservable."""
    values, V = np.linalg.eigh(after)
    V = V[:, values > 1e-3]
    sizes = [np.linalg.slogdet(V.T @ information @ V)[1] for information in (before, after)]
    return float(np.exp((sizes[0] - sizes[1]) / 2))


# Objects pressed into a gel whose indentation is an image

ROWS, COLUMNS, PITCH = 60, 80, 2.4e-4
"""Of an image: 14 by 19 mm. A camera's has four times as many each way."""
DEEP = (3e-4, 1e-3)
"""Of the deepest place, from and to [m]."""
HANGING = (5e-4, 1.5e-3)
"""Length within which the gel falls back beside the object, from and to [m]."""
NOISE, ACROSS, SCALE, BLUR = 2e-5, 2.0, 0.08, 1.5e-4
"""Of a pixel [m], correlated over so many pixels; of all of them, as a share; of the image's sharpness [m]."""
PAD = Shape(COLUMNS * PITCH, ROWS * PITCH)


def gel(**fields: Any) -> TactileSurface:
    """The gel, in the palm's axes: a taxel for each block of 2 by 2 pixels."""
    given: Any = {"rows": ROWS // 2, "columns": COLUMNS // 2, "pitch": 2 * PITCH}
    given |= {"frame": "palm", "T_frame_grid": np.eye(4), "threshold": 1.5e-4, "indentation": True}
    return TactileSurface.grid(**given | fields)


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


def pressed(model: hs.ObjectModel, rng: Rng, *, tilt: float = TILT) -> GelScene:
    """A press at a random pose."""
    scene = touching(model, PAD, rng, deep=rng.uniform(*DEEP), tilt=tilt)
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
    "marble": (lambda: hs.ObjectModel.sphere(0.010), TILT),
    "rod": (lambda: hs.ObjectModel.cylinder(0.006, 0.08), np.deg2rad(3)),
    "can": (scenes.can, TILT),
    "box": (scenes.box, TILT),
    "box's face": (scenes.box, np.deg2rad(2)),
    "wedge": (wedge, TILT),
    "prism": (prism, TILT),
    "egg": (egg, TILT),
}
"""Objects, and the angle up to which they are tilted."""
