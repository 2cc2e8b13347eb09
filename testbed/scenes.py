"""Synthetic grasps with a known pose: the one source of problems for tests, experiments and benchmarks.

Contacts are drawn on an object (`on_...`: points and outward normals (n, 3), object frame), then put at a pose and
measured with noise: `random_scene` at a random pose, `paper_scene` as the founding paper simulates it. Every function
draws from its generator in a fixed order, so published numbers can be had again.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.objects import nearest
from handsight.rig import Table
from handsight.search import Area, Sweep, Touch, cast

Array = np.ndarray
Rng = np.random.Generator
Pair = tuple[float, float]
"""Of a length [m] and an angle [rad]."""
Surface = tuple[Array, Array]
"""Points and outward normals, (n, 3) each."""

CAN: Any = {"radius": 0.033, "height": 0.115}
BOX = (0.060, 0.090, 0.140)
CUBE = (0.10, 0.10, 0.10)
CYLINDER: Any = {"radius": 0.05, "height": 0.10}
CLOUD = 2000
"""Points in the cloud of the paper's method; its contacts are selected among them, as the paper did."""
NOISE: Pair = (5e-4, float(np.deg2rad(2)))
"""Of a contact, per axis."""
ERROR: Pair = (0.02, float(np.deg2rad(15)))
VISION_ERRORS: dict[str, Pair] = {"20 mm / 15°": ERROR, "85 mm / 30°": (0.085, float(np.deg2rad(30)))}
"""Root mean square length and angle of vision's error: a near start and a far one."""
START: Pair = (0.02, float(np.deg2rad(20)))
"""Table I's error of the first pose: the shift's standard deviation per axis, the whole turn."""


@functools.cache
def can() -> hs.ObjectModel:
    """A soda can."""
    return hs.ObjectModel.cylinder(**CAN)


@functools.cache
def box() -> hs.ObjectModel:
    """A tea box."""
    return hs.ObjectModel.box(BOX)


@functools.cache
def table_1_models() -> dict[str, hs.ObjectModel]:
    """The paper's two simulated objects."""
    return {"cube": hs.ObjectModel.box(CUBE), "cylinder": hs.ObjectModel.cylinder(**CYLINDER)}


# Where contacts are


BOX_POINTS = np.array(
    [
        [0.030, 0.01, 0.03],
        [0.030, -0.02, -0.04],
        [-0.01, 0.045, 0.02],
        [0.015, 0.045, -0.03],
        [0.01, 0.02, 0.070],
    ]
)
BOX_NORMALS = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]])
"""Five contacts that fix the box."""


def can_contacts() -> Surface:
    """Five contacts on the can's side."""
    angle = np.array([0.2, 1.1, 2.3, 3.6, 5.0])
    height = np.array([0.02, -0.03, 0.01, -0.01, 0.03])
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=1)
    return CAN["radius"] * normals + height[:, None] * [0, 0, 1], normals


def on_can_side(rng: Rng, n: int = 5) -> Surface:
    """n contacts anywhere on the can's side."""
    angle = rng.uniform(0, 2 * np.pi, n)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    height = rng.uniform(-0.45, 0.45, n) * CAN["height"]
    return CAN["radius"] * normals + np.outer(height, [0, 0, 1]), normals


