"""Depth images of objects, drawn, with noise as a structured-light camera's: the one source of pictures for tests,
experiments and benchmarks.

`tabletop` puts any models on a table, two of them close to the first one; `in_hand` a Shadow hand that touches it, with
joints that are not quite where they are said to be. Hidden: the share of the object's silhouette that is not seen.
"""

import functools
from collections.abc import Iterable, Iterator, Sequence
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
Shape = tuple[Array, Array]
"""Vertices and faces."""

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


def letter() -> Shape:
    """Vertices and faces of an object without symmetry: three boxes on top of and beside each other."""
    parts = [
        ((0.09, 0.06, 0.03), (0, 0, 0.015)),
        ((0.03, 0.05, 0.06), (-0.025, 0.0, 0.05)),
        ((0.02, 0.03, 0.03), (0.03, -0.01, 0.04)),
    ]
    vertices: list[Array] = []
    faces: list[Array] = []
    for size, middle in parts:
        box = hs.ObjectModel.box(size)
        faces.append(box.faces + sum(map(len, vertices)))
        vertices.append(box.vertices + middle)
    return np.concatenate(vertices), np.concatenate(faces)


def revolved(profile: Any, around: int = 48) -> Shape:
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


def bowl(radius: float = 0.08, wall: float = 0.002, *, sheet: bool = False) -> Shape:
    """Vertices and faces of a bowl that stands on z = 0, a part of a ball."""
    angle = np.linspace(0, 0.42 * np.pi, 14)
    outside = np.c_[radius * np.sin(angle), radius - radius * np.cos(angle)]
    inside = np.c_[(radius - wall) * np.sin(angle), radius - (radius - wall) * np.cos(angle)][::-1]
    return revolved(outside if sheet else np.concatenate([outside, inside]))


def mug(radius: float = 0.04, height: float = 0.09, wall: float = 0.003) -> Shape:
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


def looking(rng: np.random.Generator, distance: float) -> np.ndarray:
    """T_camera_table of a camera that looks down on the table's middle."""
    height, around = rng.uniform(np.deg2rad(30), np.deg2rad(70)), rng.uniform(0, 2 * np.pi)
    eye = distance * np.array(
        [np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)]
    )
    z = -eye / distance
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return se3.inverse(se3.compose(np.column_stack([x, np.cross(z, x), z]), eye))


def on_table(rng: Rng, shapes: Sequence[Shape], gap: float = 0.09) -> Array:
    """Poses on the table of shapes (vertices, faces): the first in its middle, the others around it, turned at will."""
    Ts = []
    for k, _ in enumerate(shapes):
        side, spin = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
        place = gap * min(k, 1) * np.array([np.cos(side), np.sin(side), 0])
        Ts.append(se3.compose(se3.rotation_exp(np.array([0, 0, spin])), place))
    return np.stack(Ts)


def drawn(
    T_camera_table: Array,
    shapes: Sequence[Shape],
    Ts_table_object: Array | Sequence[Array],
    camera: Camera = CAMERA,
) -> Any:
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


def laid_against(
    model: hs.ObjectModel, T_camera_object: Array, T_camera_palm: Array, vertices: Array, way: Array
) -> Array:
    """A hand's pose (4, 4), moved against the way (3,) it comes from until its vertices (k, 3) touch the object."""
    T = T_camera_palm.copy()
    T_object_camera = se3.inverse(T_camera_object)
    for _ in range(60):
        apart = model.evaluate(se3.apply(T_object_camera @ T, vertices[::4])).distance.min()
        if apart < 1e-3:
            break
        T[:3, 3] -= max(apart, 1e-3) * way
    return T


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
    T = se3.compose(R, aim + (model.diameter + 0.3) * way - R @ middle)
    T = laid_against(model, T_camera_object, T, vertices, way)
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
    if touching is not None and hand is not None:
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
    mask = None
    if touching is not None and hand is not None:
        mask = hand_mask(WIDE, measured, touching[1], hand.faces, np.eye(4))
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


# Views of an object from all around, by one camera with errors of its own

CENTER = np.array([0, 0, 0.05])


def path_around(n: int, rng: Rng, *, turns: float = 1.0, distance: float = 0.45) -> Array:
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


def pictures_around(Ts_camera_table: Array, shape: Shape, rng: Rng, *, camera: Any = CAMERA) -> list[Array]:
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
    """Depth images of a shape before a wall at 2 m, as `pictures_around`."""
    clean = (camera.draw(se3.apply(T, shape[0]), shape[1]).depth for T in Ts_camera_thing)
    return spoiled((np.where(np.isfinite(depth), depth, 2.0).astype(np.float32) for depth in clean), rng)


def standing(model: hs.ObjectModel) -> Shape:
    """Vertices and faces of a model that stands on its lowest point in the table's middle."""
    low, high = model.bounds_object
    return np.array(model.vertices) - [*(low + high)[:2] / 2, low[2]], model.faces


def wrong_poses(Ts: Array, rng: Rng, position: float = 4e-3, degrees: float = 2.0) -> Array:
    """Poses that are off by so much [m, rad], root mean square, each on its own."""
    off = np.repeat([position, np.deg2rad(degrees)], 3) / np.sqrt(3) * rng.normal(size=(len(Ts), 6))
    return np.stack([se3.moved(T, each) for T, each in zip(Ts, off, strict=True)])


