"""Sequences of depth images, and the methods that follow an object in them, judged image by image.

In a sequence an object moves before a camera while a hand closes on it, drawn, with a camera's noise. small_gicp lays
the same window's points onto the model, from the same kind of prediction as `DepthTracker`, point to plane; its time is
that of `align` alone.
"""

import contextlib
import importlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.hand.surface import HandShape
from handsight.simulation import add_depth_noise
from handsight.vision import STRUCTURED_LIGHT, DepthTracker, hand_mask
from handsight.vision.object.depth_tracker import VELOCITY_SHARE
from handsight.vision.object.pose_refiner import REFINER_WITHIN
from testbed.report import Array, Row
from testbed.scenes import nearest_truth
from testbed.sight_scenes import WIDE, laid_against

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
    aside = rng.uniform(-0.3, 0.3, 2) * WIDE.size / np.diag(WIDE.matrix)[:2] * z
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
    path = path or swinging(rng)
    to_center = se3.compose(np.eye(3), -model.center_object)
    still = Still(rng)
    nothing = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    closing = None if hand is None else Closing(model, hand, rng, path, count=count, aside=aside, hold=hold)
    for k in range(count):
        T = path(k / RATE)
        T_palm, joints = (np.eye(4), {}) if closing is None else closing.at(k, T)
        true = nothing if hand is None else (se3.apply(T_palm, hand.vertices_palm(joints)), hand.faces)
        depth, hidden = _picture(model, T @ to_center, true, still, rng)
        mask = np.zeros(depth.shape, dtype=bool)
        if closing is not None:
            mask = hand_mask(WIDE, depth, closing.believed(joints), closing.hand.faces, T_palm)
        gripped = closing is not None and closing.holds(k)
        yield Instant(k / RATE, depth, mask, T @ to_center, T_palm, gripped, hidden)


class Closing:
    """A hand that comes from aside and closes on an object."""

    def __init__(
        self,
        model: hs.ObjectModel,
        hand: HandShape,
        rng: np.random.Generator,
        path: Course,
        *,
        count: int,
        aside: tuple[float, float],
        hold: bool,
    ) -> None:
        """Draws how it closes, and where it will be then."""
        self.hand, self.path, self.hold, self.steps = hand, path, hold, CLOSES * count
        self.closed = {j: rng.uniform(0.2, 0.9) * (not j.endswith(STILL)) for j in hand.joints}
        self.error = {j: JOINT * rng.normal() for j in hand.joints}
        self.T_end = path(self.steps / RATE)
        T_object = self.T_end @ se3.compose(np.eye(3), -model.center_object)
        self.T_palm, self.way = _grip(model, hand, self.closed, T_object, rng, aside)

    def holds(self, k: int) -> bool:
        """Whether it moves with the object in the k-th image."""
        return self.hold and k >= self.steps

    def at(self, k: int, T: Array) -> tuple[Array, dict[str, float]]:
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

    def believed(self, joints: dict[str, float]) -> Array:
        """The hand's vertices (k, 3) in the palm, as the robot believes."""
        return self.hand.vertices_palm({j: angle + self.error[j] for j, angle in joints.items()})


def _grip(
    model: hs.ObjectModel,
    hand: HandShape,
    joints: dict[str, float],
    T_camera_object: Array,
    rng: np.random.Generator,
    aside: tuple[float, float],
) -> tuple[Array, Array]:
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
    T = laid_against(model, T_camera_object, T, vertices, way)
    # From aside, so that it does not hide the object on its way.
    return T, np.cos(around) * side[1] - np.sin(around) * side[0]


class Still:
    """What stays through a sequence: the wall's distance and the camera's own errors."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draws it."""
        self.behind, self.camera = rng.uniform(*WALL), int(rng.integers(2**31))