def on_box_faces(rng: Rng, n: int = 5) -> Surface:
    """n contacts on three random faces of the box."""
    which = rng.choice(6, 3, replace=False)[np.arange(n) % 3]
    points = rng.uniform(-0.45, 0.45, (n, 3)) * BOX
    normals = np.zeros((n, 3))
    rows = np.arange(n)
    normals[rows, which // 2] = 1 - 2 * (which % 2)
    points[rows, which // 2] = normals[rows, which // 2] * np.array(BOX)[which // 2] / 2
    return points, normals


def on_four_sides(model: hs.ObjectModel, rng: Rng) -> Surface:
    """Four contacts out of the model's own cloud.

    On a box: on four of the six faces. On a cylinder: three on the side, 120° apart and each up to 15° off
    that, and one on the top.
    """
    points, normals = model.sample(CLOUD)
    if model.symmetries.axes:
        side, top = np.flatnonzero(np.abs(normals[:, 2]) < 0.5), np.flatnonzero(normals[:, 2] > 0.5)
        angles = np.deg2rad(rng.uniform(0, 360) + np.arange(0, 360, 120) + rng.uniform(-15, 15, 3))
        toward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        near = [side[np.argsort(-normals[side, :2] @ direction)[:20]] for direction in toward]
        chosen = [rng.choice(group) for group in [*near, top]]
    else:
        outward = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)[:4]]
        chosen = [rng.choice(np.flatnonzero(normals @ direction > 0.9)) for direction in outward]
    return points[chosen], normals[chosen]


def on_box_edges(rng: Rng, near: bool) -> Surface:
    """Four contacts on different faces of the box: all 1-5 mm from an edge, or 15 mm from any."""
    half = np.array(BOX) / 2
    outward = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)[:4]]
    points = outward * half
    for point, normal in zip(points, outward, strict=True):
        a, b = rng.permutation(np.flatnonzero(normal == 0))
        point[[a, b]] = rng.uniform(-1, 1, 2) * (half[[a, b]] - 0.015)
        if near:
            point[a] = rng.choice([-1, 1]) * (half[a] - rng.uniform(0.001, 0.005))
    return points, outward


def across_box(rng: Rng) -> Surface:
    """Two fingers and the thumb on the faces that are 90 mm apart, not quite level."""
    x, z = rng.uniform(-0.012, 0.012), rng.uniform(-0.03, 0.03)
    points = np.array([[x - 0.009, 0.045, z], [x + 0.009, 0.045, z], [x, -0.045, z]])
    points[:, 2] += 0.004 * rng.normal(size=3)
    return points, np.array([[0, 1.0, 0], [0, 1, 0], [0, -1, 0]])


def opposed(rng: Rng, half: float, flat: bool) -> Surface:
    """Two fingers at +half and the thumb at -half along y; on a can's side where not flat."""
    spread = 0.012 if flat else 0.35
    along = rng.uniform(-0.02, 0.02) + 0.012 * np.array([1, -1, 0.0])
    aside = spread * np.array([-0.6, 0.6, 0.0]) + rng.uniform(-1, 1) * spread * 0.3
    sign = np.array([1.0, 1, -1])
    if flat:
        return np.column_stack([aside, sign * half, along]), np.column_stack([0 * along, sign, 0 * along])
    normals = np.column_stack([np.sin(aside), sign * np.cos(aside), 0 * along])
    return half * normals + along[:, None] * [0, 0, 1.0], normals


def anywhere_on(model: hs.ObjectModel) -> Callable[..., Surface]:
    """How contacts are drawn uniformly over a model's surface."""

    def draw(rng: Rng, n: int = 5) -> Surface:
        return model.sample(n, seed=int(rng.integers(1 << 31)))

    return draw


OBJECTS = {"can": (can, on_can_side), "box": (box, on_box_faces)}
"""Name → (its model, how contacts are drawn on it)."""


# What a hand and a camera measure of them


@dataclass(frozen=True)
class Scene:
    """One grasp: what the robot measured, and the truth it does not know."""

    contacts: hs.Contacts
    vision: hs.PosePrior
    T_palm_object: Array
    points_object: Array
    """(n, 3) where the contacts truly are, object frame [m]."""
    normals_object: Array


def tilted(normals: Array, sigma: float, rng: Rng) -> Array:
    """Unit vectors turned by N(0, sigma) [rad] about each of two tangent axes."""
    tangent = rng.normal(size=normals.shape) * sigma
    tangent -= (tangent * normals).sum(axis=1, keepdims=True) * normals
    turned: Array = (se3.rotation_exp(np.cross(normals, tangent)) @ normals[..., None])[..., 0]
    return turned


