"""The object's weight as evidence: where its centre of mass is in the palm, found from the loads on the fingertips.

The residual is p + R c_o - c, three rows: c_o is the centre of mass in the object, c that in the palm. Its information
is that of both together.
"""

from typing import Any

from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_three_rows
from handsight._compiled.vec3 import Pose, dot, matrix, mul
from handsight.correction.kernels.contact_term import Frame
from handsight.correction.kernels.prior_term import point_off, point_rows


@inner
def add_weight(weight: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the three rows, where the weight is known."""
    if weight.known:
        place, off = point_off(weight.center_object, weight.center_palm, pose)
        add_three_rows(weight.information, point_rows(place, off, frame), equations)


@inner
def weight_cost(weight: Any, pose: Pose) -> float:
    """Returns the squared residuals at a pose; 0 where the weight is not known."""
    if not weight.known:
        return 0.0
    _, off = point_off(weight.center_object, weight.center_palm, pose)
    return dot(off, mul(matrix(weight.information), off))
