"""The object's weight as evidence: where its centre of mass is in the palm, as the fingertips' loads tell it.

The residual is p + R c_o - c, three rows: c_o in the object, c in the palm. It has the information of both together.
"""

from typing import Any

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.math.simd import accumulate
from handsight._kernels.math.vec3 import Vec3, add, dot, matrix, mul, scale, skew, sub, vector
from handsight._kernels.runtime.compilation import inner


@inner
def _error(weight: Any, pose: Pose) -> tuple[Vec3, Vec3]:
    """Returns the object's centre of mass in the palm, and how far it is from where the loads have it."""
    R, p = pose
    center = add(p, mul(R, vector(weight.center_object)))
    return center, sub(center, vector(weight.center_palm))


@inner
def add_weight(weight: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the three rows, where the weight is known."""
    if weight.known:
        center, radius = frame
        place, off = _error(weight, pose)
        # It moves by τ + ω × (place - center).
        by_turn = skew(scale(sub(center, place), 1 / radius))
        rows = (
            (1.0, 0.0, 0.0) + by_turn[0] + (off[0],),
            (0.0, 1.0, 0.0) + by_turn[1] + (off[1],),
            (0.0, 0.0, 1.0) + by_turn[2] + (off[2],),
        )
        accumulate(weight.information, rows, equations)


@inner
def weight_cost(weight: Any, pose: Pose) -> float:
    """Returns its squared residuals at a pose; 0 where it is not known."""
    if not weight.known:
        return 0.0
    _, off = _error(weight, pose)
    return dot(off, mul(matrix(weight.information), off))
