"""Whether the visible surface ends where an object at a pose ends.

A pose that slid onto a wall, a table or a bigger object fits all that is visible of it, but the surface goes on past
its outline. Where the object truly is, what is beside it lies behind it, hides it, or touches it at a crease.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.pinhole import project, whole
from handsight._compiled.symmetry import pose_of
from handsight._compiled.vec3 import Vec3, apply, apply_inverse, dot, mul, norm, scale, sub, vector
from handsight.objects.kernels.field import field_at
from handsight.vision.kernels.depth_image import normal_at, point_at
from handsight.vision.kernels.depth_term import is_far
from handsight.vision.kernels.pose_score import POSE_SCORE

BESIDE = 0.06  # distance from the surface up to which points beside it are compared with it [diameters]

WAYS = 72
STEPS = 12
MARCHED = 24
"""Ways from an object's centre on which its outline is crossed, and most steps on each, and on the ray of a pixel."""
OUTSIDE = (4.0, 7.0)
WITHIN = 5.0
"""From the outline to the pixels beside it and on the object, between which the surface may be smooth [pixels]."""
FLAT = 0.7
COSINE = 0.9
UNSEEN = (0.1, 0.2)
"""Most bounds from each other's tangent planes and least cosine of smooth ones; weight and share of what is unseen."""


