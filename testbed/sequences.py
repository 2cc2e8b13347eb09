"""Sequences of depth images, and the methods that follow an object in them, judged image by image.

The sequences are the tests' (`tests/sight_sequences.py`). small_gicp lays the same window's points onto the model, from
the same kind of prediction as `DepthTracker`, point to plane; its time is that of `align` alone.
"""

import contextlib
import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.vision import DepthTracker
from handsight.vision.object.depth_tracker import DEPTH_TRACKER
from handsight.vision.object.pose_refiner import REFINER
from testbed import scenes
from testbed import sight_sequences as drawn
from testbed.report import Array, Row

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
    """A `Followed` is a DepthTracker, with or without the palm's motion."""

    def __init__(self, model: hs.ObjectModel, T: Array, *, palm: bool) -> None:
        """Begins at the true pose."""
        self._tracker, self._palm = DepthTracker(model, drawn.CAMERA, start=T), palm
        self.state, self.T, self.covariance = "tracking", T, None

    def step(self, image: drawn.Instant) -> float:
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
    """A `SmallGicp` aligns an image's points with the model's cloud by PLANE_ICP in one thread; `align` is timed."""

    def __init__(self, model: hs.ObjectModel, T: Array) -> None:
        """Begins at the true pose. Raises ImportError without small_gicp."""
        small_gicp = importlib.import_module("small_gicp")
        self._peer, self._model = small_gicp, model
        self._cloud = small_gicp.PointCloud(model.sample(CLOUD)[0])
        self._tree = small_gicp.KdTree(self._cloud)
        small_gicp.estimate_normals(self._cloud, self._tree, num_neighbors=10)
        self.state, self.covariance = "tracking", None
        self.T, self._before = T, T

    def step(self, image: drawn.Instant) -> float:
        """As `Followed.step`."""
        center = se3.compose(np.eye(3), self._model.center_object)
        here, before = self.T @ center, self._before @ center
        expected = se3.moved(here, DEPTH_TRACKER.velocity_share * se3.difference(here, before)) @ se3.inverse(
            center
        )
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

    def _points(self, image: drawn.Instant, T: Array) -> Array:
        """Returns points of the image without the hand, as near to the expected surface as those of `Followed`."""
        pixels = drawn.CAMERA.project(se3.apply(T, self._model.points_object))
        pixels = pixels[np.isfinite(pixels[:, 0])]
        if not len(pixels):
            return np.empty((0, 3))
        low, high = (
            np.clip(at, 0, drawn.CAMERA.size).astype(int) for at in (pixels.min(0) - 10, pixels.max(0) + 11)
        )
        box = slice(low[1], high[1]), slice(low[0], high[0])
        z, rays = image.depth[box].astype(np.float64), drawn.CAMERA.rays[box]
        there = (z > 0) & ~image.hand[box]
        points = np.concatenate([rays * z[..., None], z[..., None]], axis=2)[there]
        points = points[:: max(len(points) // (2 * POINTS), 1)]
        distance = self._model.evaluate(se3.apply(se3.inverse(T), points), fine=False).distance
        points = points[np.abs(distance) < REFINER.within * self._model.diameter]
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
    T_near = scenes.nearest_truth(model, T, answer.T)
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


def followed(name: str, model: hs.ObjectModel, images: Iterator[drawn.Instant], key: Row) -> Iterator[Row]:
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
