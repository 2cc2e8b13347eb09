"""The pose before a correction, `PosePrior`, and after it, `PoseEstimate`.

Covariances and informations are (6, 6), of the perturbation (δp [m], δθ [rad]) along the palm's axes, where `p` is the
position of the object's origin (`handsight.se3.moved`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._compiled.records import ANSWER, CONSTRAINTS
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose, stretched
from handsight.objects import ObjectModel
from handsight.observation import PoseMeasurement
from handsight.representation import short_repr

OPEN_VARIANCES = np.repeat([1.0, np.pi**2 / 3], 3)
"""(6,) variances of an unknown pose (δp [m²], δθ [rad²]): one metre, and an angle that is uniform over a full turn."""
OPEN_INFORMATION = np.diag(1 / OPEN_VARIANCES)


@dataclass(frozen=True, slots=True)
class PosePrior:
    """The object's pose in the palm before touch, with its covariance: vision's, or the last one."""

    T_palm_object: Array
    """(4, 4) pose of the object in the palm."""
    covariance: Array
    """(6, 6), positive semidefinite: of (δp [m], δθ [rad]) along the palm's axes."""
    record: NDArray[np.void] = field(init=False, repr=False, compare=False)
    """(1,) CONSTRAINTS: the same values as a record for the kernels, without other evidence."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_palm_object", se3.check(self.T_palm_object, "vision.T_palm_object"))
        checks.in_reach(self.T_palm_object[:3, 3], "vision.T_palm_object: translation", (3,))
        covariance = checks.covariance(self.covariance, "vision.covariance", (6, 6))
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "record", _prior_record(self.T_palm_object, covariance))
        self.T_palm_object.setflags(write=False)
        self.covariance.setflags(write=False)

    def __reduce__(self) -> tuple[object, ...]:
        """Makes copies, from pickles too, as little writable as the prior itself: its record is of the same numbers."""
        return _copied, (self.T_palm_object, self.covariance)

    @classmethod
    def trusted(cls, T_palm_object: Array, covariance: Array) -> PosePrior:
        """Returns a prior of arrays that are not checked, as this takes longer than a correction; for control loops."""
        prior = object.__new__(cls)
        object.__setattr__(prior, "T_palm_object", T_palm_object)
        object.__setattr__(prior, "covariance", covariance)
        object.__setattr__(prior, "record", _prior_record(T_palm_object, covariance))
        return prior

    @classmethod
    def from_sigmas(
        cls,
        T_palm_object: ArrayLike,
        sigma_position: float,
        sigma_rotation: float,
        *,
        ray: ArrayLike | None = None,
        sigma_ray: float | None = None,
    ) -> PosePrior:
        """Returns the prior with a sigma per axis of position [m], and of rotation [rad] within half a turn.

        A camera knows the distance worst. `ray` (3,): the direction from it to the object, along the palm's axes, of
        any length; `sigma_ray`: the position's sigma along it [m]; `sigma_position` is then that across it. Raises
        InvalidInput.
        """
        position = checks.sigma(sigma_position, "sigma_position")
        rotation = checks.sigma_angle(sigma_rotation, "sigma_rotation")
        T = se3.check(T_palm_object, "vision.T_palm_object")
        covariance = np.diag([position**2] * 3 + [rotation**2] * 3)
        if (ray is None) != (sigma_ray is None):
            missing, given = ("sigma_ray", "ray") if sigma_ray is None else ("ray", "sigma_ray")
            raise InvalidInput(f"{missing}: expected with {given}, got None")
        if ray is not None and sigma_ray is not None:
            direction = checks.unit(ray, "ray", (3,))
            along = checks.sigma(sigma_ray, "sigma_ray")
            covariance[:3, :3] += stretched(direction, along, position)
        return cls(T, covariance)


def _copied(T_palm_object: Array, covariance: Array) -> PosePrior:
    prior = PosePrior.trusted(T_palm_object.copy(), covariance.copy())
    prior.T_palm_object.setflags(write=False)
    prior.covariance.setflags(write=False)
    return prior


Vision = PosePrior | PoseMeasurement | GaussianPose
"""The types in which corrections take the pose from vision: of the object in the palm, with its covariance."""


def checked_prior(vision: Vision | None, name: str = "vision") -> PosePrior | None:
    """Returns a pose from vision as a prior, None for None; raises InvalidInput, which begins with `name`."""
    if vision is None or isinstance(vision, PosePrior):
        return vision
    if isinstance(vision, GaussianPose):
        return PosePrior(vision.T_a_b, vision.covariance)
    if not isinstance(vision, PoseMeasurement):
        expected = "expected a PosePrior, a PoseMeasurement, a GaussianPose or None"
        raise InvalidInput(f"{name}: {expected}, got {type(vision).__name__}")
    if vision.frame != "palm":
        raise InvalidInput(
            f"{name}.frame: expected palm, got {vision.frame}; a Tracker, whose rig has the camera, takes such poses"
        )
    if vision.covariance is None:
        raise InvalidInput(f"{name}.covariance: expected (6, 6) numbers, got None")
    return PosePrior(vision.T_frame_object, vision.covariance)


def _prior_record(T: Array, covariance: Array) -> NDArray[np.void]:
    """Returns (1,) CONSTRAINTS with a pose (4, 4) and its covariance (6, 6)."""
    record = np.zeros(1, dtype=CONSTRAINTS)
    prior = record["prior"]
    prior["pose"]["rotation"] = T[:3, :3]
    prior["pose"]["position"] = T[:3, 3]
    prior["covariance"] = covariance
    record["has_prior"] = True
    return record


@dataclass(frozen=True, slots=True)
class Residuals:
    """The distance and the angle of each contact to the surface at the answer, outliers included."""

    distance: Array
    """(n,) signed distance of the contact point to the surface [m], positive outside."""
    normal: Array
    """(n,) angle between the contact's normal and the surface's [rad]; NaN for a contact without a normal."""

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One mode of the posterior."""

    T_palm_object: Array
    """(4, 4) pose of the object in the palm."""
    information: Array
    """(6, 6), of touch and prior together; may be singular."""
    covariance: Array | None
    """(6, 6), the information's inverse; None where that is singular."""
    weight: float
    """Posterior probability among the reported modes, which sum to 1."""
    cost: float
    """Minus two log of the posterior density at the mode, up to a constant: the χ² of all evidence in use, plus the log
    determinants of the contacts' covariances. It may be negative."""

    __repr__ = short_repr


