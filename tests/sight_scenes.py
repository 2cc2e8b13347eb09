"""Depth images of objects, drawn, with noise as a structured-light camera's: the one source of pictures for tests,
experiments and benchmarks.

`tabletop` puts any models on a table, two of them close to the first one; `in_hand` a Shadow hand that touches it, with
joints that are not quite where they are said to be. Hidden: the share of the object's silhouette that is not seen.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.hand.surface import HandShape
from handsight.objects import Symmetries, about
from handsight.simulation import add_depth_noise
from handsight.vision import STRUCTURED_LIGHT, DepthNoise, hand_mask

Array = np.ndarray
Rng = np.random.Generator
Pair = tuple[float, float]

CAMERA = Camera(np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]]), (320, 240))
TABLE = np.array([[-0.4, -0.4, 0], [0.4, -0.4, 0], [0.4, 0.4, 0], [-0.4, 0.4, 0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])
WIDE = Camera(np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]), (640, 480))
FAR: Pair = (0.5, 1.2)
"""From the camera to the object [m]."""
LEAST = 400, 300
"""Pixels of a silhouette, and of what is seen of it."""
AROUND = 12
"""Pixels of the wanted box around a silhouette."""
JOINTS, BENT, SIDEWAYS = float(np.deg2rad(1)), (0.0, 0.8), ("WRJ0", "WRJ1", "J3", "LFJ4", "THJ4")
"""A joint's error [rad]; how far those bend that do not move sideways [rad]."""


def letter():
    """Vertices and faces of an object without symmetry: three boxes on top of and beside each other."""
    parts = [
        ((0.09, 0.06, 0.03), (0, 0, 0.015)),
        ((0.03, 0.05, 0.06), (-0.025, 0.0, 0.05)),
        ((0.02, 0.03, 0.03), (0.03, -0.01, 0.04)),
    ]
    vertices, faces = [], []
    for size, middle in parts:
        box = hs.ObjectModel.box(size)
        faces.append(box.faces + sum(map(len, vertices)))
        vertices.append(box.vertices + middle)
    return np.concatenate(vertices), np.concatenate(faces)


def revolved(profile, around=48):
    """Vertices and faces of a profile (k, 2) of radii and heights, turned about z; outwards is on its right."""
    profile = np.array(profile, dtype=float)
    angle, k = 2 * np.pi * np.arange(around)[:, None] / around, len(profile)
    places = np.stack(
        [np.cos(angle) * profile[:, 0], np.sin(angle) * profile[:, 0], np.tile(profile[:, 1], (around, 1))],
        -1,
    )
    i, m = (a.reshape(-1) for a in np.meshgrid(np.arange(around), np.arange(k - 1), indexing="ij"))
    a, b = i * k + m, (i + 1) % around * k + m
    faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    vertices, which = np.unique(places.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    faces = which.reshape(-1)[faces]
    return vertices, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def bowl(radius=0.08, wall=0.002, *, sheet=False):
    """Vertices and faces of a bowl that stands on z = 0, a part of a ball."""
    angle = np.linspace(0, 0.42 * np.pi, 14)
    outside = np.c_[radius * np.sin(angle), radius - radius * np.cos(angle)]
    inside = np.c_[(radius - wall) * np.sin(angle), radius - (radius - wall) * np.cos(angle)][::-1]
    return revolved(outside if sheet else np.concatenate([outside, inside]))


def mug(radius=0.04, height=0.09, wall=0.003):
    """Vertices and faces of a cylinder without a lid, and of its handle: half a ring."""
    r, h = radius - wall, height
    body = revolved([(0, 0), (radius, 0), (radius, h), (r, h), (r, wall), (0, wall)])
    turn, around = np.meshgrid(np.linspace(0, np.pi, 16), np.arange(8) * np.pi / 4, indexing="ij")
    reach = 0.024 + 0.005 * np.cos(around)
    ring = [radius - 0.003 + reach * np.sin(turn), 0.005 * np.sin(around), h / 2 + reach * np.cos(turn)]
    i, j = (a.reshape(-1) for a in np.meshgrid(np.arange(15), np.arange(8), indexing="ij"))
    a, b = 8 * i + j, 8 * i + (j + 1) % 8
    sides = np.concatenate([np.stack([a, b + 8, b], 1), np.stack([a, a + 8, b + 8], 1)])
    vertices = np.concatenate([body[0], np.stack(ring, -1).reshape(-1, 3)])
    return vertices, np.concatenate([body[1], sides + len(body[0])])


def looking(rng, distance):
    """T_camera_table of a camera that looks down on the table's middle."""
    height, around = rng.uniform(np.deg2rad(30), np.deg2rad(70)), rng.uniform(0, 2 * np.pi)
    eye = distance * np.array(
        [np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)]
    )
    z = -eye / distance
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return se3.inverse(se3.compose(np.column_stack([x, np.cross(z, x), z]), eye))


