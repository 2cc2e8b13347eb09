"""What a cloud's file itself says of how far its points may be off the object.

Depth images that were fused err together over centimetres, by what the camera is always wrong by, and so does what was
guessed. The points themselves do not show that.
"""

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.posterior.spurious_information import LEND
from handsight.checks import Array
from handsight.objects.geometry import Geometry, with_error

TOGETHER = 0.05
"""How far such errors reach [m]."""
NEAREST = 8


def with_declared_noise(geometry: Geometry, points: Array, sigmas: Array) -> Geometry:
    """Returns the same, its errors larger by standard deviations (n,) [m] that its points (n, 3) [m] are said to have.

    With the correlation exp(-d²/2L²) a slope's is σ/L, a curvature's √3 σ/L².
    """
    tree, variances = cKDTree(points), sigmas**2

    def at(nodes: Array) -> Array:
        s2 = variances[tree.query(nodes, k=min(NEAREST, len(points)))[1]].mean(axis=1)
        slope, bend = s2 / TOGETHER**2, 3 * s2 / TOGETHER**4
        return np.stack([s2, slope, LEND * slope, LEND * bend], axis=1)

    return with_error(geometry, at)
