"""What goes into a correction and what comes out: PosePrior, PoseEstimate.

Covariances and informations are 6 x 6, for the perturbation (δp [m], δθ [rad]) along the palm's axes, `p` the
object's origin (`handsight.se3.moved`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array


@dataclass(frozen=True, slots=True)
class PosePrior:
    """Where vision, or the last estimate, says the object is, and how far that may be wrong."""

    T_palm_object: Array
    """(4, 4)."""
    covariance: Array
    """(6, 6), positive semidefinite: of (δp [m], δθ [rad]) along the palm's axes."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_palm_object", se3.check(self.T_palm_object, "vision.T_palm_object"))
        covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
        object.__setattr__(self, "covariance", covariance)
        self.T_palm_object.setflags(write=False)
        self.covariance.setflags(write=False)

    @classmethod
    def trusted(cls, T_palm_object: Array, covariance: Array) -> "PosePrior":
        """Of arrays that are known to be a pose and a covariance: checking takes longer than correcting."""
        prior = object.__new__(cls)
        object.__setattr__(prior, "T_palm_object", T_palm_object)
        object.__setattr__(prior, "covariance", covariance)
        return prior

    @classmethod
    def from_sigmas(
        cls, T_palm_object: ArrayLike, sigma_position: float, sigma_rotation: float
    ) -> "PosePrior":
        """The prior with one standard deviation per axis of position [m] and of rotation [rad]."""
        position = checks.positive(sigma_position, "sigma_position")
        rotation = checks.positive(sigma_rotation, "sigma_rotation")
        T = se3.check(T_palm_object, "vision.T_palm_object")
        return cls(T, np.diag([position**2] * 3 + [rotation**2] * 3))


@dataclass(frozen=True, slots=True)
class Residuals:
    """How far each contact is from the answer's surface; rejected contacts included."""

    distance: Array
    """(n,) signed distance of the contact point to the surface [m], positive outside."""
    normal: Array
    """(n,) angle between the contact's normal and the surface's [rad]; NaN for a contact without a normal."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One mode of the posterior."""

    T_palm_object: Array
    """(4, 4)."""
    information: Array
    """(6, 6), of touch and prior together; may be singular."""
    covariance: Array | None
    """(6, 6), the information's inverse; None where that is singular."""
    weight: float
    """Posterior probability among the reported modes; they sum to 1."""
    cost: float
    """Minus two log of the density at the mode, up to a constant: the χ² of all evidence in use."""


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """The object's pose in the palm, and how much of it to believe."""

    T_palm_object: Array
    """(4, 4): the best mode; its mean where `samples` were asked for."""
    covariance: Array | None
    """(6, 6) of (δp [m], δθ [rad]); None where `information` is singular."""
    information: Array
    """(6, 6), of touch and prior together; zero along a declared symmetry axis."""
    converged: bool
    """Whether the solver ended on a step too small to matter."""
    iterations: int
    """Steps of both phases that led to the answer."""
    residuals: Residuals
    unobservable: Array
    """(k, 6) directions, (δp [m], δθ scaled by the object's radius [m]) of unit length, about the object's
    origin, in which the contacts leave the pose open: there the answer is the prior's."""
    consistent: bool
    """False: the evidence in use does not fit this object here (χ² beyond its 99.9 % quantile)."""
    outliers: tuple[int, ...]
    """Indices of contacts that were rejected as wrong."""
    hypotheses: tuple[Hypothesis, ...]
    """Distinct modes modulo the declared symmetries, best first; the first is the answer's."""