def on_table(rng, shapes, gap=0.09):
    """Poses on the table of shapes (vertices, faces): the first in its middle, the others around it, turned at will."""
    Ts = []
    for k, _ in enumerate(shapes):
        side, spin = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
        place = gap * min(k, 1) * np.array([np.cos(side), np.sin(side), 0])
        Ts.append(se3.compose(se3.rotation_exp(np.array([0, 0, spin])), place))
    return np.stack(Ts)


def drawn(T_camera_table, shapes, Ts_table_object, camera=CAMERA):
    """Depth and labels of the shapes, numbered from 0 on, and the table's: -2."""
    vertices, faces, labels, count = [TABLE], [SQUARE], [np.full(2, -2)], len(TABLE)
    for k, ((points, triangles), T) in enumerate(zip(shapes, Ts_table_object, strict=True)):
        vertices.append(se3.apply(T, points))
        faces.append(triangles + count)
        labels.append(np.full(len(triangles), k))
        count += len(points)
    placed = se3.apply(T_camera_table, np.concatenate(vertices))
    return camera.draw(placed, np.concatenate(faces), np.concatenate(labels))


def noisy(depth: Array, rng: Rng, noise: DepthNoise = STRUCTURED_LIGHT) -> Array:
    """As a camera has it, each time another one, and as near as scenes are; 0 where there is none."""
    return np.nan_to_num(add_depth_noise(depth, replace(noise, nearest=0.1), rng, int(rng.integers(2**31))))


# Pictures of any models


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera sees of an object, and what is true."""

    model: hs.ObjectModel
    T_camera_object: Array
    depth: Array
    """(h, w) [m]; 0 where there is none."""
    wanted: Array
    """(h, w) the box around the object's silhouette."""
    hand: Array | None
    """(h, w) pixels of the hand, as its believed joints say; None: there is none in the picture."""
    on_table: bool
    hidden: float
    """Share of the silhouette."""


def tabletop(
    models: Sequence[hs.ObjectModel], rng: Rng, hidden: Pair = (0, 1), *, hand: Any = None
) -> Picture:
    """The first of the models on a table with the others close to it, seen from above; half of them upright.

    `hand`: of a `shadow_hand()`, which touches the object from above the table.
    """
    while True:
        T_camera_table, Ts = looking(rng, rng.uniform(*FAR)), close_together(models, rng)
        bodies = [(m, T_camera_table @ T) for m, T in zip(models, Ts, strict=True)]
        if hand is None:
            touching = None
        else:
            touching = _touching(models[0], hand, bodies[0][1], rng)
            heights = se3.apply(se3.inverse(T_camera_table), touching[0])[:, 2]
            if heights.min() < 0:
                continue
        found = _taken(bodies, touching, hand, T_camera_table, rng, hidden)
        if found is not None:
            return found


def in_hand(model: hs.ObjectModel, hand: HandShape, rng: Rng, hidden: Pair = (0, 1)) -> Picture:
    """The model anywhere before the camera, touched by the hand, with nothing else in the picture."""
    while True:
        T = _before_camera(rng)
        found = _taken([(model, T)], _touching(model, hand, T, rng), hand, None, rng, hidden)
        if found is not None:
            return found


@functools.cache
def shadow_hand() -> HandShape:
    """The hand of the simulation; raises MissingExtra where its files are not installed."""
    from handsight.simulation import Scenario, rig_of

    return rig_of(Scenario(object="can")).hand.shape()


def pictures(count: int, draw: Any, seed: int, key: int) -> Iterator[Picture]:
    """`draw(rng, k)` for each k, each with a generator of its own."""
    for k in range(count):
        yield draw(np.random.default_rng([seed, key, k]), k)


def close_together(models: Sequence[hs.ObjectModel], rng: Rng) -> list[Array]:
    """T_table_object: the first in the middle, the others around it at about where they touch."""
    Ts, reach = [], 0.0
    for k, model in enumerate(models):
        spin = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
        R = se3.random(rng)[:3, :3] if rng.random() < 0.5 else spin
        points = model.vertices @ R.T
        low, high = points.min(axis=0), points.max(axis=0)
        place = np.array([*-(low + high)[:2] / 2, -low[2]])
        if k:
            way = rng.uniform(0, 2 * np.pi)
            apart = (np.hypot(*(high - low)[:2]) + reach) / 2 * rng.uniform(0.75, 1)
            place += apart * np.array([np.cos(way), np.sin(way), 0])
        else:
            reach = float(np.hypot(*(high - low)[:2]))
        Ts.append(se3.compose(R, place))
    return Ts


