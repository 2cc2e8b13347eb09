"""Whether the observed surface goes on where an object at a pose ends.

A pose that lays a small box onto the face of a larger one explains all its pixels, and no camera sees past it. What
contradicts it is beside its outline: there the face goes on in the same plane. A neighbour that touches an object does
not do that, because between both is a crease or a step.
"""

from typing import Any

import numpy as np

from handsight._kernels.image.pinhole import project
from handsight._kernels.image.pose_score import POSE_SCORE
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import Vec3, apply, apply_inverse, dot, mul, norm, scale, sub, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import entry, inner

WIDTH = 0.05
"""How far beyond an object's bound the surface is followed [diameters]."""
MAX_PIXELS = 1500
"""Pixels of the image around an object that are taken, evenly."""
MIN_COSINE = 0.1
"""Least cosine between the surface's normal and the direction to the camera for the surface to be followed."""


@inner
def _point(image: Any, u: int, v: int) -> Vec3:
    """Returns the point of a pixel [m]; image: rays (h, w, 2), depth (h, w) [m], labels (h, w)."""
    z = image[1][v, u]
    return image[0][v, u, 0] * z, image[0][v, u, 1] * z, z


@inner
def _goes_on(camera: Any, image: Any, surface: Any, at: tuple[Any, float], pixel: tuple[int, int], P: Vec3) -> bool:
    """Returns whether a pixel's point P continues the surface of an object that ends beside it.

    at: the object's pose, and the bound within which it explains a point. The next pixel that it explains on the way
    from P to the nearest point of its surface must be of a segment, and have a tangent plane that P lies in, and so
    must the pixel half way.
    """
    (pose, bound), (u, v), labels = at, pixel, image[2]
    distance, gradient, _ = field_at(surface[0], surface[1], apply_inverse(pose, P))
    if not bound < distance < bound + WIDTH * surface[2]:
        return False
    u_near, v_near = project(camera, sub(P, scale(mul(pose[0], gradient), distance / max(norm(gradient), 1e-9))))
    length = np.hypot(u_near - u, v_near - v)
    if not length > 1:  # it is in front of the object or behind it
        return False
    further = 1 + bound * camera.fx / P[2] / length
    u1, v1 = int(u + further * (u_near - u) + 0.5), int(v + further * (v_near - v) + 0.5)
    if not (0 <= u1 < labels.shape[1] and 0 <= v1 < labels.shape[0]) or labels[v1, u1] < 0:
        return False
    inside, half_way = _point(image, u1, v1), _point(image, (u + u1) // 2, (v + v1) // 2)
    distance, gradient, _ = field_at(surface[0], surface[1], apply_inverse(pose, inside))
    normal = mul(pose[0], gradient)
    if abs(distance) > bound or dot(normal, inside) > -MIN_COSINE * norm(inside):
        return False
    off, off_half_way = dot(normal, sub(P, inside)), dot(normal, sub(half_way, inside))
    return abs(off) < bound and (abs(off_half_way) < bound or half_way[2] == 0)


@entry
def follow_outlines(camera: Any, image: Any, model: Any, nodes: Any, diameter: float, candidates: Any) -> None:
    """Fills in `unexplained` of CANDIDATE (k,) that are scored, the expected pixels times the share of the outline at
    which the surface goes on, and subtracts it from the score.

    image: rays (h, w, 2), depth (h, w) [m] and labels (h, w), of which only segments, from 0 on, count.
    """
    height, width = image[1].shape
    surface = nodes, model[0].fine, diameter
    for k in range(len(candidates)):
        candidate = candidates[k]
        pose, bound, count = pose_of(candidate.pose), candidate.bound, 0
        center, reach = apply(pose, vector(model[0].center)), 1.2 * model[0].radius + bound + WIDTH * diameter
        u0, v0 = project(camera[0], center)
        candidate.unexplained = 0.0
        if not u0 * v0 < np.inf:
            continue
        half = min(reach * camera[0].fx / max(center[2] - 0.5 * reach, 0.1 * center[2]), width + height)
        left, right = int(max(u0 - half, 0.0)), int(min(u0 + half, width - 1.0))
        top, bottom = int(max(v0 - half, 0.0)), int(min(v0 + half, height - 1.0))
        step = max(1, int(np.sqrt(max(right - left, 0) * max(bottom - top, 0) / MAX_PIXELS)))
        for v in range(top, bottom + 1, step):
            for u in range(left, right + 1, step):
                if image[2][v, u] >= 0:
                    P = _point(image, u, v)
                    way = sub(P, center)
                    if dot(way, way) < reach * reach and _goes_on(
                        camera[0], image, surface, (pose, bound), (u, v), P
                    ):
                        count += step * step
        # As if it were square.
        outline = 4 * np.sqrt(max(candidate.expected, 1.0)) * WIDTH * diameter * camera[0].fx / center[2]
        candidate.unexplained = candidate.expected * min(count / outline, 1.0)
        size = max(candidate.expected, POSE_SCORE.min_expected)
        candidate.score -= POSE_SCORE.unexplained * candidate.unexplained / size**POSE_SCORE.size_exponent
