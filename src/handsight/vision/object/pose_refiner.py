"""The pose of an object in a depth image near where it is expected, refined and scored."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import depth_image, depth_term, outline, pinhole, pose_score
from handsight._kernels.image.vision_records import DEPTH_POINT, HAND, OUT, STAGE, WINDOW
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.vision.candidates import Candidates, candidates_at, center_depths, pose_covariances, poses_of
from handsight.vision.depth_noise import DepthNoise
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
        part = self._part(T_expected, depth, hand, table)
        if T_at_rest is None:
            wide = REFINER_WITHIN * self.model.diameter
            return self._moved(part, T_expected, known, wide, STAGES, None)
        z = center_depths(self.model, candidates_at(T_expected[None]))
        near = 2 * float(explained_within(self.noise, z)[0])
        return self._moved(part, T_expected, known, near, NEAR_STAGES, T_at_rest)

    def _moved(
        self,
        part: _Part,
        T_expected: Array,
        known: Array,
        within: float,
        stages: NDArray[np.void],
        other: Array | None,
    ) -> RefinedPose:
        """Returns the expected pose, moved to the points of the image within so far of it [m], or the other pose (4, 4)
        if the image supports that better."""
        candidates = candidates_at(np.stack([T_expected] if other is None else [T_expected, other]))
        candidate = candidates[:1]
        camera = self.camera.record
        record = self.model.record[:2]
        image, window = part
        points = np.zeros(MAX_POINTS, dtype=DEPTH_POINT)
        window["within"] = within
        points = points[: depth_image.near_points(record, image, window, candidate, points)]
        z = center_depths(self.model, candidates)
        candidates["bound"] = explained_within(self.noise, z)
        one_point = float(self.noise.sigma(z[:1])[0] ** 2 + self.noise.bias(z[:1])[0] ** 2)
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
        pixels = np.empty((len(points), 2))
        pinhole.pixels_of(self.camera.record, points, pixels)
        low, high = np.fmin.reduce(pixels), np.fmax.reduce(pixels)
        left = top = right = bottom = 0
        if not np.isnan(low[0]):  # NaN where it is out of the image
            nearest = max(points[:, 2].min(), REFINER_MARGIN)
            margin = 1 + REFINER_MARGIN * self.model.diameter * self.camera.matrix[0, 0] / nearest
            ends = np.stack([low - margin, high + margin + 1]).clip(0, self.camera.size)
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