@inner
def _within(camera: Any, image: Any, pixel: Any, nearest: Vec3, inset: float) -> tuple[int, int]:
    """Returns row and column so far inside [pixels] of the outline that a pixel is beside; -1: none that counts."""
    (_, depth, labels), (v, u) = image, pixel
    x, y = project(camera[0], nearest)
    length = max(((x - u) ** 2 + (y - v) ** 2) ** 0.5, 1e-9)
    row, column = whole(y + inset * (y - v) / length), whole(x + inset * (x - u) / length)
    if not (length > 0.5 and 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return -1, -1
    return (row, column) if depth[row, column] > 0 and labels[row, column] >= 0 else (-1, -1)


@inner
def _beside(
    camera: Any, surface: Any, image: Any, at: tuple[Any, Vec3, float, float], pixel: tuple[int, int]
) -> bool:
    """Returns whether a pixel is beside an object and continues its explained surface.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m] and labels (h, w). at: the object's pose,
    its centre, the bound within which it explains a point, and how far inside of its outline the surface is that points
    beside it are compared with [pixels]. pixel: row and column.
    """
    (model, nodes), (rays, depth, labels) = surface, image
    pose, center, bound, inset = at
    v, u = pixel
    if not depth[v, u] > 0 or labels[v, u] < 0:
        return False
    P = point_at(rays, depth, v, u)
    beside = bound + BESIDE * 2 * model[0].radius
    if is_far(P, center, model[0].radius, beside):
        return False
    distance, gradient, _ = field_at(nodes, model[0].fine, apply_inverse(pose, P))
    if not bound < distance < beside:
        return False
    g = mul(pose[0], gradient)
    nearest = sub(P, scale(g, distance / max(norm(g), 1e-9)))
    row, column = _within(camera, image, pixel, nearest, inset)
    if row < 0:
        return False
    Q = point_at(rays, depth, row, column)
    inside, gradient, _ = field_at(nodes, model[0].fine, apply_inverse(pose, Q))
    normal = mul(pose[0], gradient)
    if not (abs(inside) < bound and dot(normal, Q) < -0.1 * norm(Q)):
        return False
    return bool(abs(dot(normal, sub(P, Q))) < bound)


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
        pose = pose_of(candidate.pose)
        bound = candidate.bound
        count = 0
        center = apply(pose, vector(model[0].center))
        beside = BESIDE * 2 * model[0].radius
        reach = 1.2 * model[0].radius + bound + beside
        u0, v0 = project(camera[0], center)
        candidate.unexplained = 0.0
        if not abs(u0 * v0) < np.inf:
            continue
        half = min(reach * camera[0].fx / max(center[2] - 0.5 * reach, 0.1 * center[2]), width + height)
        left = int(max(u0 - half, 0.0))
        right = int(min(u0 + half, width - 1.0))
        top = int(max(v0 - half, 0.0))
        bottom = int(min(v0 + half, height - 1.0))
        step = max(1, int(np.sqrt(max(right - left, 0) * max(bottom - top, 0) / most)))
        at = pose, center, bound, bound * camera[0].fx / center[2]
        for v in range(top, bottom + 1, step):
            for u in range(left, right + 1, step):
                count += _beside(camera, surface, image, at, (v, u))
        # As if its silhouette were square.
        outline = 4 * np.sqrt(max(candidate.expected, 1.0)) * beside * camera[0].fx / center[2]
        candidate.unexplained = candidate.expected * min(count * step * step / outline, 1.0)
        size = max(candidate.expected, POSE_SCORE.min_expected)
        candidate.score -= POSE_SCORE.unexplained * candidate.unexplained / size**POSE_SCORE.size_exponent


@inner
def _clearance(surface: Any, pose: Any, center: Vec3, ray: Vec3) -> tuple[float, Vec3]:
    """Returns how near a ray (x, y, 1) comes to the surface at a pose [m], and the surface's nearest point."""
    (model, nodes), length, least, nearest = surface, norm(ray), np.inf, center
    middle = dot(ray, center) / length**2
    reach = 1.5 * model[0].radius / length
    z = middle - reach
    for _ in range(MARCHED):
        if not (z < middle + reach and least > 1e-3 * model[0].radius):
            break
        P = scale(ray, z)
        distance, gradient, _ = field_at(nodes, model[0].fine, apply_inverse(pose, P))
        if abs(distance) < least:
            g = mul(pose[0], gradient)
            least = abs(distance)
            nearest = sub(P, scale(g, distance / max(norm(g), 1e-9)))
        z += abs(distance) / length
    return least, nearest


@inner
def _crossed(camera: Any, surface: Any, image: Any, at: Any, way: Any) -> tuple[float, float, int]:
    """Returns column and row of a pixel beside the outline on a way, and 2 if the observed surface is smooth from there
    onto the object, 1 if it is not, 0 if the object is not seen there; -1: the outline is not crossed in the image.

    at: the object's pose, centre, and bound. way: its pixel's column and row, and their changes; its end comes first.
    """
    (pose, center, bound), (model, nodes), (rays, depth, labels) = at, surface, image
    (near, far), left = OUTSIDE, 1.5 * model[0].radius * camera[0].fx / max(center[2], model[0].radius)
    for _ in range(STEPS):
        u, v = whole(way[0] + left * way[2]), whole(way[1] + left * way[3])
        if not (0 <= u < depth.shape[1] and 0 <= v < depth.shape[0]):
            left *= 0.85
            continue
        clear, nearest = _clearance(surface, pose, center, (rays[v, u, 0], rays[v, u, 1], 1.0))
        pixels = clear * camera[0].fx / nearest[2]
        if not pixels > near:
            break
        if pixels > far:
            left -= min(pixels - 0.5 * (near + far), 0.25 * left + 1)
            continue
        row, column = _within(camera, image, (v, u), nearest, WITHIN)
        if row < 0:
            return u, v, 0
        Q = point_at(rays, depth, row, column)
        if not abs(field_at(nodes, model[0].fine, apply_inverse(pose, Q))[0]) < bound:
            return u, v, 0
        if not depth[v, u] > 0 or labels[v, u] < 0:
            return u, v, 1
        gap = sub(point_at(rays, depth, v, u), Q)
        here = normal_at(rays, depth, v, u)
        there = normal_at(rays, depth, row, column)
        flat = max(abs(dot(here, gap)), abs(dot(there, gap))) < FLAT * bound
        return u, v, 2 if flat and dot(here, there) > COSINE else 1
    return 0.0, 0.0, -1


@entry
def cross_outlines(camera: Any, surface: Any, image: Any, candidates: Any) -> None:
    """Fills in `smooth` of CANDIDATE (k,): of the outline, where the object is seen inside of it, the share across
    which the observed surface is smooth, however the object's own would go on. Arguments are as `follow_outlines`'."""
    for k in range(len(candidates)):
        pose, crossed = pose_of(candidates[k].pose), np.zeros(3)  # pixels: all, visible, smooth
        center = apply(pose, vector(surface[0][0].center))
        at, (u0, v0), last = (pose, center, candidates[k].bound), project(camera[0], center), (0.0, 0.0, -1)
        for m in range(WAYS + 1 if abs(u0 * v0) < np.inf else 0):
            way = u0, v0, np.cos(2 * np.pi * m / WAYS), np.sin(2 * np.pi * m / WAYS)
            now = _crossed(camera, surface, image, at, way)
            if last[2] >= 0:  # each stands for the outline from the last one on
                crossed[: now[2] + 1] += ((now[0] - last[0]) ** 2 + (now[1] - last[1]) ** 2) ** 0.5
            last = now
        weight = max(UNSEEN[0] * crossed[0], 1.0)  # as much of it says what the mean candidate's does
        candidates[k].smooth = (crossed[2] + UNSEEN[1] * weight) / (crossed[1] + weight)
