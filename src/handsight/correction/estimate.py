"""What goes into a correction and what comes out: PosePrior, PoseEstimate.

Covariances and informations are 6 x 6, for the perturbation (δp [m], δθ [rad]) along the palm's axes, `p` the
object's origin (`handsight.se3.moved`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.posterior.propagation import inflate
from handsight._kernels.records import ANSWER, CONSTRAINTS
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.observation import PoseMeasurement
from handsight.representation import short_repr

OPEN_VARIANCES = np.repeat([1.0, np.pi**2 / 3], 3)
"""(6,) of a pose of which nothing is known (δp [m²], δθ [rad²]): a metre, and a full turn with all angles as likely."""
OPEN_INFORMATION = np.diag(1 / OPEN_VARIANCES)


@dataclass(frozen=True, slots=True)
class PosePrior:
    """A `PosePrior` is the object's pose in the palm by vision, or by the last estimate, with its covariance."""

    T_palm_object: Array
    """(4, 4)."""
    covariance: Array
    """(6, 6), positive semidefinite: of (δp [m], δθ [rad]) along the palm's axes."""
    record: NDArray[np.void] = field(init=False, repr=False, compare=False)
    """(1,) CONSTRAINTS: the same as kernels take it, without other evidence."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_palm_object", se3.check(self.T_palm_object, "vision.T_palm_object"))
        checks.in_reach(self.T_palm_object[:3, 3], "vision.T_palm_object: translation", (3,))
        covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "record", _prior_record(self.T_palm_object, covariance))
        self.T_palm_object.setflags(write=False)
        self.covariance.setflags(write=False)

    @classmethod
    def trusted(cls, T_palm_object: Array, covariance: Array) -> PosePrior:
        """Returns a prior of arrays that are known to be a pose and a covariance: to check them takes longer than to
        correct a pose."""
        prior = object.__new__(cls)
        object.__setattr__(prior, "T_palm_object", T_palm_object)
        object.__setattr__(prior, "covariance", covariance)
        object.__setattr__(prior, "record", _prior_record(T_palm_object, covariance))
        return prior

    @classmethod
    def from_sigmas(cls, T_palm_object: ArrayLike, sigma_position: float, sigma_rotation: float) -> PosePrior:
        """Returns the prior with one standard deviation per axis of position [m] and of rotation [rad]."""
        position = checks.sigma(sigma_position, "sigma_position")
        rotation = checks.sigma(sigma_rotation, "sigma_rotation")
        T = se3.check(T_palm_object, "vision.T_palm_object")
        return cls(T, np.diag([position**2] * 3 + [rotation**2] * 3))


Vision = PosePrior | PoseMeasurement | GaussianPose
"""A pose from vision as corrections take it: of the object in the palm, with its covariance."""


def checked_prior(vision: Vision | None, name: str = "vision") -> PosePrior | None:
    """Returns the prior of a pose from vision, whatever its type; raises InvalidInput, which begins with `name`."""
    if vision is None or isinstance(vision, PosePrior):
        return vision
    if isinstance(vision, GaussianPose):
        return PosePrior(vision.T_a_b, vision.covariance)
    if not isinstance(vision, PoseMeasurement):
        expected = "expected a PosePrior, a PoseMeasurement or None"
        raise InvalidInput(f"{name}: {expected}, got {type(vision).__name__}")
    if vision.frame != "palm":
        raise InvalidInput(
            f"{name}.frame: expected palm, got {vision.frame}; a Tracker, whose rig has the camera, takes such poses"
        )
    if vision.covariance is None:
        raise InvalidInput(f"{name}.covariance: expected (6, 6) numbers, got None")
    return PosePrior(vision.T_frame_object, vision.covariance)


def _prior_record(T: Array, covariance: Array) -> NDArray[np.void]:
    # Numbers of CONSTRAINTS, one after another: by their names they take three times as long.
    numbers = np.zeros(CONSTRAINTS.itemsize // 8)
    numbers[:9], numbers[9:12], numbers[12:48] = T[:3, :3].ravel(), T[:3, 3], covariance.ravel()
    record = numbers.view(CONSTRAINTS)
    record["has_prior"] = 1
    return record


@dataclass(frozen=True, slots=True)
class Residuals:
    """`Residuals` are how far each contact is from the surface at the answer; rejected contacts included."""

    distance: Array
    """(n,) signed distance of the contact point to the surface [m], positive outside."""
    normal: Array
    """(n,) angle between the contact's normal and the surface's [rad]; NaN for a contact without a normal."""

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A `Hypothesis` is one mode of the posterior."""

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

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseEstimate:
    """A `PoseEstimate` is the object's pose in the palm with its uncertainty: a view of a kernel's answer."""

    answer: np.void
    """ANSWER, of the best mode, or of its mean."""
    modes: Sequence[np.void]
    """ANSWER, of each mode that is reported, best first."""
    residual_rows: Array
    """(n, 2) distance [m] and angle [rad] of each contact."""
    consistent: bool
    """False: the evidence in use does not fit this object here (χ² beyond its 99.9 % quantile)."""
    outliers: tuple[int, ...] = ()
    """Indices of contacts that were rejected as wrong."""
    weight_fits: bool | None = None
    """Whether the object's weight was used: False where all other evidence contradicts it, and it was left out; None
    where it was not given."""

    @classmethod
    def from_gaussian(cls, T_palm_object: Array, covariance: Array, unobservable: Array) -> PoseEstimate:
        """Returns the estimate of a pose that is known without touch: one mode, no residuals."""
        answer = np.zeros(1, dtype=ANSWER)[0]
        answer["information"], answer["weight"], answer["converged"] = np.linalg.inv(covariance), 1.0, 1
        answer["T_palm_object"], answer["covariance"], answer["complete"] = T_palm_object, covariance, 1
        answer["pose"]["rotation"], answer["pose"]["position"] = T_palm_object[:3, :3], T_palm_object[:3, 3]
        answer["open_count"] = len(unobservable)
        answer["unobservable"][: len(unobservable)] = unobservable
        return cls(answer, (answer,), np.empty((0, 2)), True)

    def inflated(self, variance: Array) -> PoseEstimate:
        """Returns the estimate whose pose is more uncertain by `variance` (6,) along the palm's axes [m², rad²]."""
        if not variance.any():
            return self
        covariance = None if self.covariance is None else self.covariance + np.diag(variance)
        information = inflated_information(self.information, variance)
        return self.with_gaussian(self.T_palm_object, covariance, information)

    def with_gaussian(
        self,
        T_palm_object: Array,
        covariance: Array | None,
        information: Array,
        residuals: Array | None = None,
    ) -> PoseEstimate:
        """Returns the same estimate with another pose, covariance and information; other modes stay. `residuals` (n,
        2)."""
        answer = self.answer.copy()
        answer["T_palm_object"], answer["information"] = T_palm_object, information
        answer["complete"] = covariance is not None
        if covariance is not None:
            answer["covariance"] = covariance
        rows = self.residual_rows if residuals is None else residuals
        return PoseEstimate(
            answer, (answer, *self.modes[1:]), rows, self.consistent, self.outliers, self.weight_fits
        )

    @property
    def T_palm_object(self) -> Array:
        """(4, 4): the best mode; its mean where that is not Gaussian, or where a mean was asked for."""
        T: Array = self.answer["T_palm_object"]
        return T

    @property
    def T_palm_object_maximum(self) -> Array:
        """(4, 4): where the density of the best mode is largest, from which its neighbours can be followed."""
        pose = self.answer["pose"]
        return se3.compose(pose["rotation"], pose["position"])

    @property
    def covariance(self) -> Array | None:
        """(6, 6) of (δp [m], δθ [rad]); None where `information` is singular."""
        return self.answer["covariance"] if self.answer["complete"] else None

    @property
    def information(self) -> Array:
        """(6, 6), of touch and prior together; zero along a declared symmetry axis."""
        information: Array = self.answer["information"]
        return information

    @property
    def bounded_covariance(self) -> Array:
        """(6, 6): `covariance`, or where that is None one whose open directions have a stated large variance."""
        return bounded_covariance(self.information) if self.covariance is None else self.covariance

    @property
    def converged(self) -> bool:
        """Whether the solver ended on a step too small to matter."""
        return bool(self.answer["converged"])

    @property
    def iterations(self) -> int:
        """Steps of both phases that led to the answer."""
        return int(self.answer["iterations"])

    @property
    def residuals(self) -> Residuals:
        """What remains between each contact and the surface."""
        return Residuals(self.residual_rows[:, 0], self.residual_rows[:, 1])

    @property
    def unobservable(self) -> Array:
        """(k, 6) directions, (δp [m], δθ scaled by the object's radius [m]) of unit length, about the object's
        origin, in which the contacts leave the pose open: there the answer is the prior's."""
        rows: Array = self.answer["unobservable"][: self.answer["open_count"]]
        return rows

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Distinct modes modulo the declared symmetries, best first; the first is the answer's."""
        return tuple(
            Hypothesis(
                mode["T_palm_object"],
                mode["information"],
                mode["covariance"] if mode["complete"] else None,
                float(mode["weight"]),
                float(mode["posterior_cost"]),
            )
            for mode in self.modes
        )

    def __repr__(self) -> str:
        """Returns the position and how the search ended, in a line."""
        place = " ".join(f"{1000 * x:.1f}" for x in self.T_palm_object[:3, 3])
        ended = "converged" if self.converged else "not converged"
        fits = "consistent" if self.consistent else "inconsistent"
        count = f"{len(self.modes)} mode{'s' * (len(self.modes) != 1)}"
        return f"<PoseEstimate at ({place}) mm: {ended}, {fits}, {count}, {len(self.unobservable)} directions open>"


def inflated_information(information: Array, variance: Array) -> Array:
    """Returns an information (6, 6), which may be singular, after noise of `variance` (6,): (I⁻¹ + Q)⁻¹ without I⁻¹."""
    after = np.array(information)
    inflate(after, variance)
    return after


def bounded_covariance(information: Array) -> Array:
    """Returns (6, 6) of (δp [m], δθ [rad]): the inverse of an information (6, 6) that may be singular.

    The information is taken together with a prior that knows nothing, `OPEN_VARIANCES`. So where a direction is open,
    the largest eigenvalue is at least 1, about a spin through the origin π²/3; no pose that is known has one near it.
    For those that take covariances alone: a filter reads zeros as certainty.
    """
    return np.asarray(np.linalg.inv(information + OPEN_INFORMATION))
