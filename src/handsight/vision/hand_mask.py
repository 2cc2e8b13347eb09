"""Which pixels of a depth image are the hand's: its links are drawn where the robot believes them to be."""

import numpy as np
from scipy.ndimage import maximum_filter

from handsight import se3
from handsight.checks import Array, Indices, Mask
from handsight.vision.camera import Depth, PinholeCamera

AROUND, SLACK = 3, 0.012
"""Pixels around what is drawn [pixels], and depth behind it [m], that joints wrong by a degree move a link."""


def hand_mask(
    camera: PinholeCamera,
    depth: Depth,
    vertices_palm: Array,
    faces: Indices,
    T_camera_palm: Array,
    slack: float = SLACK,
) -> Mask:
    """(h, w) whether a pixel is the hand's, or in front of it."""
    drawn = camera.draw(se3.apply(T_camera_palm, vertices_palm), faces).depth
    behind = np.where(np.isfinite(drawn), drawn, 0)
    rows, columns = np.nonzero(behind)
    mask = np.zeros(depth.shape, dtype=bool)
    if not len(rows):
        return mask
    box = tuple(slice(max(r.min() - AROUND, 0), r.max() + AROUND + 1) for r in (rows, columns))
    far = maximum_filter(behind[box], size=2 * AROUND + 1)
    mask[box] = (far > 0) & (depth[box] < far + slack) & (depth[box] > 0)
    return mask
