"""Points of the hand that cannot be inside the object: one-sided evidence."""

from typing import Any

from handsight._kernels.compiled import inner
from handsight._kernels.contact_term import Frame, Pose
from handsight._kernels.field import field_at
from handsight._kernels.simd import accumulate
from handsight._kernels.vec3 import Vec3, cross, mul, neg, scale, sub, tmul, vector


@inner
def outside_bounds(model: Any, place: Vec3) -> bool:
    """Whether an object point is outside the box around the object: most of a hand is."""
    for k in range(3):  # noqa: SIM110 - a kernel has no generators
        if place[k] < model.bounds[0, k] or place[k] > model.bounds[1, k]:
            return True
    return False


@inner
def add_outside(evidence: Any, field: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds `min(0, distance) / sigma` of each point."""
    R, p = pose
    center, radius = frame
    for i in range(len(evidence.outside)):
        outside = evidence.outside[i]
        if outside.is_plane:
            continue
        point = vector(outside.point)
        place = tmul(R, sub(point, p))
        if not outside_bounds(evidence.model, place):
            depth, g, _ = field_at(evidence.nodes, field, place)
            if depth < 0:
                by_shift = neg(mul(R, g))
                lever = scale(sub(point, center), 1 / radius)
                weight = (1 / (outside.sigma * outside.sigma),)
                accumulate(weight, (by_shift + cross(lever, by_shift) + (depth,),), equations)


@inner
def outside_cost(evidence: Any, field: Any, pose: Pose) -> float:
    """Squared residuals of all points."""
    R, p = pose
    total = 0.0
    for i in range(len(evidence.outside)):
        outside = evidence.outside[i]
        if outside.is_plane:
            continue
        place = tmul(R, sub(vector(outside.point), p))
        if not outside_bounds(evidence.model, place):
            depth, _, _ = field_at(evidence.nodes, field, place)
            deep = min(depth, 0.0) / outside.sigma
            total += deep * deep
    return total
