"""A look at a depth image near where an object is expected: what is there settles its pose, and is judged."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import depth_term, near_points, pinhole, pose_score
from handsight._kernels.image.vision_records import CANDIDATE, DEPTH_POINT, WINDOW
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import FIRST_POSE, depths, poses_of
from handsight.vision.object.pose_covariance import pose_covariances
from handsight.vision.object.region import REGION


class RefinerOptions(NamedTuple):
    """`RefinerOptions` say how a pose is refined on an image."""

    within: float = 0.12  # of the expected surface, for a point to count [diameters]
    margin: float = 0.15  # what is searched around its silhouette [diameters]
    max_points: int = 400  # points that refine a pose
    max_pixels: int = 2000  # pixels of the window that they are chosen from
    covariance_points: int = 50  # of them are enough for the covariance


REFINER = RefinerOptions()

STAGES = ((False, 0.12, 0.05, 4, 4), (True, 0.05, 0.0, 3, 1))
"""Whether on the fine field, Tukey's bound at first and at last [diameters], steps, every so manieth point."""
ONE_PART = np.zeros(1)


class RefinedPose(NamedTuple):
    """A `RefinedPose` is what depth alone says."""

    T_camera_object: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) of (δp, δθ) of the object's origin along the camera's axes."""
    candidate: NDArray[np.void]
    """CANDIDATE (1,)"""
    points: int
    """On the surface, or nearly."""


class PoseRefiner:
    """Looks at one object, image by image; it keeps room for the part of an image that it looks at."""

    def __init__(self, model: ObjectModel, camera: Camera, noise: DepthNoise) -> None:
        """`noise`: of the camera's depth."""
        self.model, self.camera, self.noise = model, camera, noise
        self._appearance = appearance_of(model)
        self._depth = np.zeros(camera.size[::-1], dtype=np.float32)
        self._labels = np.full(camera.size[::-1], pose_score.OUT, dtype=np.int32)
        self._window = np.zeros(1, dtype=WINDOW)
        self._window["within"], self._window["plane_within"] = (
            REFINER.within * model.diameter,
            REGION.table_within,
        )
        self._points = np.zeros(REFINER.max_points, dtype=DEPTH_POINT)
        self._stages = np.array(STAGES) * [1, model.diameter, model.diameter, 1, 1]
        self._limits = np.array([self._appearance.sample_area, FIRST_POSE.bound, *model.center_object])

    def at(
        self, T_expected: Array, known: Array, depth: Depth, hand: Mask | None, table: Array | None
    ) -> RefinedPose:
        """Returns the pose that depth (h, w) settles, from the expected one on; the hand's pixels and the table left
        out.

        known (6, 6): information by (δp, δθ) of the object's centre along the camera's axes, which holds what hardly
        any point sees where it is expected.
        """
        candidate = np.zeros(1, dtype=CANDIDATE)
        candidate["pose"]["rotation"], candidate["pose"]["position"] = T_expected[:3, :3], T_expected[:3, 3]
        model, nodes = self.model.record[:2]
        self._show(self._around(T_expected), depth, hand, table)
        image = self.camera.rays, self._depth, self._labels
        count = near_points.near_points((model, nodes), image, self._window, candidate, self._points)
        points, z = self._points[:count], depths(self.model, candidate)
        sigma = self.noise.sigma(z)
        candidate["bound"] = np.maximum(FIRST_POSE.bound, FIRST_POSE.bound_sigmas * sigma)
        one_point = sigma**2 + self.noise.bias(z) ** 2
        depth_term.refine_near(model, nodes, points, self._stages, one_point * known, candidate)
        sides = self._appearance.sides
        pose_score.score_all(self.camera.record, image[1:], sides, ONE_PART, self._limits, candidate)
        some = np.ascontiguousarray(points[:: max(count // REFINER.covariance_points, 1)])
        covariance = pose_covariances(self.model, self.camera, some, candidate, self.noise)[0]
        return RefinedPose(poses_of(candidate)[0], covariance, candidate, count)

    def _around(self, T: Array) -> tuple[slice, slice]:
        """Returns rows and columns around the object's silhouette; empty where it is out of the picture."""
        points = se3.apply(T, self.model.points_object)
        pixels = np.empty((len(points), 2))
        pinhole.pixels_of(self.camera.record, points, pixels)
        low, high = np.fmin.reduce(pixels), np.fmax.reduce(pixels)  # NaN: none
        if np.isnan(low[0]):
            return slice(0, 0), slice(0, 0)
        focal = self.camera.matrix[0, 0]
        margin = 1 + REFINER.margin * self.model.diameter * focal / max(points[:, 2].min(), REFINER.margin)
        (left, top), (right, bottom) = (low - margin).tolist(), (high + margin + 1).tolist()
        width, height = self.camera.size
        rows = slice(int(min(max(top, 0), height)), int(min(max(bottom, 0), height)))
        return rows, slice(int(min(max(left, 0), width)), int(min(max(right, 0), width)))

    def _show(self, box: tuple[slice, slice], depth: Depth, hand: Mask | None, table: Array | None) -> None:
        """Takes the image's box over, and forgets the last one's."""
        here = self._window[0]
        last = slice(*here["rows"]), slice(*here["columns"])
        self._depth[last], self._labels[last] = 0, pose_score.OUT
        here_depth, labels = self._depth[box], self._labels[box]
        here_depth[:] = depth[box]
        if not np.isfinite(here_depth.sum()):
            here_depth[~np.isfinite(here_depth)] = 0
        labels[:] = 0 if hand is None else np.where(hand[box], np.int32(pose_score.HAND), np.int32(0))
        rows, columns = box
        here["rows"], here["columns"] = (rows.start, rows.stop), (columns.start, columns.stop)
        area = (rows.stop - rows.start) * (columns.stop - columns.start)
        here["step"] = max(1, round(float(np.sqrt(area / REFINER.max_pixels))))
        if table is not None:
            here["plane"] = table
            near_points.leave_out_plane((self.camera.rays, self._depth, self._labels), self._window)
