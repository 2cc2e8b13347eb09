"""Depth images of an object that moves before a camera while a hand closes on it, drawn, with a camera's noise."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.hand.surface import HandShape
from handsight.simulation import add_depth_noise
from handsight.vision import STRUCTURED_LIGHT, hand_mask

CAMERA = Camera(np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]), (640, 480))
RATE = 30.0
FASTEST = 0.3, 1.5
"""Of the object [m/s, rad/s]."""
FAR = 0.5, 1.2
"""From the camera to the object [m]."""
WALL = 0.4, 1.0
"""From the object to what is behind it [m]."""
COMES_FROM, CLOSES = 0.25, 0.6
"""How far the hand comes from [m]; the share of the sequence after which it is closed."""
JOINT = float(np.deg2rad(1))
"""Error of the hand's joints [rad]."""
FREQUENCIES = np.array([0.2, 0.45])
"""[Hz]"""
TURNS = 0.5
"""How far to either side an object turns in place [rad]."""
STILL = ("WRJ0", "WRJ1", "J3", "LFJ4", "THJ4")
"""Ends of joints that do not bend as the hand closes."""
NOISE = replace(STRUCTURED_LIGHT, nearest=0.1)
"""As near as sequences are."""


class Instant(NamedTuple):
    """One image of a sequence, and what is true."""

    stamp: float
    depth: np.ndarray
    """(h, w) [m]; 0 where there is none."""
    hand: np.ndarray
    """(h, w) its pixels as the believed joints say."""
    T_camera_object: np.ndarray
    T_camera_palm: np.ndarray
    gripped: bool
    hidden: float
    """Share of the silhouette."""


Course = Callable[[float], np.ndarray]
"""T_camera_center (4, 4) at a time [s]: of the object's middle."""


