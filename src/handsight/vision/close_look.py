"""A look at a depth image near where an object is expected: what is there settles its pose, and is judged."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels import depth_term, look_score, near_points, pinhole
from handsight._kernels.sight_records import LOOK, SEEN, WINDOW
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.vision.appearance import appearance_of
from handsight.vision.camera import Depth, PinholeCamera
from handsight.vision.covariance import pose_covariances
from handsight.vision.depth_noise import DepthNoise
from handsight.vision.first_pose import BOUND, SIGMAS, depths, poses_of
from handsight.vision.region import TABLE_WITHIN

WITHIN, MARGIN = 0.12, 0.15
"""Of the expected surface, for a point to count, and what is looked at around its silhouette [diameters]."""
MOST_POINTS, MOST_LOOKED_AT = 400, 2000
"""Points that settle a pose, and pixels of the window that they are chosen from."""
THIN = 12
"""Every so manieth of them does for the covariance."""
RUNGS = ((False, 0.12, 0.05, 4), (True, 0.05, 0.0, 3))
"""Whether on the fine field, Tukey's bound at first and at last [diameters], steps."""
ONE_PART = np.zeros(1)


class Looked(NamedTuple):
    """What depth alone says."""

    T_camera_object: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) of (δp, δθ) of the object's origin along the camera's axes."""
    look: NDArray[np.void]
    """LOOK (1,)"""
    points: int
    """On the surface, or nearly."""


class CloseLook:
    """Looks at one object, image by image; it keeps room for the part of an image that it looks at."""

    def __init__(self, model: ObjectModel, camera: PinholeCamera, noise: DepthNoise) -> None:
        """`noise`: of the camera's depth."""
        self.model, self.camera, self.noise = model, camera, noise
        self._appearance = appearance_of(model)
        self._depth = np.zeros(camera.size[::-1], dtype=np.float32)
        self._labels = np.full(camera.size[::-1], look_score.OUT, dtype=np.int32)
        self._window = np.zeros(1, dtype=WINDOW)
        self._window["within"], self._window["plane_within"] = WITHIN * model.diameter, TABLE_WITHIN
        self._seen = np.zeros(MOST_POINTS, dtype=SEEN)

    def at(self, T_expected: Array, depth: Depth, hand: Mask | None, table: Array | None) -> Looked:
        """The pose that depth (h, w) settles, from the expected one on; the hand's pixels and the table left out."""
        look = np.zeros(1, dtype=LOOK)
        look["pose"]["rotation"], look["pose"]["position"] = T_expected[:3, :3], T_expected[:3, 3]
        model, nodes = self.model.record[:2]
        self._show(self._around(T_expected), depth, hand, table)
        image = self.camera.rays, self._depth, self._labels
        count = near_points.near_points((model, nodes), image, self._window, look, self._seen)
        seen, D = self._seen[:count], self.model.diameter
        look["bound"] = np.maximum(BOUND, SIGMAS * self.noise.sigma(depths(self.model, look)))
        for fine, first, last, steps in RUNGS:
            rung = np.array([fine, first * D, last * D, steps])
            depth_term.settle_all(model, nodes, seen, rung, look)
        limits = np.array([self._appearance.sample_area, BOUND, *self.model.center_object])
        look_score.score_all(self.camera.record, image[1:], self._appearance.sides, ONE_PART, limits, look)
        some = np.ascontiguousarray(seen[::THIN])
        covariance = pose_covariances(self.model, self.camera, some, look, self.noise)[0]
        return Looked(poses_of(look)[0], covariance, look, count)

    def _around(self, T: Array) -> tuple[slice, slice]:
        """Rows and columns around the object's silhouette; empty where it is out of the picture."""
        points = se3.apply(T, self.model.points_object)
        pixels = np.empty((len(points), 2))
        pinhole.pixels_of(self.camera.record, points, pixels)
        pixels = pixels[np.isfinite(pixels[:, 0])]
        if not len(pixels):
            return slice(0, 0), slice(0, 0)
        focal = self.camera.matrix[0, 0]
        margin = 1 + MARGIN * self.model.diameter * focal / max(points[:, 2].min(), MARGIN)
        low, high = pixels.min(axis=0) - margin, pixels.max(axis=0) + margin
        first, past = (np.clip(at, 0, self.camera.size).astype(int) for at in (low, high + 1))
        return slice(first[1], past[1]), slice(first[0], past[0])

    def _show(self, box: tuple[slice, slice], depth: Depth, hand: Mask | None, table: Array | None) -> None:
        """Takes the image's box over, and forgets the last one's."""
        here = self._window[0]
        last = slice(*here["rows"]), slice(*here["columns"])
        self._depth[last], self._labels[last] = 0, look_score.OUT
        self._depth[box] = depth[box]
        self._depth[box][~np.isfinite(self._depth[box])] = 0
        self._labels[box] = 0
        if hand is not None:
            self._labels[box][hand[box]] = look_score.HAND
        rows, columns = box
        here["rows"], here["columns"] = (rows.start, rows.stop), (columns.start, columns.stop)
        area = (rows.stop - rows.start) * (columns.stop - columns.start)
        here["step"] = max(1, round(float(np.sqrt(area / MOST_LOOKED_AT))))
        if table is not None:
            here["plane"] = table
            near_points.leave_out_plane((self.camera.rays, self._depth, self._labels), self._window)
