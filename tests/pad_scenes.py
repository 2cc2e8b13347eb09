"""Pads that say no more than that something touches them, and objects that do, at random poses. Synthetic."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

import handsight as hs
import scenes
from handsight import se3
from handsight.checks import Array
from handsight.contact import Pad

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

    def pad(self, **fields: Any) -> Pad:
        """The pad as a rig has it: 5 by 4 points."""
        points, normals = self.surface(5, 4)
        given: Any = {"frame": "palm", "points": points, "normals": normals, "threshold": 0.5} | fields
        return Pad(**given)


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


OBJECTS: dict[str, Any] = {
    "box": scenes.box,
    "can": scenes.can,
    "wedge": wedge,
    "prism": prism,
    "egg": egg,
}
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