def touched(T: Array, surface: Surface, noise: Pair, rng: Rng, sigmas: Pair | None = None) -> hs.Contacts:
    """Contacts of an object at `T`, with `noise` per axis; they say `sigmas`, which defaults to the noise."""
    points, normals = surface
    noisy = se3.apply(T, points) + noise[0] * rng.normal(size=points.shape)
    sigma_point, sigma_normal = sigmas or noise
    felt = tilted(normals @ T[:3, :3].T, noise[1], rng)
    return hs.Contacts(noisy, felt, sigma_point=sigma_point, sigma_normal=sigma_normal)


def random_scene(
    surface: Surface, rng: Rng, *, noise: Pair = NOISE, error: Pair = ERROR, sigmas: Pair | None = None
) -> Scene:
    """The scene of these contacts: a random pose, contact noise per axis, vision wrong by a Gaussian draw.

    `error`: root mean square length of vision's shift [m] and turn [rad]; its sigmas are per axis, and true.
    """
    T = se3.random(rng, spread=0.1)
    contacts = touched(T, surface, noise, rng, sigmas)
    sigma = np.repeat(np.asarray(error) / np.sqrt(3), 3)
    T_vision = se3.moved(T, sigma * rng.normal(size=6))
    return Scene(contacts, hs.PosePrior(T_vision, np.diag(sigma**2)), T, *surface)


def paper_scene(
    surface: Surface, rng: Rng, *, start: Pair = START, noise: Pair = (0.0, 0.0), sigmas: Pair | None = None
) -> Scene:
    """The scene of these contacts as the paper simulates it: vision has the object at the palm's origin.

    Its true pose is N(0, start[0]²) off along each axis [m], and start[1] about a random axis [rad].
    """
    axis = rng.normal(size=3)
    shift = start[0] * rng.normal(size=3)
    T = se3.moved(np.eye(4), np.concatenate([shift, start[1] * axis / np.linalg.norm(axis)]))
    contacts = touched(T, surface, noise, rng, sigmas)
    vision = hs.PosePrior.from_sigmas(np.eye(4), start[0], start[1] / np.sqrt(3))
    return Scene(contacts, vision, T, *surface)


def grasp(
    points_object: Array, normals_object: Array, seed: int, *, noise: float = 1.0, error: Pair = ERROR
) -> tuple[hs.Contacts, hs.PosePrior, Array]:
    """Contacts, vision and the true pose of a `random_scene`; `noise` in the sigmas that contacts say."""
    drawn = (noise * NOISE[0], noise * NOISE[1])
    surface = points_object, normals_object
    scene = random_scene(surface, np.random.default_rng(seed), noise=drawn, error=error, sigmas=NOISE)
    return scene.contacts, scene.vision, scene.T_palm_object


def behind_contacts(scene: Scene, count: int, seed: int = 0) -> Array:
    """Points (count, 3) [m] a hand's surface could have: behind the contacts, outside the object by 2-40 mm."""
    rng = np.random.default_rng([seed, count])
    contact = rng.integers(len(scene.contacts), size=count)
    away = rng.uniform(0.002, 0.04, (count, 1))
    return se3.apply(scene.T_palm_object, scene.points_object[contact] + away * scene.normals_object[contact])


# How an answer is judged


def off(T: Array, T_reference: Array) -> tuple[float, float]:
    """Shift [m] and turn [rad] between two poses."""
    delta = se3.difference(T, T_reference)
    return float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:]))


def nearest_truth(model: hs.ObjectModel, T_palm_object: Array, T_hat: Array) -> Array:
    """The true pose, moved along the declared symmetries to the nearest to an estimate."""
    return nearest(model.symmetries, T_palm_object, T_hat, model.radius)


def at_maximum(estimate: hs.PoseEstimate) -> hs.PoseEstimate:
    """The estimate with the maximum of the density in place of a mean; covariance and information are the mean's."""
    T = estimate.T_palm_object_maximum
    return estimate.with_gaussian(T, estimate.covariance, estimate.information)


