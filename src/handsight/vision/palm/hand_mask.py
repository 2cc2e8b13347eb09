"""Which pixels of a depth image are the hand's: its links are drawn where the robot believes them to be."""

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask

AROUND, SLACK = 3, 0.012
"""How far joints wrong by a degree move a link: around what is drawn [pixels], before and behind it [m]."""


def hand_mask(
    camera: Camera,
    depth: Depth,
    vertices_palm: Array,
    faces: Indices,
    T_camera_palm: Array,
    slack: float = SLACK,
) -> Mask:
    """Returns (h, w) whether a pixel is the hand's. What is in front of the hand is not: the object may be."""
    drawn = camera.draw(se3.apply(T_camera_palm, vertices_palm), faces).depth
    rows, columns = np.nonzero(np.isfinite(drawn))
    mask = np.zeros(depth.shape, dtype=bool)
    if not len(rows):
        return mask
    box = tuple(slice(max(r.min() - AROUND, 0), r.max() + AROUND + 1) for r in (rows, columns))
    size, there = 2 * AROUND + 1, drawn[box]
    near = minimum_filter(there, size=size, mode="constant", cval=np.inf)
    far = maximum_filter(
        np.where(np.isfinite(there), there, -np.inf), size=size, mode="constant", cval=-np.inf
    )
    mask[box] = (near - slack < depth[box]) & (depth[box] < far + slack)
    return mask
