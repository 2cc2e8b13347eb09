"""What points of a depth image say of a pose, and how far the errors that they share may pull it.

A point P of weight w on a surface of normal n adds w l lᵀ to the information of the pose, with l = (n, (P - c)/r × n)
by (δp, r δθ) about a centre c. An error e of its depth moves the point along its ray by e P/z, which pulls the pose by
e w (n·P)/z l. The errors of different points are correlated, and so is their pull.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Frame
from handsight._kernels.math.vec3 import cross, dot, scale, sub, vector
from handsight._kernels.runtime.compilation import entry, inner


@inner
def inform(
    weights: Any, points: Any, normals: Any, frame: Frame, error: Any, compared: int, out: Any
) -> None:
    """Fills `out` (2, 6, 6) with the information of points of a unit variance, and the covariance of their summed pull.

    weights (m,), points and normals (m, 3) in the camera; frame: centre and radius; error: DEPTH_ERROR. What neighbours
    share is summed over the pairs of the first `compared` points, and scaled to all pairs.
    """
    center, radius = frame
    count = len(weights)
    few = min(count, compared)
    pulls, total, shared = np.empty((few, 6)), np.zeros(6), np.empty(6)
    out[:] = 0.0
    for n in range(count):
        P, normal = vector(points[n]), vector(normals[n])
        lever = normal + cross(scale(sub(P, center), 1 / radius), normal)
        pull = weights[n] * dot(normal, P) / P[2]
        for i in range(6):
            total[i] += pull * lever[i]
            if n < few:
                pulls[n, i] = pull * lever[i]
            for j in range(6):
                out[0, i, j] += weights[n] * lever[i] * lever[j]
                out[1, i, j] += (error.own + error.shared + error.smooth) * pull * lever[i] * pull * lever[j]
    for i in range(6):
        for j in range(6):
            out[1, i, j] += error.offset * total[i] * total[j]
    pairs = count * (count - 1) / max(few * (few - 1), 1)
    for n in range(few):
        shared[:] = 0.0
        for m in range(n):
            du = points[n, 0] / points[n, 2] - points[m, 0] / points[m, 2]
            dv = points[n, 1] / points[n, 2] - points[m, 1] / points[m, 2]
            distance2 = du * du + dv * dv
            covariance = pairs * (
                error.shared * np.exp(-distance2 * error.shared_decay)
                + error.smooth * np.exp(-distance2 * error.smooth_decay)
            )
            for i in range(6):
                shared[i] += covariance * pulls[m, i]
        for i in range(6):
            for j in range(6):
                out[1, i, j] += pulls[n, i] * shared[j] + shared[i] * pulls[n, j]


@entry
def inform_points(
    weights: Any, points: Any, normals: Any, center: Any, radius: float, error: Any, compared: int, out: Any
) -> None:
    """Fills `out` (2, 6, 6) as `inform` does; center (3,) in the camera, error: DEPTH_ERROR (1,)."""
    inform(weights, points, normals, (vector(center), radius), error[0], compared, out)