def pose_errors(model: hs.ObjectModel, estimate: hs.PoseEstimate, T_palm_object: Array) -> list[float]:
    """Errors modulo symmetry of an estimate: shift [m] and turn [rad], of all and of what contacts observe."""
    T_hat, scale = estimate.T_palm_object, np.repeat([1.0, model.radius], 3)
    delta = se3.difference(T_hat, nearest_truth(model, T_palm_object, T_hat)) * scale
    open_ = estimate.unobservable
    observed = delta - open_.T @ (open_ @ delta) if len(open_) else delta
    return [float(np.linalg.norm(v)) for d in (delta, observed) for v in np.split(d / scale, 2)]


def found(model: hs.ObjectModel, estimate: hs.PoseEstimate, T_palm_object: Array) -> bool:
    """Whether the estimate is the right pose in what the contacts observe: within 5 mm and 8°."""
    _, _, shift, turn = pose_errors(model, estimate, T_palm_object)
    return shift < 5e-3 and turn < np.deg2rad(8)


def chi2(model: hs.ObjectModel, T_hat: Array, information: Array, T_palm_object: Array) -> tuple[float, int]:
    """The truth's squared distance from an answer, modulo symmetry, in the answer's own units, and its freedom."""
    delta = se3.difference(nearest_truth(model, T_palm_object, T_hat), T_hat)
    scale = np.repeat([1.0, 1 / model.radius], 3)
    freedom = int(np.linalg.matrix_rank(information * scale[:, None] * scale, hermitian=True))
    return float(delta @ information @ delta), freedom


def region(model: hs.ObjectModel, estimate: hs.PoseEstimate, T_palm_object: Array) -> dict[str, float | bool]:
    """`chi2`, and whether the answer's 50 % and 95 % regions hold the truth."""
    squared, freedom = chi2(model, estimate.T_palm_object, estimate.information, T_palm_object)
    inside = {f"in {level:.0%}": bool(squared < chdtri(freedom, 1 - level)) for level in (0.50, 0.95)}
    return {"squared": squared, "freedom": freedom, **inside}


def contact_errors(model: hs.ObjectModel, scene: Scene, T_hat: Array) -> tuple[float, float]:
    """A pose's mean error of the contacts' places on the object [m], and its turn [rad], modulo symmetry."""
    return places_apart(scene, T_hat, nearest_truth(model, scene.T_palm_object, T_hat))


def places_apart(scene: Scene, T: Array, T_other: Array) -> tuple[float, float]:
    """Mean distance [m] of the contacts' places on the object between two poses, and the turn [rad]."""
    here, there = (se3.apply(se3.inverse(pose), scene.contacts.points_palm) for pose in (T, T_other))
    turn = se3.rotation_log(T[:3, :3] @ T_other[:3, :3].T)
    return float(np.linalg.norm(here - there, axis=1).mean()), float(np.linalg.norm(turn))


# Many contacts: patches of links that are out of place, and some contacts that are wrong


class ManyOptions(NamedTuple):
    """`ManyOptions` say what contacts are like."""

    contacts: int = 1000
    groups: int = 5
    """Patches, each about a place of its own; 0: contacts anywhere, each with errors of its own alone."""
    sigma_point: float = 1.5e-4
    sigma_normal: float = 0.03
    shared: tuple[float, float] = (5e-4, 0.02)
    """Of a group's shift [m] and turn [rad], per axis."""
    wrong: float = 0.0
    """Share of contacts that are 10 mm off, per axis, with any normal."""
    prior: tuple[float, float] = (0.01, 0.1)


class ManyScene(NamedTuple):
    """Contacts and vision's pose, and the truth."""

    contacts: hs.Contacts
    vision: hs.PosePrior
    T_palm_object: Array
    wrong: Array
    """(n,) whether each contact is wrong."""


MANY = ManyOptions()


