"""A correction propagated to now: the pose stays, its uncertainty grows with the process noise."""

import math
from dataclasses import dataclass

import numpy as np

from handsight._kernels.posterior import propagation as kernel
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior
from handsight.objects import ObjectModel
from handsight.tracking.skin import NOTHING, SkinContacts

MAX_PROPAGATION = 100.0
"""Variance [m², rad²] beyond which a walk says no more: nothing is known of where the object is."""


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A `Correction` is the answer of a correction, and what it was made from."""

    estimate: PoseEstimate
    contacts: Contacts
    """Touched by `fingers` at `stamp` [s]."""
    by_error: Array | None
    """(n, 6, j) of the contacts, see `FingertipContacts`."""
    prior: PosePrior
    """The object without touch."""
    fingers: tuple[str, ...]
    stamp: float
    variance: float
    """Of the position of the object's middle, its largest [m²]."""
    skin: SkinContacts = NOTHING


def process_variance(process_noise: Array, seconds: float) -> Array:
    """Returns (6,) variance of a random walk of `process_noise` (6,) a second, after so long [s]."""
    return np.minimum(process_noise * seconds, MAX_PROPAGATION)


def point_covariance(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> Array:
    """Returns (3, 3) of where in the palm [m] a point fixed on the object (3,) is.

    What a declared symmetry leaves at zero in the information is no uncertainty.
    """
    return _at_point(estimate, model, point_object)[0]


def sigma_of_point(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> float:
    """Returns largest standard deviation of where in the palm a point fixed on the object (3,) is [m]."""
    return math.sqrt(_at_point(estimate, model, point_object)[1])


def _at_point(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> tuple[Array, float]:
    """Returns the covariance, and its largest eigenvalue."""
    covariance, lever = np.empty((3, 3)), estimate.T_palm_object[:3, :3] @ point_object
    return covariance, kernel.at_point(np.array(estimate.information), model.radius, lever, covariance)
