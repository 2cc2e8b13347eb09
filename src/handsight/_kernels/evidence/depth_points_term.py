"""Depth points as evidence: points of one depth image that lie on the object's surface, one row each.

The residual of a point is its distance to the surface over the σ that all of them share: their errors are common (the
camera's pose, the palm's in the camera), and with this σ they know together no more of the pose than the image does.
It is the same at every pose, so the cost needs no log determinant, as a contact's does.
"""

from typing import Any

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.math.simd import accumulate
from handsight._kernels.math.vec3 import Vec3, cross, mul, neg, scale, sub, tmul, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import inner


@inner
def _distance(evidence: Any, field: Any, i: int, pose: Pose) -> tuple[float, Vec3, Vec3]:
    """Returns the distance of the i-th point to the surface, its gradient in the palm, and the point."""
    point = vector(evidence.constraints.depth.points[i])
    distance, gradient, _ = field_at(evidence.nodes, field, tmul(pose[0], sub(point, pose[1])))
    return distance, mul(pose[0], gradient), point


@inner
def add_depth_points(evidence: Any, field: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the row of every depth point, whose variance a coarse field adds to."""
    depth, (center, radius) = evidence.constraints.depth, frame
    for i in range(depth.count):
        distance, gradient, point = _distance(evidence, field, i, pose)
        by_shift = neg(gradient)
        by_turn = cross(scale(sub(point, center), 1 / radius), by_shift)
        weight = (1 / (depth.variance + field.variance_distance),)
        accumulate(weight, (by_shift + by_turn + (distance,),), equations)


@inner
def depth_points_cost(evidence: Any, pose: Pose) -> float:
    """Returns the squared residuals at a pose, on the fine field."""
    depth, square = evidence.constraints.depth, 0.0
    for i in range(depth.count):
        distance, _, _ = _distance(evidence, evidence.model.fine, i, pose)
        square += distance * distance
    return square / depth.variance if depth.count else 0.0