# A hand that holds something over a table; its joints are believed with an error

WIDE_TABLE = 1.5 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
HAND, OBJECT, ARM, PLANE = 0, 1, 2, 3


ONE_DEGREE = float(np.deg2rad(1.0))


@dataclass(frozen=True, eq=False)
class HandScene:
    """One picture, and what is true of it."""

    depth: np.ndarray
    """(h, w) [m], 0 where there is none."""
    joints: dict[str, float]
    """As they are believed to be [rad]."""
    T_camera_palm: np.ndarray
    hand_pixels: int
    """Of the hand that are seen."""
    hidden: float
    """Share of the hand's pixels that the object covers."""


def curled(hand: Any, rng: np.random.Generator) -> dict[str, float]:
    """Joint positions of a hand that closes around something: each within its range, flexion near its middle."""
    low, high = np.where(np.isfinite(hand.limits), hand.limits, [-0.5, 1.0]).T
    wide = high - low
    middle = np.clip(0.0, low, high)
    share = np.where(wide > 1.2, rng.uniform(0.25, 0.65) + rng.uniform(-0.15, 0.15, len(low)), 0.0)
    spread = rng.uniform(-0.15, 0.15, len(low)) * wide
    return dict(
        zip(
            hand.joint_names,
            np.clip(middle + share * (high - middle) + spread * (share == 0), low, high),
            strict=True,
        )
    )


def hand_scene(
    hand: Any,
    shapes: tuple[Any, Any, Any],
    rng: np.random.Generator,
    *,
    sigma_joint: float = ONE_DEGREE,
    held: bool = True,
    noise: Any = noisy,
) -> HandScene:
    """A HandScene; `shapes`: of the hand, of what is held (vertices, faces), and of an arm or None.

    The arm is a HandShape in the palm's axes too; views in which little of the hand is seen are drawn again.
    """
    while True:
        believed = curled(hand, rng)
        joints = {name: value + sigma_joint * rng.normal() for name, value in believed.items()}
        scene = _hand_drawn(hand, shapes, joints, rng, held)
        if scene is not None:
            depth, T, pixels, hidden = scene
            return HandScene(noise(depth, rng), believed, T, pixels, hidden)


def _hand_drawn(hand: Any, shapes: Any, joints: Any, rng: Any, held: bool) -> Any:
    shape, (points, triangles), arm = shapes
    vertices = shape.vertices_palm(joints)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    grasp = hand.Ts_palm_tip(joints)[:, :3, 3].mean(axis=0)
    parts = [(vertices, shape.faces, HAND)]
    if held:
        thing = points - (points.min(axis=0) + points.max(axis=0)) / 2
        place = grasp + 0.35 * (grasp - middle) + 0.01 * rng.normal(size=3)
        parts.append((thing @ se3.random(rng)[:3, :3].T + place, triangles, OBJECT))
    if arm is not None:
        parts.append((*arm(joints), ARM))
    T = se3.random(rng)
    T[:3, 3] = 0
    aim = np.array([rng.normal(0, 0.08), rng.normal(0, 0.06), rng.uniform(0.55, 1.1)])
    T[:3, 3] = aim - T[:3, :3] @ middle
    normal = np.array([0.0, -np.cos(0.7), -np.sin(0.7)]) + 0.2 * rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    low = min((se3.apply(T, v) @ normal).min() for v, _, _ in parts)
    plane = _plane(normal, low - rng.uniform(0.0, 0.15))
    placed, faces, labels, count = [], [], [], 0
    for v, f, label in parts:
        placed.append(se3.apply(T, v))
        faces.append(f + count)
        labels.append(np.full(len(f), label))
        count += len(v)
    alone = np.isfinite(WIDE.draw(placed[0], parts[0][1]).depth).sum()
    placed.append(plane)
    faces.append(SQUARE + count)
    labels.append(np.full(2, PLANE))
    drawn = WIDE.draw(np.concatenate(placed), np.concatenate(faces), np.concatenate(labels))
    pixels = int((drawn.labels == HAND).sum())
    if pixels < 1500 * (WIDE.matrix[0, 0] / 525) ** 2 or alone < 1.0:
        return None
    return drawn.depth, T, pixels, 1 - pixels / alone


def _plane(normal: Any, offset: float) -> Any:
    x = np.cross(normal, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    middle = offset * normal
    return (
        middle
        + np.array([0, 0, 0.9])
        - normal * normal[2] * 0.9
        + WIDE_TABLE[:, :1] * x
        + WIDE_TABLE[:, 1:2] * y
    )


def palm_error(rng: np.random.Generator, length: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """A shift (3,) and a turn (3, 3) of that size, each in a random direction."""
    shift, axis = rng.normal(size=(2, 3))
    return length * shift / np.linalg.norm(shift), se3.rotation_exp(angle * axis / np.linalg.norm(axis))


def moved_palm(T_camera_palm: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The palm's pose off by those, turned about its origin."""
    T = T_camera_palm.copy()
    T[:3, :3] = turn @ T[:3, :3]
    T[:3, 3] += shift
    return T