NORMALS = "normals"


@dataclass(frozen=True, slots=True, eq=False)
class Conflict:
    """Evidence that contradicts the rest; `str` of it is a sentence."""

    evidence: str
    """What contradicts: "vision", "contact 3" (by its index), "group 1" (of contacts that share an error), "skin",
    "weight" or "outside"; "normals" where all of them negated would fit."""
    against: str
    """The rest, such as "contacts, weight"."""
    chi2: float
    """By how much χ² is smaller without it: along one direction, its squared distance in standard deviations."""
    freedom: int
    """Degrees of freedom of `chi2` where nothing contradicts."""
    p_value: float
    """Probability of so large a `chi2` where nothing contradicts."""
    offset: Array
    """From what it measured to where the rest puts the object: of vision (6,) shift [m] and turn [rad] along the palm's
    axes; of the weight (3,) the shift of the centre of mass [m]; of a contact (2,) distance [m] and angle [rad]; of
    others (0,)."""
    excluded: bool = False
    """Whether it was left out of the answer."""

    def __str__(self) -> str:
        """Returns a sentence such as "vision contradicts contacts by 10 sigma: 3.3 mm along z"."""
        if self.evidence == NORMALS:
            return (
                "normals contradict the rest: all of them negated would fit (do they point into the object?)"
            )
        shift = self.offset[:3]
        turn = self.offset[3:]
        places = ["along x", "along y", "along z"]
        if len(self.offset) == 2:  # distance and angle of a contact
            shift = self.offset[:1]
            turn = self.offset[1:]
            places = ["from the surface"]
        text = f"{self.evidence} contradicts {self.against} by {self.chi2**0.5:.0f} sigma"
        if len(shift):
            k = int(np.abs(shift).argmax())
            text += f": {1e3 * abs(shift[k]):.1f} mm {places[k]}"
        if len(turn) and np.isfinite(turn).all():
            text += f", {np.rad2deg(np.linalg.norm(turn)):.1f}°"
        return text + ", and is left out" * self.excluded


