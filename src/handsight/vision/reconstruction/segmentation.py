"""Where in a depth image an object is that nobody has a model of yet: what stands on a table, or what a hand holds."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight import se3
from handsight._kernels.math import chain
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.hand.surface import sample_by_area
from handsight.vision.object.region import scene_of, table_plane


class SegmentationOptions(NamedTuple):
    """`SegmentationOptions` are what of an image is the object."""

    min_table: float = 0.15  # what is wider and flat is a table [m]
    min_pixels: int = 200  # of an object in its first view
    margin: float = 0.03  # around what the first view shows [m]
    below: float = 0.02  # below a table [m]
    max_extent: float = 0.3  # nothing is taken to be larger [m]
    skin_points: int = 12_000  # of a hand, on its palm some four millimetres apart
    hand_margin: float = 0.005  # what is nearer to the hand may be the hand [m]
    joint_sigmas: float = 3.0  # and so may what is as far as its joints may move it, in standard deviations
    neighbours: int = 8  # of the hand's points that are compared


SEGMENTATION = SegmentationOptions()

IN_HAND_BOUNDS = SEGMENTATION.max_extent / 2 * np.array([[-1.0, -1, -1], [1, 1, 1]])
"""About the middle of the fingertips, of what a hand holds [m]."""


def on_table(camera: Camera, depth: Depth) -> tuple[Array, Array] | None:
    """Returns T_camera_object (4, 4) and bounds (2, 3) [m] of what stands on a table nearest to the image's middle.

    Its frame: z up from the table, the origin on it. None where no table is seen, or nothing on it.
    """
    everywhere = np.ones(depth.shape, dtype=bool)
    plane = table_plane(camera, depth, everywhere, extent=SEGMENTATION.min_table)
    if plane is None:
        return None
    scene = scene_of(camera, depth, wanted=everywhere, table=plane)
    rows, columns = np.nonzero(scene.labels >= 0)
    big = scene.sizes[scene.labels[rows, columns]] >= SEGMENTATION.min_pixels
    rows, columns = rows[big], columns[big]
    if not len(rows):
        return None
    off = np.hypot(rows - depth.shape[0] / 2, columns - depth.shape[1] / 2)
    part = scene.labels[rows[off.argmin()], columns[off.argmin()]]
    points = camera.points(depth)[scene.labels == part].astype(np.float64)
    z, middle = plane[:3], (points.min(axis=0) + points.max(axis=0)) / 2
    x = np.cross(z, [0.0, 0, 1]) if abs(z[2]) < 0.9 else np.cross(z, [0.0, 1, 0])
    x /= np.linalg.norm(x)
    T = se3.compose(np.column_stack([x, np.cross(z, x), z]), middle - (z @ middle + plane[3]) * z)
    there = se3.apply(se3.inverse(T), points)
    # Behind what is seen there is as much again.
    side = min(
        1.5 * float(np.linalg.norm(there[:, :2], axis=1).max()) + SEGMENTATION.margin,
        SEGMENTATION.max_extent / 2,
    )
    top = min(float(there[:, 2].max()) + SEGMENTATION.margin, SEGMENTATION.max_extent)
    return T, np.array([[-side, -side, -SEGMENTATION.below], [side, side, top]])


class InHandView:
    """An `InHandView` is what a hand holds, in depth images of both."""

    def __init__(self, hand: Hand, sigma_joint: float) -> None:
        """`sigma_joint`: of each joint, constant [rad, for slides m]. Raises InvalidInput for a hand without shapes."""
        self._shape, self._hand, self._sigma_joint = hand.shape(), hand, sigma_joint
        if not len(self._shape.faces):
            raise InvalidInput(f"hand: expected shapes of its links in {hand.file}, got none")
        corners, link = (
            self._shape.vertices_body[self._shape.faces],
            self._shape.body_of[self._shape.faces[:, 0]],
        )
        body, points, _ = sample_by_area(
            [corners[link == b] for b in range(len(self._shape.bodies))], SEGMENTATION.skin_points, 0
        )
        self._bodies: Indices = body.astype(np.int64)
        self._points = np.ascontiguousarray(points)

    def tells(self, joint_positions: Mapping[str, float] | None) -> bool:
        """Returns whether these are all joints that say where the hand is."""
        return (joint_positions or {}).keys() >= {*self._shape.joints, *self._hand.joint_names}

    def middle(self, joint_positions: Mapping[str, float]) -> Array:
        """Returns (3,) of the fingertips in the palm [m]."""
        return np.asarray(self._hand.Ts_palm_tip(joint_positions)[:, :3, 3].mean(axis=0))

    def without_hand(
        self,
        camera: Camera,
        depth: Depth,
        joint_positions: Mapping[str, float],
        T_camera_palm: Array,
    ) -> Depth:
        """Returns a depth image (h, w) [m] with 0 for all that is as near to the hand as its joints may be off.

        The object's, too, where it is touched: a piece of a finger in a model is worse than a hole.
        """
        Ts, axes = self._shape.chains.poses(joint_positions)
        skin = np.empty_like(self._points)
        chain.transform_points(self._points, self._bodies, Ts, skin)
        moves = self._shape.chains.jacobians(skin, self._bodies, axes)[:, :3]
        slack = SEGMENTATION.hand_margin + SEGMENTATION.joint_sigmas * self._sigma_joint * np.linalg.norm(
            moves, axis=(1, 2)
        )
        points = se3.apply(se3.inverse(T_camera_palm), camera.points(depth).reshape(-1, 3).astype(np.float64))
        low, high = skin.min(axis=0) - slack.max(), skin.max(axis=0) + slack.max()
        with np.errstate(invalid="ignore"):
            around = np.flatnonzero((depth.reshape(-1) > 0) & ((points > low) & (points < high)).all(axis=1))
        gap, which = cKDTree(skin).query(points[around], k=SEGMENTATION.neighbours)
        alone = depth.copy()
        alone.reshape(-1)[around[(gap < slack[which]).any(axis=1)]] = 0
        return alone