def _picture(
    model: hs.ObjectModel, T: Array, hand: tuple[Array, Array], still: Still, rng: np.random.Generator
) -> tuple[Array, float]:
    """Depth (h, w) with noise, and the hidden share of the silhouette."""
    vertices = se3.apply(T, model.vertices)
    alone = np.isfinite(WIDE.draw(vertices, model.faces).depth)
    labels = np.repeat(np.arange(2), [len(model.faces), len(hand[1])])
    faces = np.concatenate([model.faces, hand[1] + len(vertices)])
    depth, drawn = WIDE.draw(np.concatenate([vertices, hand[0]]), faces, labels)
    hidden = 1 - (drawn == 0).sum() / max(alone.sum(), 1)
    depth = np.where(np.isfinite(depth), depth, np.float32(T[2, 3] + still.behind))
    return np.nan_to_num(add_depth_noise(depth, NOISE, rng, still.camera)), float(hidden)


# The methods that follow it


OBJECTS = (
    "002_master_chef_can", "004_sugar_box", "006_mustard_bottle", "007_tuna_fish_can", "008_pudding_box",
    "011_banana", "019_pitcher_base", "021_bleach_cleanser", "036_wood_block", "040_large_marker",
)  # fmt: skip
BINS = ((-1, 0.3), (0.3, 0.6), (0.6, 0.8), (0.8, 1.01))
"""Bins of the hidden share of the silhouette."""
ASIDE = (0.0, 1.2), (0.0, 0.5), (0.0, 0.2)
"""Ranges of the angle between the hand's approach and the camera's side [rad], taken in turn."""
OFF = 0.1
"""Error of a surface point beyond which a pose is off [diameters]."""
INSIDE = float(chdtri(6, 0.05))
"""Squared Mahalanobis distance within which 95 % of poses are."""
CLOUD, POINTS = 4000, 800
"""Points of the model and of an image for small_gicp."""


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Returns the result of a call, and the processor time of this process that it took [s]."""
    begin = time.process_time()
    answer = call()
    return answer, time.process_time() - begin


class Followed:
    """A DepthTracker, with or without the palm's motion."""

    def __init__(self, model: hs.ObjectModel, T: Array, *, palm: bool) -> None:
        """Begins at the true pose."""
        self._tracker, self._palm = DepthTracker(model, WIDE, start=T), palm
        self.state, self.T, self.covariance = "tracking", T, None

    def step(self, image: Instant) -> float:
        """Updates the pose by an image; returns the processor time that it took [ms]."""
        palm: dict[str, Any] = (
            {"T_camera_palm": image.T_camera_palm, "gripped": image.gripped} if self._palm else {}
        )
        detection, seconds = timed(
            lambda: self._tracker.update(image.stamp, image.depth, hand=image.hand, **palm)
        )
        pose = detection.candidate["pose"][0]
        self.state, self.covariance = detection.state, detection.covariance
        self.T = se3.compose(pose["rotation"], pose["position"])
        return 1e3 * seconds


