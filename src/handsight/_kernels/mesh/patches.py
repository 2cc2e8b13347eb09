"""A surface of many patches, each a quadric: how far a place is off them.

A patch is the surface F = 0 in a frame of its own, F = z + H z²/2 + (a u² + 2 b uv + c v²)/2. (a, b, c) are the bends
of its distance, outward positive; H is that which makes a plane, a cylinder and a ball exact, however far away.
"""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import Vec3, add, dot, norm, scale, sub, vector
from handsight._kernels.runtime.compilation import entry, inner

WIDE = 2.5
"""Of the square that patches are averaged over: half the distance to the nearest, and the spacing."""

PATCH = np.dtype(
    [
        ("point", "f8", (3,)),
        ("normal", "f8", (3,)),
        ("along", "f8", (2, 3)),
        ("bends", "f8", (3,)),
        ("bend", "f8"),  # H
        ("covariance", "f8", (6, 6)),  # of height, slopes and bends
        ("spread", "f8"),  # mean squared residual, freed of what the fit took away [m²]
        ("window", "f8"),
        ("fits", "i8"),  # windows so far
        ("ended", "i8"),
        ("trust", "f8"),  # its weight among others, beside its distance
    ],
    align=True,
)


@inner
def gradient(patch: Any, u: float, v: float, z: float) -> Vec3:
    """Returns the gradient of F at a point of the patch's frame, along the object's axes."""
    n, a, b = vector(patch.normal), vector(patch.along[0]), vector(patch.along[1])
    by_u = patch.bends[0] * u + patch.bends[1] * v
    by_v = patch.bends[1] * u + patch.bends[2] * v
    return add(scale(n, 1 + patch.bend * z), add(scale(a, by_u), scale(b, by_v)))


@inner
def level_set(patch: Any, u: float, v: float, z: float) -> float:
    """Returns F at a point of the patch's frame."""
    q = patch.bends[0] * u * u + 2 * patch.bends[1] * u * v + patch.bends[2] * v * v
    return z + 0.5 * (patch.bend * z * z + q)


@entry
def blended(patches: Any, spacing: float, around: Any, nearest: Any, nodes: Any, out: Any) -> None:
    """Fills `out` (n, 4), of nodes (n, 3) the signed distance [m] to the average of patches, and the way outwards.

    Averaged are those `around` (m, k) the `nearest` (n,); 2 F / (1 + √(1 + 2 H F)) is the distance to a plane, cylinder
    and ball. Of the nearest first: the far side of a thin wall and the other face of an edge have no say.
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
            w = np.exp((near2 - away2) / (WIDE * reach * reach)) * facing**4 * patch.trust
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
    """Adds to `sums` (4,): of pairs (k, 2) of points (n, 3) in one window of a patch, products of their residuals [m²],
    mean squares of these [m²], distances [m], how many.
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


def warm() -> None:
    """Compiles every kernel, or loads it."""
    patches, one = np.zeros(1, dtype=PATCH), np.zeros((1, 3))
    patches["normal"], patches["trust"] = [0.0, 0.0, 1.0], 1.0
    index = np.zeros(1, dtype=np.int64)
    blended(patches, 1.0, index[:, None], index, one, np.empty((1, 4)))
    neighbours(one, index[:, None].repeat(2, axis=1), patches, 1.0, np.zeros(4))
