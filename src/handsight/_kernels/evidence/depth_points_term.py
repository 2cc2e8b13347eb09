"""Depth points as evidence: points of one depth image that lie on the object's surface, one row each.

The residual of a point is its distance to the surface over σ. The points' errors are correlated (by the camera's pose,
and the palm's in the camera); σ is so large that all points together carry no more information about the pose than the
image does. It is the same at every pose, so that the cost needs no log determinant, as a contact's does.
"""

from typing import Any

from handsight._kernels.evidence.contact_term import Frame, Pose, distance_row, surface_at
from handsight._kernels.math.simd import accumulate
from handsight._kernels.math.vec3 import neg, vector
from handsight._kernels.runtime.compilation import inner


@inner
def add_depth_points(evidence: Any, field: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the row of every depth point; the variance of a coarse field's own error is added to the point's."""
    depth = evidence.constraints.depth
    for i in range(depth.count):
        point = vector(depth.points[i])
        distance, gradient, _, _, _ = surface_at(evidence.nodes, field, point, pose)
        weight = (1 / (depth.variance + field.variance_distance),)
        accumulate(weight, (distance_row(point, neg(gradient), distance, frame),), equations)


@inner
def depth_points_cost(evidence: Any, pose: Pose) -> float:
    """Returns the squared residuals at a pose, on the fine field."""
    depth, square = evidence.constraints.depth, 0.0
    for i in range(depth.count):
        point = vector(depth.points[i])
        distance, _, _, _, _ = surface_at(evidence.nodes, evidence.model.fine, point, pose)
        square += distance * distance
    return square / depth.variance if depth.count else 0.0