def many_scene(model: hs.ObjectModel, rng: np.random.Generator, options: ManyOptions = MANY) -> ManyScene:
    """Draws contacts on an object."""
    T, n = se3.random(rng, 1)[0], options.contacts
    T[:3, 3] = rng.normal(size=3) * 0.05
    surface, normals = model.sample(20_000)
    group, each = np.full(n, -1), n // max(options.groups, 1)
    if options.groups:
        group = np.minimum(np.arange(n) // each, options.groups - 1)
        chosen = np.empty(n, dtype=int)
        for g in range(options.groups):
            own = group == g
            distance = np.linalg.norm(surface - surface[rng.integers(len(surface))], axis=1)
            chosen[own] = rng.choice(np.argsort(distance)[: max(own.sum(), 400)], own.sum(), replace=False)
    else:
        chosen = rng.choice(len(surface), n, replace=n > len(surface))
    points, directions = se3.apply(T, surface[chosen]), normals[chosen] @ T[:3, :3].T
    for g in range(options.groups):
        own, error = group == g, rng.normal(size=6) * np.repeat(options.shared, 3)
        R, center = se3.rotation_exp(error[3:]), points[own].mean(axis=0)
        points[own] = (points[own] - center) @ R.T + center + error[:3]
        directions[own] = directions[own] @ R.T
    points += rng.normal(size=(n, 3)) * options.sigma_point
    directions += rng.normal(size=(n, 3)) * options.sigma_normal
    wrong = rng.random(n) < options.wrong
    points[wrong] += rng.normal(size=(wrong.sum(), 3)) * 0.01
    directions[wrong] = rng.normal(size=(wrong.sum(), 3))
    shared = {"group": group, "shared_covariance": np.diag(np.repeat(np.square(options.shared), 3))}
    contacts = hs.Contacts(
        points, directions, options.sigma_point, options.sigma_normal, **(shared if options.groups else {})
    )
    error = rng.normal(size=6) * np.repeat(options.prior, 3)
    vision = hs.PosePrior.from_sigmas(se3.moved(T, error), *options.prior)
    return ManyScene(contacts, vision, T, wrong)


# The search by touch: an area, and touches of an object at a known pose, computed by casting

SWEEP_RADIUS, SWEEP_SIGMA_POINT, SWEEP_SIGMA_NORMAL = 0.009, 0.0015, float(np.deg2rad(4.0))


def search_area(half: float = 0.12, Rs: Array | None = None) -> Area:
    """A square area of a table, from -half to half [m]; `Rs`: the ways to stand, upright without one."""
    Rs = np.eye(3)[None] if Rs is None else Rs
    return Area(np.full(2, -half), np.full(2, half), Table(height=0.0), Rs)


def swept_touch(model: hs.ObjectModel, T_world_object: Array, sweep: Sweep, rng: Rng) -> Touch:
    """The touch of a sweep, with noise of the sigmas that it says."""
    (distance,), (normal,), _ = (
        values[0] for values in cast(model, T_world_object[None], [sweep], SWEEP_RADIUS)
    )
    met = np.isfinite(distance)
    steps = np.arange(0.0, distance if met else sweep.length, 0.005)
    free = sweep.start_world + steps[:, None] * sweep.direction_world
    if not met:
        return Touch(free, SWEEP_RADIUS, 0.0025, None)
    normal = normal / np.linalg.norm(normal)
    point = sweep.at(distance) - SWEEP_RADIUS * normal + SWEEP_SIGMA_POINT * rng.normal(size=3)
    felt = se3.rotation_exp(SWEEP_SIGMA_NORMAL * rng.normal(size=3)) @ normal
    return Touch(
        free,
        SWEEP_RADIUS,
        0.0025,
        hs.Contacts(point[None], felt[None], SWEEP_SIGMA_POINT, SWEEP_SIGMA_NORMAL),
    )


def level_sweep(
    start: Sequence[float], direction: Sequence[float], length: float = 0.5, height: float = 0.1
) -> Sweep:
    """A sweep at one height above the table [m]."""
    return Sweep(np.array([*start, height]), np.array([*direction, 0.0]), length)