class SmallGicp:
    """Aligns an image's points with the model's cloud by PLANE_ICP in one thread; `align` is timed."""

    def __init__(self, model: hs.ObjectModel, T: Array) -> None:
        """Begins at the true pose. Raises ImportError without small_gicp."""
        small_gicp = importlib.import_module("small_gicp")
        self._peer, self._model = small_gicp, model
        self._cloud = small_gicp.PointCloud(model.sample(CLOUD)[0])
        self._tree = small_gicp.KdTree(self._cloud)
        small_gicp.estimate_normals(self._cloud, self._tree, num_neighbors=10)
        self.state, self.covariance = "tracking", None
        self.T, self._before = T, T

    def step(self, image: Instant) -> float:
        """As `Followed.step`."""
        center = se3.compose(np.eye(3), self._model.center_object)
        here, before = self.T @ center, self._before @ center
        expected = se3.moved(here, VELOCITY_SHARE * se3.difference(here, before)) @ se3.inverse(center)
        points = self._points(image, expected)
        self._before = self.T
        if len(points) < 20:
            self.T = expected
            return 0.0
        source = self._peer.PointCloud(points)
        result, seconds = timed(
            lambda: self._peer.align(
                self._cloud,
                source,
                self._tree,
                se3.inverse(expected),
                registration_type="PLANE_ICP",
                max_correspondence_distance=0.05 * self._model.diameter,
                num_threads=1,
                max_iterations=20,
            )
        )
        self.T = se3.inverse(np.asarray(result.T_target_source))
        return 1e3 * seconds

    def _points(self, image: Instant, T: Array) -> Array:
        """Returns points of the image without the hand, as near to the expected surface as those of `Followed`."""
        pixels = WIDE.project(se3.apply(T, self._model.points_object))
        pixels = pixels[np.isfinite(pixels[:, 0])]
        if not len(pixels):
            return np.empty((0, 3))
        low, high = (np.clip(at, 0, WIDE.size).astype(int) for at in (pixels.min(0) - 10, pixels.max(0) + 11))
        box = slice(low[1], high[1]), slice(low[0], high[0])
        z, rays = image.depth[box].astype(np.float64), WIDE.rays[box]
        there = (z > 0) & ~image.hand[box]
        points = np.concatenate([rays * z[..., None], z[..., None]], axis=2)[there]
        points = points[:: max(len(points) // (2 * POINTS), 1)]
        distance = self._model.evaluate(se3.apply(se3.inverse(T), points), fine=False).distance
        points = points[np.abs(distance) < REFINER_WITHIN * self._model.diameter]
        return np.asarray(points[np.linspace(0, len(points) - 1, min(POINTS, len(points))).astype(int)])


def methods(model: hs.ObjectModel, T: Array) -> dict[str, Any]:
    """Returns new followers by name, which start at a pose (4, 4)."""
    found: dict[str, Any] = {
        name: Followed(model, T, palm=name == "in palm") for name in ("handsight", "in palm")
    }
    with contextlib.suppress(ImportError):
        found["small_gicp"] = SmallGicp(model, T)
    return found


def judged(model: hs.ObjectModel, answer: Any, T: Array) -> Row:
    """Returns the errors of a follower's pose at the true pose T (4, 4), modulo symmetry."""
    T_near = nearest_truth(model, T, answer.T)
    points = model.points_object
    off = np.linalg.norm(se3.apply(answer.T, points) - se3.apply(T_near, points), axis=1).max()
    middle = se3.apply(answer.T, model.center_object[None]) - se3.apply(T_near, model.center_object[None])
    turn = np.linalg.norm(se3.rotation_log(answer.T[:3, :3] @ T_near[:3, :3].T))
    row = {"mm": 1e3 * float(np.linalg.norm(middle)), "deg": float(np.rad2deg(turn)), "state": answer.state}
    row["off"], row["inside"] = bool(off > OFF * model.diameter), np.nan
    distance = model.evaluate(se3.apply(se3.inverse(T) @ answer.T, points)).distance
    row["adds_off"] = bool(np.abs(distance).mean() > OFF * model.diameter)
    if answer.covariance is not None:
        delta = se3.difference(T_near, answer.T)
        row["inside"] = float(delta @ np.linalg.solve(answer.covariance, delta) < INSIDE)
    return row


def followed(name: str, model: hs.ObjectModel, images: Iterator[Instant], key: Row) -> Iterator[Row]:
    """Yields a row for each method and image but the first, in which the pose is given."""
    found: dict[str, Any] = {}
    for k, image in enumerate(images):
        found = found or methods(model, image.T_camera_object)
        for method, follower in found.items():
            ms = follower.step(image)
            if k:
                row = judged(model, follower, image.T_camera_object)
                yield (
                    key
                    | {"object": name, "image": k, "hidden": image.hidden, "method": method, "ms": ms}
                    | row
                )


def hand_shape() -> Any:
    """Returns the shape of the simulation's hand; raises MissingExtra where it is not installed."""
    from handsight.simulation import Scenario, rig_of

    return rig_of(Scenario(object="can")).hand.shape()