@dataclass(frozen=True, eq=False, repr=False)
class PoseEstimate:
    """The object's pose in the palm with its uncertainty.

    Its properties read the record that the kernel has written, `answer`.
    """

    modes: NDArray[np.void]
    """(K,) ANSWER of each mode that is reported, or of its mean, best first."""
    residual_rows: Array
    """(n, 2) distance [m] and angle [rad] of each contact."""
    consistent: bool = True
    """Whether the evidence in use fits this object at this pose: it passes the χ² test of all evidence together, and
    those of each kind of evidence and each contact alone against the rest, with a level of .001 over all tests."""
    outliers: tuple[int, ...] = ()
    """Indices of contacts that were rejected as wrong."""
    weight_fits: bool | None = None
    """Whether the object's weight was used; False: all other evidence contradicts it, and it was left out; None: no
    weight was given."""
    conflicts: tuple[Conflict, ...] = ()
    """Which evidence contradicts the rest, the least probable one first; then what was left out of the answer."""

    @classmethod
    def from_gaussian(cls, T_palm_object: Array, covariance: Array, unobservable: Array) -> PoseEstimate:
        """Returns the estimate of a pose (4, 4) without touch: one mode, no residuals.

        `covariance` (6, 6); `unobservable` (k, 6): the directions that it reports.
        """
        modes = np.zeros(1, dtype=ANSWER)
        answer = modes[0]
        answer["T_palm_object"] = T_palm_object
        answer["pose"]["rotation"] = T_palm_object[:3, :3]
        answer["pose"]["position"] = T_palm_object[:3, 3]
        answer["covariance"] = covariance
        answer["information"] = np.linalg.inv(covariance)
        answer["weight"] = answer["converged"] = answer["complete"] = 1
        answer["open_count"] = len(unobservable)
        answer["unobservable"][: len(unobservable)] = unobservable
        return cls(modes, np.empty((0, 2)))

    def inflated(self, variance: Array) -> PoseEstimate:
        """Returns the estimate with `variance` (6,) [m², rad²], along the palm's axes, added to its covariance."""
        if not variance.any():
            return self
        covariance = None if self.covariance is None else self.covariance + np.diag(variance)
        # (I⁻¹ + Q)⁻¹ of an information I that may be singular.
        information = np.linalg.solve(np.eye(6) + self.information * variance, self.information)
        information = (information + information.T) / 2
        return self.with_gaussian(self.T_palm_object, covariance, information)

    def with_gaussian(
        self,
        T_palm_object: Array,
        covariance: Array | None,
        information: Array,
        residuals: Array | None = None,
    ) -> PoseEstimate:
        """Returns the estimate with another pose (4, 4), covariance and information (6, 6) of its best mode.

        `residuals` (n, 2): distance [m] and angle [rad] of each contact; None: as they are.
        """
        modes = self.modes.copy()
        answer = modes[0]
        answer["T_palm_object"], answer["information"] = T_palm_object, information
        answer["complete"] = covariance is not None
        if covariance is not None:
            answer["covariance"] = covariance
        rows = self.residual_rows if residuals is None else residuals
        return replace(self, modes=modes, residual_rows=rows)

    @property
    def answer(self) -> np.void:
        """ANSWER of the best mode, or of its mean."""
        answer: np.void = self.modes[0]
        return answer

    @property
    def T_palm_object(self) -> Array:
        """(4, 4) pose of the object in the palm: the maximum of the best mode or, where that is not Gaussian, its mean,
        as of a slide that ends at edges but is not fixed between them."""
        T: Array = self.answer["T_palm_object"]
        return T

    @property
    def T_palm_object_maximum(self) -> Array:
        """(4, 4) pose at which the density of the best mode is largest, from which `refine_pose` starts next."""
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
        """(6, 6): `covariance`, or, where that is None, one with a stated large variance in open directions."""
        return bounded_covariance(self.information) if self.covariance is None else self.covariance

    @property
    def converged(self) -> bool:
        """Whether the last step of the solver was smaller than its tolerance, and no search was cut short."""
        return bool(self.answer["converged"])

    @property
    def iterations(self) -> int:
        """The number of steps of both phases that led to the answer."""
        return int(self.answer["iterations"])

    @property
    def residuals(self) -> Residuals:
        """The distance and the angle between each contact and the surface."""
        return Residuals(self.residual_rows[:, 0], self.residual_rows[:, 1])

    @property
    def unobservable(self) -> Array:
        """(k, 6) directions in which the contacts leave the pose open, so that the answer is the prior's.

        Each is (δp, radius · δθ), of unit length, along the palm's axes: δp of the object's origin, and the object's
        radius.
        """
        rows: Array = self.answer["unobservable"][: self.answer["open_count"]]
        return rows

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The distinct modes, modulo the declared symmetries, best first: the first is the answer."""
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
        """Returns the position, and how the search ended, in one line."""
        place = " ".join(f"{1000 * x:.1f}" for x in self.T_palm_object[:3, 3])
        ended = "converged" if self.converged else "not converged"
        fits = "consistent" if self.consistent else "inconsistent"
        count = f"{len(self.modes)} mode{'s' * (len(self.modes) != 1)}"
        return f"<PoseEstimate at ({place}) mm: {ended}, {fits}, {count}, {len(self.unobservable)} directions open>"


def bounded_covariance(information: Array) -> Array:
    """Returns (6, 6) of (δp [m], δθ [rad]): the inverse of an information (6, 6) that may be singular.

    The information of an unknown pose, with `OPEN_VARIANCES`, is added. So with an open direction the largest
    eigenvalue is at least 1, for a spin about the origin π²/3, which no known pose comes near. It is for programs
    that take nothing but a covariance: a filter would read zeros as certainty.
    """
    return np.asarray(np.linalg.inv(information + OPEN_INFORMATION))


def point_uncertainty(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> tuple[Array, float]:
    """Returns the covariance (3, 3) of a point (3,) of the object in the palm [m²], and its largest eigenvalue.

    A direction whose information is zero because of a declared symmetry counts as certain.
    """
    arm = estimate.T_palm_object[:3, :3] @ point_object
    scale = np.repeat([1.0, 1 / model.radius], 3)
    values, vectors = np.linalg.eigh(estimate.information * scale[:, None] * scale)
    is_known = values > 1e-9 * values[-1]  # else it is a declared symmetry's zero
    columns = scale[:, None] * vectors[:, is_known] / np.sqrt(values[is_known])
    moved = columns[:3] - se3.skew(arm) @ columns[3:]
    covariance = moved @ moved.T
    return covariance, float(np.linalg.eigvalsh(covariance)[-1])
