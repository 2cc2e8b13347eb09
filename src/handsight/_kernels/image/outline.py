"""Whether the visible surface ends where an object at a pose ends.

A pose that slid onto a wall, a table or a bigger object fits all that is visible of it, but the surface goes on past
its outline. Where the object truly is, what is beside it lies behind it, hides it, or touches it at a crease.
"""

from typing import Any

import numpy as np

from handsight._kernels.image.depth_image import point_at
from handsight._kernels.image.depth_term import is_far
from handsight._kernels.image.pinhole import project
from handsight._kernels.image.pose_score import POSE_SCORE
from handsight._kernels.image.vision_records import OUT
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import Vec3, apply, apply_inverse, dot, mul, norm, scale, sub, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import entry, inner

BESIDE = 0.06
"""Distance from the surface up to which points beside it are compared with it [diameters]."""
INSIDE = 2.0
"""From the outline to the visible surface that they are compared with, where one pose is followed [pixels]."""


@inner
def _beside(
    camera: Any, surface: Any, image: Any, at: tuple[Any, Vec3, float, float], pixel: tuple[int, int, int]
) -> int:
    """Returns 1 for a pixel beside an object that continues its explained surface, -1 for one behind that, else 0.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m] and labels (h, w). at: the object's pose,
    its centre, the bound within which it explains a point, and how far inside of its outline the surface is that points
    beside it are compared with [pixels]. pixel: row, column, the least label that counts.
    """
    (model, nodes), (rays, depth, labels) = surface, image
    pose, center, bound, inset = at
    v, u, least = pixel
    if not depth[v, u] > 0 or labels[v, u] < least:
        return 0
    P, beside = point_at(rays, depth, v, u), bound + BESIDE * 2 * model[0].radius
    if is_far(P, center, model[0].radius, beside):
        return 0
    distance, gradient, _ = field_at(nodes, model[0].fine, apply_inverse(pose, P))
    if not bound < distance < beside:
        return 0
    # A pixel a little inside of the outline: past the surface's point that is nearest.
    g = mul(pose[0], gradient)
    x, y = project(camera[0], sub(P, scale(g, distance / max(norm(g), 1e-9))))
    length = ((x - u) ** 2 + (y - v) ** 2) ** 0.5
    if not length > 0.5:
        return 0
    x, y = x + inset * (x - u) / length + 0.5, y + inset * (y - v) / length + 0.5
    if not (0 <= x < depth.shape[1] and 0 <= y < depth.shape[0]):
        return 0
    row, column = int(y), int(x)
    if not depth[row, column] > 0 or labels[row, column] < least:
        return 0
    Q = point_at(rays, depth, row, column)
    inside, gradient, _ = field_at(nodes, model[0].fine, apply_inverse(pose, Q))
    normal = mul(pose[0], gradient)
    if not (abs(inside) < bound and dot(normal, Q) < -0.1 * norm(Q)):
        return 0
    off = dot(normal, sub(P, Q))
    return 1 if abs(off) < bound else -1 if off < 0 else 0


@entry
def find_continued(camera: Any, surface: Any, image: Any, window: Any, candidates: Any) -> None:
    """Fills in `unexplained` of CANDIDATE (k,): the pixels beside each that continue its explained surface, less those
    that are behind it.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m] and labels (h, w). window: WINDOW (1,).
    Pixels of the hand do not count.
    """
    here = window[0]
    step = 2 * here.step
    for k in range(len(candidates)):
        pose, count = pose_of(candidates[k].pose), 0
        at = pose, apply(pose, vector(surface[0][0].center)), candidates[k].bound, INSIDE
        for v in range(here.rows[0], here.rows[1], step):
            for u in range(here.columns[0], here.columns[1], step):
                count += _beside(camera, surface, image, at, (v, u, OUT))
        candidates[k].unexplained = max(count, 0) * step**2


@entry
def follow_outlines(camera: Any, surface: Any, image: Any, most: int, candidates: Any) -> None:
    """Fills in `unexplained` of CANDIDATE (k,) that are scored, the expected pixels times the share of the outline at
    which the surface goes on, and subtracts it from the score.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m] and labels (h, w), of which only segments,
    from 0 on, count; about so many pixels around the object are taken, evenly.
    """
    (height, width), model = image[1].shape, surface[0]
    for k in range(len(candidates)):
        candidate = candidates[k]
        pose, bound, count = pose_of(candidate.pose), candidate.bound, 0
        center, beside = apply(pose, vector(model[0].center)), BESIDE * 2 * model[0].radius
        reach = 1.2 * model[0].radius + bound + beside
        u0, v0 = project(camera[0], center)
        candidate.unexplained = 0.0
        if not abs(u0 * v0) < np.inf:
            continue
        half = min(reach * camera[0].fx / max(center[2] - 0.5 * reach, 0.1 * center[2]), width + height)
        left, right = int(max(u0 - half, 0.0)), int(min(u0 + half, width - 1.0))
        top, bottom = int(max(v0 - half, 0.0)), int(min(v0 + half, height - 1.0))
        step = max(1, int(np.sqrt(max(right - left, 0) * max(bottom - top, 0) / most)))
        at = pose, center, bound, bound * camera[0].fx / center[2]
        for v in range(top, bottom + 1, step):
            for u in range(left, right + 1, step):
                count += _beside(camera, surface, image, at, (v, u, 0)) > 0
        # As if its silhouette were square.
        outline = 4 * np.sqrt(max(candidate.expected, 1.0)) * beside * camera[0].fx / center[2]
        candidate.unexplained = candidate.expected * min(count * step * step / outline, 1.0)
        size = max(candidate.expected, POSE_SCORE.min_expected)
        candidate.score -= POSE_SCORE.unexplained * candidate.unexplained / size**POSE_SCORE.size_exponent
