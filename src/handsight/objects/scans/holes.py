"""What is not known of a surface where a scan has no points."""

from typing import NamedTuple

import numpy as np

from handsight._kernels.posterior.spurious_information import LEND
from handsight.checks import Array


class HoleOptions(NamedTuple):
    """`HoleOptions` say when a place beside a scan is a hole."""

    covered_gap: float = 1.5  # spacings from the nearest point up to which a place was seen by the scanner
    open_gap: float = 2.5  # spacings beyond which it was not
    clear: float = 0.2  # winding numbers this far from 0 and from 1: up to here no surface can pass
    open: float = 0.4  # from here on one may


HOLES = HoleOptions()


def unseen_variances(gap: Array, winding: Array, spacing: float) -> Array:
    """Returns (n, 4) variances, as of FieldError, at places that are `gap` (n,) [m] away from the nearest point.

    Around a place that the points enclose, or that all of them turn away from, they wind once or not at all: no surface
    passes there. Around what they leave open they wind in part; there it may pass as far away as they are, any way.
    `winding` (n,): how often they wind around each place. `spacing` [m] of the points.
    """
    is_open = np.clip((np.minimum(winding, 1 - winding) - HOLES.clear) / (HOLES.open - HOLES.clear), 0.0, 1.0)
    share = is_open * np.clip(
        (gap / spacing - HOLES.covered_gap) / (HOLES.open_gap - HOLES.covered_gap), 0.0, 1.0
    )
    return share[:, None] * np.stack(
        [gap**2, np.ones_like(gap), np.full_like(gap, LEND), np.full_like(gap, LEND / spacing**2)], axis=1
    )
