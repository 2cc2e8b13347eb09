"""The object's origin is near the palm: one-sided evidence, `max(0, |p| - REACH) / SIGMA` in one row."""

from typing import Any

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.math.simd import accumulate
from handsight._kernels.math.vec3 import cross, norm, scale, sub
from handsight._kernels.runtime.compilation import inner

REACH, SIGMA = 0.3, 0.01
"""How far from the palm an object in the hand can be, and a standard deviation of that [m]."""


@inner
def add_reach(pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the row, where the object's origin is out of reach."""
    (center, radius), p = frame, pose[1]
    beyond = norm(p) - REACH
    if beyond > 0:
        by_shift = scale(p, 1 / norm(p))
        lever = scale(sub(p, center), 1 / radius)
        accumulate((1 / SIGMA**2,), (by_shift + cross(lever, by_shift) + (beyond,),), equations)


@inner
def reach_cost(pose: Pose) -> float:
    """Returns the squared residual."""
    beyond = max(norm(pose[1]) - REACH, 0.0) / SIGMA
    return beyond * beyond
