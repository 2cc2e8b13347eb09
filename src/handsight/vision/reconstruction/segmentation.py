"""Where in a depth image an object without a model is: an object that stands on a table, or that a hand holds."""

from collections.abc import Mapping

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import ArrayLike

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array
from handsight.hand import Hand
from handsight.hand.chains import transform_points
from handsight.vision.object.region import MAX_RANGE, TABLE_WITHIN, scene_of, table_plane
from handsight.vision.palm.hand_appearance import skin_points
from handsight.vision.reconstruction.reconstruct import View, within

MIN_TABLE = 0.15  # a plane wider than this is a table [m]
MIN_PIXELS = 200  # of an object in its first view
SEGMENTATION_MARGIN = 0.03  # of the bounds around what the first view shows [m]
SEGMENTATION_BELOW = 0.02  # how far the bounds reach below a table [m]
MAX_EXTENT = 0.3  # no object is larger [m]
SKIN_POINTS = 12_000  # of a hand, on its palm some four millimetres apart
HAND_MARGIN = 0.005  # points nearer to the hand than this may be the hand's [m]
JOINT_SIGMAS = 3.0  # and so may points as near as the errors of its joints, in standard deviations
SEGMENTATION_NEIGHBOURS = 8  # of the hand's points that are compared

IN_HAND_BOUNDS = MAX_EXTENT / 2 * np.array([[-1.0, -1, -1], [1, 1, 1]])
"""Bounds of an object in the hand, about the middle of the fingertips [m]."""


def on_table(camera: Camera, depth: Depth) -> tuple[Array, Array] | None:
    """Returns T_camera_object (4, 4) and bounds (2, 3) [m] of what stands on a table nearest to the image's middle. Its
    frame has z up from the table, and the origin on it. None where there is no table, or nothing on it."""
    plane = table_plane(camera, depth, np.ones(depth.shape, dtype=bool), extent=MIN_TABLE)
    if plane is None:
        return None
    scene = scene_of(camera, depth, table=plane)
    big = np.flatnonzero(scene.sizes >= MIN_PIXELS)
    rows, columns = np.nonzero(np.isin(scene.labels, big))
    if not len(rows):
        return None
    off = np.hypot(rows - depth.shape[0] / 2, columns - depth.shape[1] / 2)
    nearest = off.argmin()
    part = scene.labels[rows[nearest], columns[nearest]]
    points = camera.points(depth)[scene.labels == part].astype(np.float64)
    z = plane[:3]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    x = np.cross(z, [0.0, 0, 1]) if abs(z[2]) < 0.9 else np.cross(z, [0.0, 1, 0])
    x /= np.linalg.norm(x)
    T = se3.compose(np.column_stack([x, np.cross(z, x), z]), middle - (z @ middle + plane[3]) * z)
    there = se3.apply(se3.inverse(T), points)
    # Behind the visible part there is as much again.
    reach = float(np.linalg.norm(there[:, :2], axis=1).max())
    side = min(1.5 * reach + SEGMENTATION_MARGIN, MAX_EXTENT / 2)
    top = min(float(there[:, 2].max()) + SEGMENTATION_MARGIN, MAX_EXTENT)
    return T, np.array([[-side, -side, -SEGMENTATION_BELOW], [side, side, top]])


def without_table(camera: Camera, depth: Depth) -> Depth:
    """Returns a depth image (h, w) [m] in which what lies on or behind its widest plane is far away. What a hand holds
    is in front of it. Planes that are no wider than an object may be its own."""
    plane = table_plane(camera, depth, depth > 0, extent=MAX_EXTENT)
    if plane is None:
        return depth
    points = camera.points(depth)
    with np.errstate(invalid="ignore"):
        behind = points @ plane[:3] + plane[3] < TABLE_WITHIN * np.maximum(points[..., 2] ** 2, 1)
    return np.where(behind, np.float32(MAX_RANGE), depth).astype(np.float32)


class InHandView:
    """Takes the hand out of depth images of it and the object that it holds."""

    def __init__(self, hand: Hand, sigma_joint: ArrayLike) -> None:
        """`sigma_joint`: constant error of a joint [rad, slides: m], or errors (j, m) as `Rig.joint_errors` has them.
        Raises InvalidInput for a hand without shapes."""
        self._chains = hand.shape().chains
        self._joint_errors = self._chains.errors(sigma_joint)
        self._points, _, self._bodies = skin_points(hand, SKIN_POINTS)
        self.joints = {*self._chains.joints, *hand.joint_names}
        """The joints whose positions it needs."""

    def without_hand(
        self, camera: Camera, depth: Depth, joint_positions: Mapping[str, float], T_camera_palm: Array
    ) -> Depth:
        """Returns a depth image (h, w) [m] with 0 for all points as near to the hand as the errors of its joints. Those
        of the object that the hand touches are among them: a piece of a finger in a model is worse than a hole."""
        Ts, axes = self._chains.poses(joint_positions)
        skin = transform_points(self._points, self._bodies, Ts)
        by_error = self._chains.jacobians(skin, self._bodies, axes, self._joint_errors)[:, :3]
        slack = HAND_MARGIN + JOINT_SIGMAS * np.linalg.norm(by_error, axis=(1, 2))
        bounds = np.stack([skin.min(axis=0) - slack.max(), skin.max(axis=0) + slack.max()])
        near = within(camera, View(depth, T_camera_palm), bounds)
        points = se3.apply(se3.inverse(T_camera_palm), camera.points(depth)[near].astype(np.float64))
        gap, which = scipy.spatial.cKDTree(skin).query(points, k=SEGMENTATION_NEIGHBOURS)
        near[near] = (gap < slack[which]).any(axis=1)
        return np.where(near, np.float32(0), depth)
