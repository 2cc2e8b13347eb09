"""Where an object's centre of mass can be: where its symmetries leave it, or in the middle of a homogeneous volume."""

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput, InvalidObject
from handsight.objects.symmetry import Symmetries

USUAL_SIGMA = 2e-3
"""Of a centre of mass that is declared without one, per axis [m]."""
LEAST = 1e-3
"""So far off what symmetries leave in place a centre of mass may always be [m]."""


def kept_center(symmetries: Symmetries, center: Array) -> Array:
    """Returns (3,) the point nearest to a centre of mass (3,) that an object's symmetries leave in place [m]."""
    if symmetries.round:
        return symmetries.axes[0][0]
    for point, axis in symmetries.axes:
        center = point + ((center - point) @ axis) * axis
    return np.asarray(se3.apply(symmetries.rotations, center[None]).reshape(-1, 3).mean(axis=0))


def check_kept(kept: Array, center: Array, limit: float, name: str) -> None:
    """Raises InvalidInput where a centre of mass (3,) is farther than that [m] from where symmetries `kept` (3,) it."""
    off = float(np.linalg.norm(kept - center))
    if off > max(limit, LEAST):
        raise InvalidInput(
            f"{name}: expected a point that the object's symmetries leave in place, got one {1e3 * off:.1f} mm off "
            "(what weighs more on one side is not symmetric: declare the symmetries that it has)"
        )


def volume_centroid(vertices: Array, faces: Indices) -> Array:
    """Returns (3,) the centroid of the volume within triangles (m, 3) of vertices (k, 3).

    It is the centre of mass of what is the same all through. Raises InvalidObject where there is no volume.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    sixfold = np.einsum("ij,ij->i", a, np.cross(b, c))
    total = sixfold.sum()
    if not abs(total) > 1e-15:
        raise InvalidObject("object: expected a volume, got a surface without an inside")
    return np.asarray((sixfold[:, None] * (a + b + c)).sum(axis=0) / (4 * total))
