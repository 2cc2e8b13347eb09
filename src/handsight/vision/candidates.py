"""Candidate poses in a camera, as the records that the kernels of vision take."""

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.checks import Array
from handsight.objects import ObjectModel

Candidates = NDArray[np.void]
NOTHING_KNOWN = np.zeros((6, 6))
"""The information of a pose without prior knowledge."""


def candidates_at(Ts: Array) -> Candidates:
    """Returns CANDIDATE (k,) at poses (k, 4, 4) in the camera."""
    candidates = np.zeros(len(Ts), dtype=CANDIDATE)
    candidates["pose"]["rotation"], candidates["pose"]["position"] = Ts[:, :3, :3], Ts[:, :3, 3]
    return candidates


def poses_of(candidates: Candidates) -> Array:
    """Returns the poses (..., 4, 4) in the camera of CANDIDATE (...)."""
    return se3.compose(candidates["pose"]["rotation"], candidates["pose"]["position"])


def center_depths(model: ObjectModel, candidates: Candidates) -> Array:
    """Returns the depths (k,) of the object's centre [m]; 1 mm where it is not in front of the camera."""
    z = candidates["pose"]["position"][:, 2] + candidates["pose"]["rotation"][:, 2] @ model.center_object
    return np.asarray(np.maximum(z, 1e-3))
