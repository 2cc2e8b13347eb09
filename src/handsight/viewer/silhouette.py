"""What a camera would see of an object alone."""

import numpy as np
from scipy.ndimage import binary_dilation

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array
from handsight.objects import ObjectModel

CLOUD, DOT = 6000, 2
"""Points by which an object without triangles is drawn, and pixels around each."""


def silhouette(camera: Camera, model: ObjectModel, T_camera_object: Array) -> Depth:
    """Returns what the camera would see of the object alone: depth (h, w) [m], infinite where it is not."""
    if len(model.faces):
        return camera.draw(se3.apply(T_camera_object, model.vertices), model.faces).depth
    points = se3.apply(T_camera_object, model.sample(CLOUD)[0])
    depth = np.full(camera.size[::-1], np.inf, dtype=np.float32)
    pixels = camera.project(points)
    inside = np.isfinite(pixels).all(axis=1) & (pixels > -0.5).all(axis=1)
    inside &= (pixels < np.array(camera.size) - 0.5).all(axis=1)
    u, v = np.round(pixels[inside]).astype(int).T
    np.minimum.at(depth, (v, u), points[inside, 2].astype(np.float32))
    grown = binary_dilation(np.isfinite(depth), iterations=DOT)
    return np.where(grown & ~np.isfinite(depth), np.float32(points[:, 2].mean()), depth)
