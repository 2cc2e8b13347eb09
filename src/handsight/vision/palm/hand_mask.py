"""Which pixels of a depth image are the hand's: its links are drawn at the measured joint positions."""

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask

AROUND, SLACK = 3, 0.012
"""Margins for joints that are off by a degree: around the drawn links [pixels], in front and behind [m]."""


def hand_mask(
    camera: Camera,
    depth: Depth,
    vertices_palm: Array,
    faces: Indices,
    T_camera_palm: Array,
    slack: float = SLACK,
) -> Mask:
    """Returns (h, w) whether a pixel of a depth image (h, w) [m] is the hand's.

    The hand is triangles `faces` (m, 3) of vertices (k, 3) [m]. What is in front of it is not masked: it may be the
    object.
    """
    drawn = camera.draw(se3.apply(T_camera_palm, vertices_palm), faces).depth
    rows, columns = np.nonzero(np.isfinite(drawn))
    mask = np.zeros(depth.shape, dtype=bool)
    if not len(rows):
        return mask
    box = tuple(slice(max(r.min() - AROUND, 0), r.max() + AROUND + 1) for r in (rows, columns))
    size, near = 2 * AROUND + 1, drawn[box]
    far = np.where(np.isfinite(near), near, -np.inf)
    nearest = minimum_filter(near, size=size, mode="constant", cval=np.inf)
    farthest = maximum_filter(far, size=size, mode="constant", cval=-np.inf)
    mask[box] = (nearest - slack < depth[box]) & (depth[box] < farthest + slack)
    return mask
