"""What vision, or the last estimate, says of the pose, as evidence. Derivation: docs/method.md."""

from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.evidence import cross
from handsight.objects import Symmetries

EYE_6 = np.eye(6)


@dataclass(frozen=True, slots=True)
class Vision:
    """The pose is where vision says, as far as its covariance and the object's symmetry axes let it.

    Judged at a pivot that no symmetry moves, and by the swing of the axis alone: a spin about it costs nothing.
    """

    pivot_object: Array
    """(3,) on the symmetry axis; the origin where there is none."""
    axis_object: Array | None
    """(3,) unit; None: no axis."""
    pivot_palm: Array
    """(3,) where vision puts the pivot [m]."""
    R_palm_object: Array
    """(3, 3), vision's."""
    root: Array
    """(6, 6), `rootᵀ root` is the information of (pivot, rotation), none about a symmetry axis."""

    def linearize(self, Ts_palm_object: Array) -> tuple[Array, Array]:
        """Residuals (K, 6): whitened (pivot - vision's, rotation vector from vision's rotation)."""
        R = Ts_palm_object[:, :3, :3]
        arm = R @ self.pivot_object
        if self.axis_object is None:
            turn, by_turn = se3.log_with_derivative(R @ self.R_palm_object.T)
        else:
            turn, by_turn = swing(self.R_palm_object @ self.axis_object, R @ self.axis_object)
        jacobian = np.empty((len(R), 6, 6))
        jacobian[:] = EYE_6
        jacobian[:, :3, 3:] = -se3.skew(arm)
        jacobian[:, 3:, 3:] = by_turn
        error = np.concatenate([Ts_palm_object[:, :3, 3] + arm - self.pivot_palm, turn], axis=-1)
        return error @ self.root.T, self.root @ jacobian


def vision(T_palm_object: Array, root: Array, symmetries: Symmetries) -> Vision:
    """The evidence of a pose whose (δp, δθ) has information `rootᵀ root`, about an object so symmetric."""
    R, axes = T_palm_object[:3, :3], symmetries.axes
    pivot = np.asarray(axes[0][0]) if axes else np.zeros(3)
    # δp of the origin is that of the pivot less what the turn does to the arm between.
    from_pivot = np.eye(6)
    from_pivot[:3, 3:] = se3.skew(R @ pivot)
    root = root @ from_pivot
    for _, direction in axes:
        turned = root[:, 3:] @ R @ direction
        root = root - np.outer(turned, turned @ root) / max(float(turned @ turned), 1e-300)
    axis = np.asarray(axes[0][1]) if axes else None
    return Vision(pivot, axis, R @ pivot + T_palm_object[:3, 3], R, root)


def swing(axis_from: Array, axis_to: Array) -> tuple[Array, Array]:
    """Shortest rotation vectors (K, 3) from one axis to others (K, 3), and derivatives by a turn of the other.

    With n the vector's direction and angle α, a turn δθ changes it by
    (n nᵀ + α / sin α (n × from)(n × to)ᵀ) δθ: nothing about the axis itself.
    """
    S = se3.skew(axis_from)
    product = axis_to @ S.T
    sine = np.sqrt((product * product).sum(axis=-1, keepdims=True))
    small = sine < 1e-9
    safe = np.where(small, 1.0, sine)
    angle = np.arctan2(sine, (axis_to @ axis_from)[:, None])
    stretch = np.where(small, 1.0, angle / safe)
    n = product / safe
    sideways = stretch * (n @ S)  # n × from
    derivative = n[:, :, None] * n[:, None, :] + sideways[:, :, None] * cross(n, axis_to)[:, None, :]
    if small.any():
        still = np.eye(3) - axis_to[:, :, None] * axis_to[:, None, :]
        derivative = np.where(small[..., None], still, derivative)
    return stretch * product, derivative
