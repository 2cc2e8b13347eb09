"""The distance from a surface that is made of many patches, each of them a quadric.

A patch is the surface F = 0 in a frame of its own, F = z + H z²/2 + (a u² + 2 b uv + c v²)/2, with z along its normal.
(a, b, c) are the second derivatives of its distance, the `bends`, positive where it is convex; H is chosen so that
planes, cylinders and balls are exact at any distance.
"""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import Vec3, add, dot, norm, scale, sub, vector
from handsight._kernels.runtime.compilation import entry, inner

PATCH = np.dtype([
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("along", "f8", (2, 3)),
    ("bends", "f8", (3,)),
    ("bend", "f8"),  # H
    ("covariance", "f8", (6, 6)),  # of height, slopes and bends
    ("spread", "f8"),  # variance of the residuals: their squares over the degrees of freedom [m²]
    ("window", "f8"),  # radius of the widest window that it was fitted in [m]
    ("fits", "i8"),  # how many windows it was fitted in
    ("ended", "i8"),  # whether a wider window is not of one surface any more
    ("trust", "f8"),  # its weight among others, beside that by its distance
], align=True)  # fmt: skip


@inner
def gradient(patch: Any, u: float, v: float, z: float) -> Vec3:
    """Returns the gradient of F along the object's axes, at a point (u, v, z) of the patch's frame."""
    n, a, b = vector(patch.normal), vector(patch.along[0]), vector(patch.along[1])
    by_u = patch.bends[0] * u + patch.bends[1] * v
    by_v = patch.bends[1] * u + patch.bends[2] * v
    return add(scale(n, 1 + patch.bend * z), add(scale(a, by_u), scale(b, by_v)))


@inner
def level_set(patch: Any, u: float, v: float, z: float) -> float:
    """Returns F at a point (u, v, z) of the patch's frame."""
    q = patch.bends[0] * u * u + 2 * patch.bends[1] * u * v + patch.bends[2] * v * v
    return z + 0.5 * (patch.bend * z * z + q)


@entry
def blended(patches: Any, spacing: float, around: Any, nearest: Any, nodes: Any, out: Any) -> None:
    """Writes to `out` (n, 4) the signed distance [m] of nodes (n, 3) from the surface, and the direction outwards.

    The distance from a patch is 2 F / (1 + √(1 + 2 H F)), exact for planes, cylinders and balls. It is averaged over
    the patches `around[nearest[j]]` (k,), the nearest first, weighted by how near they are and whether they face the
    way of the nearest: the far side of a thin wall and the other face of an edge do not count.
    """
    for j in range(len(nodes)):
        place, near2, total, weights, way = vector(nodes[j]), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
        ahead = vector(patches[nearest[j]].normal)
        for k in range(around.shape[1]):
            patch = patches[around[nearest[j], k]]
            offset = sub(place, vector(patch.point))
            away2 = dot(offset, offset)
            if k == 0:
                near2 = away2
            reach = 0.5 * np.sqrt(near2) + spacing
            facing = max(dot(vector(patch.normal), ahead), 0.0)
            w = np.exp((near2 - away2) / (2.5 * reach * reach)) * facing**4 * patch.trust
            u, v = dot(vector(patch.along[0]), offset), dot(vector(patch.along[1]), offset)
            z = dot(vector(patch.normal), offset)
            off = level_set(patch, u, v, z)
            way = add(way, scale(gradient(patch, u, v, z), w))
            total += w * 2 * off / (1 + np.sqrt(max(1 + 2 * patch.bend * off, 0.0)))
            weights += w
        out[j, 0] = total / weights
        out[j, 1], out[j, 2], out[j, 3] = way


@entry
def neighbours(points: Any, pairs: Any, patches: Any, window: float, sums: Any) -> None:
    """Adds to `sums` (4,) what tells whether neighbouring points share their noise.

    For all `pairs` (k, 2) of points (n, 3) that are both within `window` [m] of a patch: the product of their
    residuals [m²], the mean of their squares [m²], the points' distance [m], and 1.
    """
    residuals = np.empty(len(points))
    for k in range(len(patches)):
        patch = patches[k]
        for i in range(len(points)):
            offset = sub(vector(points[i]), vector(patch.point))
            residuals[i] = np.nan
            if dot(offset, offset) < window * window:
                u, v = dot(vector(patch.along[0]), offset), dot(vector(patch.along[1]), offset)
                residuals[i] = level_set(patch, u, v, dot(vector(patch.normal), offset))
        for i, j in pairs:
            product = residuals[i] * residuals[j]
            if product == product:
                sums[0] += product
                sums[1] += 0.5 * (residuals[i] ** 2 + residuals[j] ** 2)
                sums[2] += norm(sub(vector(points[i]), vector(points[j])))
                sums[3] += 1
