"""Where in a depth image an object is that nobody has a model of yet: what stands on a table."""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.vision.camera import Depth, PinholeCamera
from handsight.vision.region import scene_of, table_plane

TABLE_EXTENT = 0.15
"""What is wider [m] and flat is a table."""
LEAST_PIXELS = 200
"""Of an object in its first view."""
MARGIN, BELOW, LARGEST = 0.03, 0.02, 0.3
"""Around what the first view shows, and below a table [m]; nothing is taken to be larger than the last."""


def on_table(camera: PinholeCamera, depth: Depth) -> tuple[Array, Array] | None:
    """T_camera_object (4, 4) and bounds (2, 3) [m] of what stands on a table nearest to the image's middle.

    Its frame: z up from the table, the origin on it. None where no table is seen, or nothing on it.
    """
    everywhere = np.ones(depth.shape, dtype=bool)
    plane = table_plane(camera, depth, everywhere, extent=TABLE_EXTENT)
    if plane is None:
        return None
    scene = scene_of(camera, depth, wanted=everywhere, table=plane)
    rows, columns = np.nonzero(scene.labels >= 0)
    big = scene.sizes[scene.labels[rows, columns]] >= LEAST_PIXELS
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
    side = min(1.5 * float(np.linalg.norm(there[:, :2], axis=1).max()) + MARGIN, LARGEST / 2)
    top = min(float(there[:, 2].max()) + MARGIN, LARGEST)
    return T, np.array([[-side, -side, -BELOW], [side, side, top]])
