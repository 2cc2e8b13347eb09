"""A camera's rays and pixels: a pinhole behind a lens, with the polynomials of OpenCV and ROS' CameraInfo.

Optical frame: x right, y down, z forward. A ray is (x/z, y/z); pixel centres are at whole numbers.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.vec3 import Vec3

PASSES = 60
TOLERANCE = 1e-9
"""Most steps of the fixed-point iteration to a ray, and the error of its slopes at which it has converged."""


@inner
def lens(camera: Any, x: float, y: float) -> tuple[float, float]:
    """Returns the slopes of a ray behind the lens: plumb_bob (k4 to k6 are 0) or rational polynomial."""
    k = camera.lens
    r2 = x * x + y * y
    p1, p2 = k[2], k[3]
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    slope_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    return slope_x, y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)


@inner
def whole(place: float) -> int:
    """Returns the number of the pixel or cell that a place is in, by its middle: -1 is left of the first."""
    return int(np.floor(place + 0.5))


@inner
def project(camera: Any, point: Vec3) -> tuple[float, float]:
    """Returns column and row of a point in the camera; NaN behind it, or where the lens is not known."""
    if not point[2] > 0:
        return np.nan, np.nan
    x, y = point[0] / point[2], point[1] / point[2]
    if x * x + y * y > camera.reach2:
        return np.nan, np.nan
    x, y = lens(camera, x, y)
    return camera.fx * x + camera.cx, camera.fy * y + camera.cy


@entry
def rays(camera: Any, out: Any) -> float:
    """Fills in the ray of each pixel, `out` (h, w, 2), NaN where the lens leads none; returns the largest squared
    slope."""
    steepest = 0.0
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            bent_x, bent_y = (u - camera[0].cx) / camera[0].fx, (v - camera[0].cy) / camera[0].fy
            x = bent_x
            y = bent_y
            left = np.inf
            for _ in range(PASSES):
                now_x, now_y = lens(camera[0], x, y)
                left = max(abs(now_x - bent_x), abs(now_y - bent_y))
                if left < TOLERANCE:
                    break
                x, y = x - (now_x - bent_x), y - (now_y - bent_y)
            if left < TOLERANCE:
                out[v, u, 0], out[v, u, 1] = x, y
                steepest = max(steepest, x * x + y * y)
            else:
                out[v, u, 0], out[v, u, 1] = np.nan, np.nan
    return steepest


@entry
def pixels_of(camera: Any, points: Any, out: Any) -> None:
    """Fills in column and row `out` (n, 2) of points (n, 3) in the camera, NaN where they are out of view."""
    for n in range(len(points)):
        out[n, 0], out[n, 1] = project(camera[0], (points[n, 0], points[n, 1], points[n, 2]))
