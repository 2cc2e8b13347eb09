"""Planes that the object cannot cross, such as a table: one-sided evidence, a row for each."""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_row
from handsight._compiled.records import BOX, CYLINDER, SPHERE
from handsight._compiled.vec3 import Pose, Vec3, apply, dot, scale, sub, tmul, vector
from handsight.correction.kernels.contact_term import Frame, distance_row
from handsight.objects.kernels.field import field_at
from handsight.objects.kernels.samples import scan


@inner
def lowest_point(evidence: Any, up: Vec3) -> Vec3:
    """Returns the point of the surface that is lowest along a unit direction, both in the object's frame.

    On a grid it is found from the lowest sample: on to the surface's closest point to a place a step below, as long as
    that is lower. On a convex body this is the proximal point algorithm, which reaches a polyhedron's lowest corner in
    finitely many steps; on scans, whose fields are round at edges, it ends a little high.
    """
    model = evidence.model
    field = evidence.model.fine
    none = np.float32(0.0)
    half = vector(field.origin)
    if field.kind == BOX:
        return -np.copysign(half[0], up[0]), -np.copysign(half[1], up[1]), -np.copysign(half[2], up[2])
    if field.kind == CYLINDER:
        side = -half[0] / max(np.sqrt(up[0] * up[0] + up[1] * up[1]), 1e-300)
        return side * up[0], side * up[1], -np.copysign(half[1], up[2])
    if field.kind == SPHERE:
        return scale(up, -half[0])
    query = none, np.float32(up[0]), np.float32(up[1]), np.float32(up[2]), none, none, none
    low = vector(model.samples[scan(model.scan, query), 0])
    step = 0.25 * model.radius
    for _ in range(10):
        lower = sub(low, scale(up, step))
        for _ in range(2):  # twice, because a grid's distance is not exact far from the surface
            d, g, _ = field_at(evidence.nodes, field, lower)
            lower = sub(lower, scale(g, d))
        if dot(lower, up) < dot(low, up):
            low = lower
            step *= 3.0
        else:
            step *= 0.5
    return low


@inner
def _height(evidence: Any, pose: Pose, plane: Any) -> tuple[float, Vec3]:
    """Returns the height of the object's lowest point above a plane [m], or a positive lower bound of it, and, where it
    is negative, that point in the palm."""
    (R, p), bounds = pose, evidence.model.bounds
    normal = vector(plane.normal)
    up = tmul(R, normal)
    height = dot(normal, sub(p, vector(plane.point)))
    corner = 0.0
    for k in range(3):
        corner += min(bounds[0, k] * up[k], bounds[1, k] * up[k])
    if height + corner >= 0:
        return height + corner, p
    low = lowest_point(evidence, up)
    return height + dot(up, low), apply(pose, low)


@inner
def add_planes(evidence: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds `min(0, height) / sigma` of each plane.

    A plane's error along its normal is the same for the complete object: one row, however much of it is below. As the
    pose changes, another point may become the lowest; the derivative of the height is that of the present lowest
    point's all the same (envelope theorem).
    """
    for i in range(evidence.measured.points, len(evidence.outside)):
        plane = evidence.outside[i]
        height, point = _height(evidence, pose, plane)
        if height < 0:
            row = distance_row(point, vector(plane.normal), height, frame)
            add_row(1 / (plane.sigma * plane.sigma), row, equations)


@inner
def planes_crossed(evidence: Any, pose: Pose) -> int:
    """Returns how many planes the object crosses."""
    count = 0
    for i in range(evidence.measured.points, len(evidence.outside)):
        height, _ = _height(evidence, pose, evidence.outside[i])
        count += height < 0
    return count


@inner
def plane_cost(evidence: Any, pose: Pose) -> float:
    """Returns squared residuals of all planes."""
    total = 0.0
    for i in range(evidence.measured.points, len(evidence.outside)):
        plane = evidence.outside[i]
        height, _ = _height(evidence, pose, plane)
        deep = min(height, 0.0) / plane.sigma
        total += deep * deep
    return total
