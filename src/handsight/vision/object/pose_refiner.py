"""The pose of an object in a depth image near where it is expected, refined and scored."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.vision.candidates import Candidates, candidates_at, center_depths, pose_covariances, poses_of
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.kernels import depth_image, depth_term, outline, pose_score
from handsight.vision.kernels.vision_records import DEPTH_POINT, HAND, OUT, STAGE, WINDOW
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import explained_within, log_odds
from handsight.vision.object.region import TABLE_WITHIN

REFINER_WITHIN = 0.12  # distance from the expected surface within which a point counts [diameters]
REFINER_MARGIN = 0.15  # around the object's silhouette, in which points are gathered [diameters]
MAX_POINTS = 400  # points that refine a pose
MAX_PIXELS = 2000  # pixels of the window that they are chosen from
REFINER_BESIDE = 1200  # pixels about a pose that show whether the surface goes on beyond it
REFINER_CREEP = 0.04  # more explained pixels that a moved pose must have than one at rest
COVARIANCE_POINTS = 50  # of these points, by which the covariance is computed
MAX_RMS = 1.3  # of the distances of the explained pixels, above which they contradict a pose [their sigma]
RMS_WEIGHT = (4, 1.5)
"""Of what is above that, and the most that it takes from the log odds: a model, or a camera's noise, may be other
than they are declared."""

STAGES = np.array([(0, 0.12, 0.05, 4, 4), (1, 0.05, 0.0, 3, 1)], dtype=STAGE)
"""How the pose is moved to the points, with bounds in diameters."""
NEAR_STAGES = np.array([(1, 0.0, 0.0, 4, 1)], dtype=STAGE)
"""The same where it is near: only to points that the expected pose explains."""


class RefinedPose(NamedTuple):
    """The pose that depth alone gives."""

    pose_camera_object: GaussianPose
    candidate: Candidates  # CANDIDATE (1,)
    points: int  # points near the surface
    odds: float
    """Log odds that the object is there, as those of a first pose."""
    shown: float
    """Share of its pixels that neither the hand nor anything else hides."""


class _Part(NamedTuple):
    """The part of a depth image that shows about where an object is; elsewhere it has no depth."""

    image: tuple[Depth, Depth, NDArray[np.int32]]
    """Rays (h, w, 2), depth (h, w) [m] and labels (h, w): 0, or `HAND`, or `OUT` on the table."""
    window: NDArray[np.void]
    """WINDOW (1,)"""


@dataclass(frozen=True, eq=False)
class PoseRefiner:
    """Refines poses of one object, image by image; several threads may use it at once."""

    model: ObjectModel
    camera: Camera
    noise: DepthNoise
    """Of the camera's depth."""

    def at(
        self,
        T_expected: Array,
        known: Array,
        depth: Depth,
        hand: Mask | None,
        table: Array | None,
        *,
        T_at_rest: Array | None = None,
    ) -> RefinedPose:
        """Returns the pose that depth (h, w) gives from the expected one on, without the pixels of hand and table.

        known (6, 6): the information of the expected pose by (δp, δθ) of the object's centre along the camera's axes;
        it holds directions that hardly any point observes. T_at_rest (4, 4): the pose is only refined on points that
        the expected one explains, unless the image supports this one better; None: it is searched more widely.
        """
        candidates = candidates_at(np.stack([T_expected] if T_at_rest is None else [T_expected, T_at_rest]))
        candidate = candidates[:1]
        z = center_depths(self.model, candidates)
        bounds = explained_within(self.noise, z)
        candidates["bound"] = bounds
        part = self._part(T_expected, depth, hand, table)
        image, window = part
        window["within"] = REFINER_WITHIN * self.model.diameter if T_at_rest is None else 2 * bounds[0]
        camera = self.camera.record
        record = self.model.record[:2]
        points = np.zeros(MAX_POINTS, dtype=DEPTH_POINT)
        points = points[: depth_image.near_points(record, image, window, candidate, points)]
        one_point = float(self.noise.sigma(z[:1])[0] ** 2 + self.noise.bias(z[:1])[0] ** 2)
        stages = STAGES if T_at_rest is None else NEAR_STAGES
        depth_term.refine_poses(*record, points, stages, self.model.diameter, one_point * known, candidate)
        sides = appearance_of(self.model).sides
        center = self.model.center_object
        pose_score.score_all(camera, image[1:], sides, center, candidates, pose_score.NOT_ASKED)
        # A little more support is noise, or the model's error: what does not move must not creep.
        gain = 1 + REFINER_CREEP * np.arange(len(candidates))
        best = int(np.argmax(candidates["explained"] * gain - 2 * candidates["passed"]))
        candidate = candidates[best : best + 1]
        outline.follow_outlines(camera, record, image, REFINER_BESIDE, candidate)
        outline.cross_outlines(camera, record, image, candidate)
        odds = float(log_odds(candidate)[0]) - self._misfit(candidate)
        some = np.ascontiguousarray(points[:: max(len(points) // COVARIANCE_POINTS, 1)])
        covariance = pose_covariances(self.model, self.camera, some, candidate, self.noise)[0]
        pose = GaussianPose(poses_of(candidate)[0], covariance)
        return RefinedPose(pose, candidate, len(points), odds, self._shown(part, candidate))

    def _shown(self, part: _Part, candidate: Candidates) -> float:
        """Returns the share of the object's pixels at CANDIDATE (1,) that nothing hides."""
        whole = candidate.copy()
        _, depth, labels = part.image
        sides = appearance_of(self.model).sides
        image = depth, np.maximum(labels, OUT)  # a hand hides as anything else does
        center = self.model.center_object
        pose_score.score_all(self.camera.record, image, sides, center, whole, pose_score.NOT_ASKED)
        return 1 - float(whole["hidden"][0]) / max(float(whole["expected"][0]), 1.0)

    def _misfit(self, candidate: Candidates) -> float:
        """Returns what the distances of the pixels that CANDIDATE (1,) explains take from its log odds."""
        z = center_depths(self.model, candidate)
        within_pixel = z / (np.sqrt(12) * self.camera.matrix[0, 0])  # of a surface that is slanted by 45°
        sigma = np.hypot(np.hypot(self.noise.sigma(z), self.noise.bias(z)), within_pixel)
        worse = float((candidate["rms"] / sigma)[0]) - MAX_RMS
        slope, most = RMS_WEIGHT
        return min(slope * max(worse, 0.0), most)

    def _part(self, T: Array, depth: Depth, hand: Mask | None, table: Array | None) -> _Part:
        """Returns the box of an image around the object's silhouette at a pose."""
        points = se3.apply(T, self.model.points_object)
        pixels = self.camera.project(points)
        nearest = max(points[:, 2].min(), REFINER_MARGIN)
        margin = 1 + REFINER_MARGIN * self.model.diameter * self.camera.matrix[0, 0] / nearest
        ends = np.stack([np.fmin.reduce(pixels) - margin, np.fmax.reduce(pixels) + margin + 1])
        ends = np.nan_to_num(ends).clip(0, self.camera.size)  # NaN where it is out of the image
        (left, top), (right, bottom) = ends.astype(int).tolist()
        box = slice(top, bottom), slice(left, right)
        shown = depth[box]
        known: Depth = np.zeros(depth.shape, dtype=np.float32)
        labels: NDArray[np.int32] = np.zeros(depth.shape, dtype=np.int32)
        known[box] = np.where(np.isfinite(shown), shown, 0)
        if hand is not None:
            labels[box] = np.where(hand[box], HAND, 0)
        window = np.zeros(1, dtype=WINDOW)
        window["rows"] = top, bottom
        window["columns"] = left, right
        area = (bottom - top) * (right - left)
        window["step"] = max(1, round(float(np.sqrt(area / MAX_PIXELS))))
        image = self.camera.rays, known, labels
        if table is not None:
            window["plane"] = table
            window["plane_within"] = TABLE_WITHIN
            depth_image.leave_out_plane(image, window)
        return _Part(image, window)