def swinging(rng: np.random.Generator) -> Course:
    """Through the middle of the picture, smoothly and no faster than `FASTEST`."""
    z = rng.uniform(*FAR)
    aside = rng.uniform(-0.3, 0.3, 2) * CAMERA.size / np.diag(CAMERA.matrix)[:2] * z
    middle, rotation = np.append(aside, z), se3.random(rng)[:3, :3]
    ways = rng.normal(size=(2, 2, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    fastest = 2 * np.pi * FREQUENCIES[:, None] * np.ones(2)
    share = rng.dirichlet([1, 1]) * rng.uniform(0.4, 1)
    waves, phases = ways * (share[:, None] * FASTEST / fastest)[:, :, None], rng.uniform(0, 2 * np.pi, 2)

    def at(time: float) -> np.ndarray:
        swing = np.sin(2 * np.pi * FREQUENCIES * time + phases)
        shift, turn = (waves * swing[:, None, None]).sum(axis=0)
        return se3.compose(se3.rotation_exp(turn) @ rotation, middle + shift)

    return at


def jug() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a round body along z with a handle low at its side, along x."""
    body, handle = hs.ObjectModel.cylinder(0.05, 0.12), hs.ObjectModel.box((0.04, 0.012, 0.04))
    vertices = np.concatenate([body.vertices, handle.vertices + np.array([0.065, 0, -0.03])])
    return vertices + np.array([0, 0, 0.06]), np.concatenate([body.faces, handle.faces + len(body.vertices)])


def turning(rng: np.random.Generator) -> Course:
    """In place about its z, upright before the camera, its x away from it within `TURNS`."""
    upright = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    tilt = se3.rotation_exp(rng.uniform(-0.15, 0.15, 3) * [1, 0, 1])
    z, phase = rng.uniform(*FAR), rng.uniform(0, 2 * np.pi)

    def at(time: float) -> np.ndarray:
        angle = TURNS * np.sin(FASTEST[1] / TURNS * time + phase)
        return se3.compose(tilt @ upright @ _about_z(angle), np.array([0, 0, z]))

    return at


def _about_z(angle: float) -> np.ndarray:
    return se3.rotation_exp(np.array([0, 0, angle]))


def sequence(
    model: hs.ObjectModel,
    hand: HandShape | None,
    rng: np.random.Generator,
    *,
    path: Course | None = None,
    count: int = 60,
    aside: tuple[float, float] = (0.0, 1.6),
    hold: bool = True,
) -> Iterator[Instant]:
    """`count` images of a model on which a hand closes, if there is one, from a side so far from the camera's [rad].

    path: of the model, else `swinging`. hold: once it is closed the hand moves with the object, else it stays.
    """
    path, to_center = path or swinging(rng), se3.compose(np.eye(3), -model.center_object)
    still, nothing = Still(rng), (np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    closing = None if hand is None else Closing(model, hand, rng, path, count=count, aside=aside, hold=hold)
    for k in range(count):
        T = path(k / RATE)
        T_palm, joints = (np.eye(4), {}) if closing is None else closing.at(k, T)
        true = nothing if hand is None else (se3.apply(T_palm, hand.vertices_palm(joints)), hand.faces)
        depth, hidden = _picture(model, T @ to_center, true, still, rng)
        mask = np.zeros(depth.shape, dtype=bool)
        if closing is not None:
            mask = hand_mask(CAMERA, depth, closing.believed(joints), hand.faces, T_palm)
        gripped = closing is not None and closing.holds(k)
        yield Instant(k / RATE, depth, mask, T @ to_center, T_palm, gripped, hidden)


class Closing:
    """A hand that comes from aside and closes on an object."""

    def __init__(self, model, hand, rng, path, *, count, aside, hold):
        """Draws how it closes, and where it will be then."""
        self.hand, self.path, self.hold, self.steps = hand, path, hold, CLOSES * count
        self.closed = {j: rng.uniform(0.2, 0.9) * (not j.endswith(STILL)) for j in hand.joints}
        self.error = {j: JOINT * rng.normal() for j in hand.joints}
        self.T_end = path(self.steps / RATE)
        T_object = self.T_end @ se3.compose(np.eye(3), -model.center_object)
        self.T_palm, self.way = _grip(model, hand, self.closed, T_object, rng, aside)

    def holds(self, k):
        """Whether it moves with the object in the k-th image."""
        return self.hold and k >= self.steps

    def at(self, k, T):
        """T_camera_palm in the k-th image, the object's middle at T, and the joints."""
        done = min(k / self.steps, 1.0)
        joints = {j: angle * (0.2 + 0.8 * done) for j, angle in self.closed.items()}
        if self.holds(k):
            return T @ se3.inverse(self.T_end) @ self.T_palm, joints
        T_palm = self.T_palm.copy()
        T_palm[:3, 3] += COMES_FROM * (1 - done) ** 1.5 * self.way
        if self.hold:
            T_palm[:3, 3] += (T[:3, 3] - self.T_end[:3, 3]) * done
        return T_palm, joints

    def believed(self, joints):
        """The hand's vertices (k, 3) in the palm, as the robot believes."""
        return self.hand.vertices_palm({j: angle + self.error[j] for j, angle in joints.items()})


def _grip(model, hand, joints, T_camera_object, rng, aside):
    """T_camera_palm of the closed hand as it touches, and the way (3,) it comes from."""
    vertices = hand.vertices_palm(joints)
    center = se3.apply(T_camera_object, model.center_object[None])[0]
    to_camera = -center / np.linalg.norm(center)
    angle, around = rng.uniform(*aside), rng.uniform(0, 2 * np.pi)
    side = np.linalg.svd(to_camera[None])[2][1:]
    way = np.cos(angle) * to_camera + np.sin(angle) * (np.cos(around) * side[0] + np.sin(around) * side[1])
    R = se3.random(rng)[:3, :3]
    aim = se3.apply(T_camera_object, model.sample(1, int(rng.integers(1 << 31)))[0])[0]
    T = se3.compose(R, aim + (model.diameter + 0.3) * way - R @ vertices.mean(axis=0))
    T_object_camera = se3.inverse(T_camera_object)
    for _ in range(60):
        apart = model.evaluate(se3.apply(T_object_camera @ T, vertices[::4])).distance.min()
        if apart < 1e-3:
            break
        T[:3, 3] -= max(apart, 1e-3) * way
    # From aside, so that it does not hide the object on its way.
    return T, np.cos(around) * side[1] - np.sin(around) * side[0]


class Still:
    """What stays through a sequence: the wall's distance and the camera's own errors."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draws it."""
        self.behind, self.camera = rng.uniform(*WALL), int(rng.integers(2**31))


def _picture(model, T, hand, still, rng):
    """Depth (h, w) with noise, and the hidden share of the silhouette."""
    vertices = se3.apply(T, model.vertices)
    alone = np.isfinite(CAMERA.draw(vertices, model.faces).depth)
    labels = np.repeat(np.arange(2), [len(model.faces), len(hand[1])])
    faces = np.concatenate([model.faces, hand[1] + len(vertices)])
    depth, drawn = CAMERA.draw(np.concatenate([vertices, hand[0]]), faces, labels)
    hidden = 1 - (drawn == 0).sum() / max(alone.sum(), 1)
    depth = np.where(np.isfinite(depth), depth, np.float32(T[2, 3] + still.behind))
    return np.nan_to_num(add_depth_noise(depth, NOISE, rng, still.camera)), float(hidden)
