"""Planes that the object cannot cross, such as a table: one-sided evidence, a row from the lowest point of each."""

from typing import Any

from handsight._kernels.compiled import inner
from handsight._kernels.contact_term import Frame, Pose
from handsight._kernels.field import field_at
from handsight._kernels.records import SAMPLES
from handsight._kernels.simd import accumulate
from handsight._kernels.vec3 import Vec3, add, cross, dot, mul, scale, sub, tmul, vector

STEPS, STEP, GROWTH = 10, 0.25, 3.0
"""Of the search for the lowest point: how many, how far the first goes down [radii], and how each that was lower
lengthens the next. Exact on boxes and cylinders; on scans, whose fields are round at edges, it ends a little high."""


@inner
def lowest_point(evidence: Any, field: Any, up: Vec3) -> Vec3:
    """The point of the surface that is lowest along a unit direction, both in the object's frame.

    From the lowest sample on to the closest point of what lies a step below, as long as that is lower: on a convex body
    these are steps of the proximal point algorithm, which ends at a polyhedron's lowest corner after finitely many.
    """
    model, low = evidence.model, (0.0, 0.0, 0.0)
    for i in range(SAMPLES):
        sample = vector(model.samples[i, 0])
        if i == 0 or dot(sample, up) < dot(low, up):
            low = sample
    step = STEP * model.radius
    for _ in range(STEPS):
        lower = sub(low, scale(up, step))
        for _ in range(2):  # once would do, were a grid's distance exact as far out as that
            d, g, _ = field_at(evidence.nodes, field, lower)
            lower = sub(lower, scale(g, d))
        if dot(lower, up) < dot(low, up):
            low = lower
            step *= GROWTH
        else:
            step *= 0.5
    return low


@inner
def _height(evidence: Any, field: Any, pose: Pose, plane: Any) -> tuple[float, Vec3]:
    """How far the object stays above a plane [m], below zero where it crosses it; its lowest point in the palm."""
    R, p = pose
    up = vector(plane.normal)
    point = add(mul(R, lowest_point(evidence, field, tmul(R, up))), p)
    return dot(up, sub(point, vector(plane.point))), point


@inner
def add_planes(evidence: Any, field: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds `min(0, height) / sigma` of each plane.

    A plane that is `sigma` off along its normal is off for the whole object: one row, however much of it is below.
    The lowest point may change with the pose, yet the height changes as that point does (the envelope theorem).
    """
    center, radius = frame
    for i in range(len(evidence.outside)):
        plane = evidence.outside[i]
        if plane.is_plane:
            height, point = _height(evidence, field, pose, plane)
            if height < 0:
                by_shift = vector(plane.normal)
                lever = scale(sub(point, center), 1 / radius)
                weight = (1 / (plane.sigma * plane.sigma),)
                accumulate(weight, (by_shift + cross(lever, by_shift) + (height,),), equations)


@inner
def plane_cost(evidence: Any, field: Any, pose: Pose) -> float:
    """Squared residuals of all planes."""
    total = 0.0
    for i in range(len(evidence.outside)):
        plane = evidence.outside[i]
        if plane.is_plane:
            height, _ = _height(evidence, field, pose, plane)
            deep = min(height, 0.0) / plane.sigma
            total += deep * deep
    return total
