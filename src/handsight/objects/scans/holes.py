"""What is not known of a surface where a scan has no points."""

import numpy as np

from handsight._kernels.posterior.spurious_information import LEND
from handsight.checks import Array

COVERED_GAP, OPEN_GAP = 1.5, 2.5
"""Spacings from the nearest point: up to the first a place is seen, from the other on it is not."""
CLEAR, OPEN = 0.2, 0.4
"""Winding numbers as far from 0 and from 1: up to the first no surface can pass, from the other on one may."""


def unseen_variances(gap: Array, winding: Array, spacing: float) -> Array:
    """(n, 4) variances, as of FieldError, at places that are `gap` (n,) [m] away from the nearest point.

    Around a place that the points enclose, or that all of them turn away from, they wind once or not at all: no surface
    passes there. Around what they leave open they wind in part; there it may pass as far away as they are, any way.
    `winding` (n,): how often they wind around each place. `spacing` [m] of the points.
    """
    is_open = np.clip((np.minimum(winding, 1 - winding) - CLEAR) / (OPEN - CLEAR), 0.0, 1.0)
    share = is_open * np.clip((gap / spacing - COVERED_GAP) / (OPEN_GAP - COVERED_GAP), 0.0, 1.0)
    return share[:, None] * np.stack(
        [gap**2, np.ones_like(gap), np.full_like(gap, LEND), np.full_like(gap, LEND / spacing**2)], axis=1
    )