def _before_camera(rng: Rng) -> Array:
    z = rng.uniform(*FAR)
    aside = rng.uniform(-0.5, 0.5, 2) * WIDE.size / np.diag(WIDE.matrix)[:2] * 0.6 * z
    return se3.compose(se3.random(rng)[:3, :3], np.array([*aside, z]))


def _touching(
    model: hs.ObjectModel, hand: HandShape, T_camera_object: Array, rng: Rng
) -> tuple[Array, Array]:
    """The hand's vertices (k, 3) in the camera, and where the robot believes them: it comes from anywhere, rather from
    the camera's side, until it touches."""
    true = {joint: rng.uniform(*BENT) * (not joint.endswith(SIDEWAYS)) for joint in hand.joints}
    believed = {joint: angle + JOINTS * rng.normal() for joint, angle in true.items()}
    vertices, middle = hand.vertices_palm(true), hand.vertices_palm(true).mean(axis=0)
    R = se3.random(rng)[:3, :3]
    start = T_camera_object[:3, 3] + T_camera_object[:3, :3] @ model.center_object
    way = rng.normal(size=3) - start / np.linalg.norm(start)
    way /= np.linalg.norm(way)
    aim = se3.apply(T_camera_object, model.sample(1, int(rng.integers(1 << 31)))[0])[0]
    T, apart = se3.compose(R, aim + (model.diameter + 0.3) * way - R @ middle), 1.0
    T_object_camera = se3.inverse(T_camera_object)
    for _ in range(60):
        apart = model.evaluate(se3.apply(T_object_camera @ T, vertices[::4])).distance.min()
        if apart < 1e-3:
            break
        T[:3, 3] -= max(apart, 1e-3) * way
    return se3.apply(T, vertices), se3.apply(T, hand.vertices_palm(believed))


def _taken(
    bodies: Any, touching: Any, hand: HandShape | None, T_camera_table: Array | None, rng: Rng, hidden: Pair
) -> Picture | None:
    """The picture, if the first body is as much hidden as wished, and seen at all."""
    model, T = bodies[0]
    alone = np.isfinite(WIDE.draw(se3.apply(T, model.vertices), model.faces).depth)
    parts = [(se3.apply(T, m.vertices), m.faces) for m, T in bodies]
    if T_camera_table is not None:
        parts.append((se3.apply(T_camera_table, 4 * TABLE), SQUARE))
    if touching is not None:
        parts.append((touching[0], hand.faces))
    counts = np.cumsum([0, *(len(v) for v, _ in parts)])
    faces = np.concatenate([f + count for (_, f), count in zip(parts, counts, strict=False)])
    labels = np.repeat(np.arange(len(parts)), [len(f) for _, f in parts])
    depth, drawn_ = WIDE.draw(np.concatenate([v for v, _ in parts]), faces, labels)
    full, seen = alone.sum(), (drawn_ == 0).sum()
    if full < LEAST[0] or seen < LEAST[1] or not hidden[0] <= 1 - seen / full <= hidden[1]:
        return None
    rows, columns = np.nonzero(alone)
    wanted = np.zeros(alone.shape, dtype=bool)
    box = (slice(max(at.min() - AROUND, 0), at.max() + AROUND + 1) for at in (rows, columns))
    wanted[tuple(box)] = True
    measured = noisy(depth, rng)
    mask = None if touching is None else hand_mask(WIDE, measured, touching[1], hand.faces, np.eye(4))
    return Picture(model, T, measured, wanted, mask, T_camera_table is not None, float(1 - seen / full))


# How far off a pose is


def equivalents(symmetries: Symmetries, spins: int = 72) -> Array:
    """(k, 4, 4) of the symmetries, continuous ones in so many steps (not of balls: they have too many)."""
    group = symmetries.rotations
    if not symmetries.axes:
        return group
    point, axis = symmetries.axes[0]
    angles = np.arange(spins) * 2 * np.pi / spins
    return np.asarray((about(point, angles[:, None] * axis)[:, None] @ group).reshape(-1, 4, 4))


def adds(model: hs.ObjectModel, T_true: Array, Ts: Array) -> Array:
    """(k,) mean distance [diameters] of the surface at poses (k, 4, 4) from the true one."""
    points = model.sample(500, 1)[0]
    at = se3.apply(se3.inverse(T_true) @ Ts, points)
    distance = np.abs(model.evaluate(at.reshape(-1, 3)).distance).reshape(len(Ts), -1)
    return np.asarray(distance.mean(axis=1) / model.diameter)


def mssd(model: hs.ObjectModel, T_true: Array, Ts: Array) -> Array:
    """(k,) largest distance [diameters] of a surface point at poses (k, 4, 4) from where it is, modulo symmetry."""
    points = model.points_object
    truths = se3.apply(T_true @ equivalents(model.symmetries), points)
    off = [np.linalg.norm(truths - se3.apply(T, points), axis=2).max(axis=1).min() for T in Ts]
    return np.array(off) / model.diameter
