"""How well observations fit the model over the last second: what does not fit inflates the answer, and is named.

One correction tests its evidence as if the model were right. Errors that never change (another radius, a late pose of
the palm) pass that test by rejecting a finger again and again, or by moving the answer. So the normalised innovation
squared (NIS) of each kind of evidence is averaged over a window, in time, as corrections come at any rate:

* of a finger: by how much χ² rises with its contact where that contradicts the rest (`estimate.conflicts`), else zero;
* of vision, the prior with all but contacts: d' P₀⁻¹ d, with d from the prior to the answer; if both are right, it is
  6 - tr(P₀⁻¹ P₁) on average, with P₁ the answer's covariance;
* of the weight: by how much χ² rises with the centre of mass in the palm where that contradicts the rest, else zero;
* of the answer's motion since the last correction: d' (P₀ + P₁)⁻¹ d, with P₀ that of the last answer propagated to now.

Successive observations of one grasp have the same errors of calibration, so a window is worth one independent sample.
With an unknown factor s² on all noise, whose prior is scaled inverse χ² with ν degrees of freedom and scale 1, a NIS of
n degrees of freedom gives E[1/s²] = (ν + n) / (ν + NIS) (the weight of Student's t): the covariance is multiplied by
(ν + NIS) / (ν + n) where that is above 1 and the NIS is beyond the quantile of a χ² test.

Offsets of the joints may not show in residuals at all: the object then fits elsewhere. Their declared sigmas are
estimates, too: with ν degrees of freedom, the pose follows Student's t, whose 95 % region is that of a Gaussian with a
covariance larger by k F(k, ν) / χ²(k), by the 95 % quantiles (a coverage factor: Guide to the Expression of Uncertainty
in Measurement, annex G). The information of touch is divided by that, and by the factor s² of all touch above 1; that
of vision, whose errors are states, is not.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior, bounded_covariance
from handsight.correction.modes import chi2_limit, in_metres
from handsight.objects import ObjectModel
from handsight.tracking.hypotheses import RELEVANT_WEIGHT
from handsight.tracking.smoother import MAX_PROPAGATION

WINDOW = 1.0  # time constant of the averages [s]
ALARM_LEVEL = 1e-3  # level of the test of one window
NOISE_FREEDOM = 4.0
"""Degrees of freedom of the prior of the factor on the noise's variance: residuals are Student's t with so many, a
usual choice for measurements with outliers (Lange, Little and Taylor 1989)."""
REJECTED = 0.5
"""A finger whose contact is rejected for a larger share of the window contradicts the others."""
SUSPICIOUS = 0.6
"""The object may be another one once contacts contradicted the model for a larger share of the window: that is for
about a second, in which two searches from wider priors have failed."""
ONE_FINGER = 0.005
"""Level at which one finger alone contradicts the model: so many honest ones are that far off (`contradicted`). One
that contradicts the others less may be calibrated badly as well."""


COVERAGE = 6 * 6.163132282688632 / chi2_limit(6, 0.05)
"""Coverage factor of a covariance: k F(k, ν) / χ²(k) of 95 % quantiles, for the k = 6 numbers of a pose and ν =
`NOISE_FREEDOM`. The F(6, 4) is a number, as loading SciPy for it takes a fifth of a second."""
OTHER_OBJECT = "this may be another object than the model"
FINGER_OR_OBJECT = "a finger is calibrated badly, or this is another object"
TOUCH = "touch"
OBJECT = "object"
"""Names of the misfits of all contacts together: those that a finger may cause, and those that none can."""
SUSPICIONS = {OBJECT: OTHER_OBJECT, TOUCH: FINGER_OR_OBJECT}
"""What these suggest, the worse first."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Says how well one kind of evidence fits the model; `str` of it is a sentence."""

    name: str
    """What is compared: the name of a finger, "vision", "weight" or "motion"."""
    nis: float = 0.0
    """Normalised innovation squared, averaged over the window."""
    expected: float = 0.0
    """The same where the model is right: the degrees of freedom."""
    rejected: float = 0.0
    """Share of the window in which the contact of a finger was rejected."""

    @property
    def contradicts(self) -> bool:
        """Whether the evidence does not fit."""
        if self.name in SUSPICIONS:
            return self.rejected > SUSPICIOUS
        if self.rejected:
            return self.rejected > REJECTED
        return bool(self.nis > chi2_limit(max(math.ceil(self.expected), 1), ALARM_LEVEL))

    @property
    def factor(self) -> float:
        """By how much the answer's covariance is multiplied; 1 where the evidence fits."""
        if self.name in SUSPICIONS or self.nis <= chi2_limit(max(math.ceil(self.expected), 1), ALARM_LEVEL):
            return 1.0
        return (NOISE_FREEDOM + self.nis) / (NOISE_FREEDOM + self.expected)

    def __str__(self) -> str:
        """Returns a sentence such as "finger ff contradicts the others"."""
        if self.name in SUSPICIONS:
            return "contacts contradict the model"
        by = f"by {math.sqrt(self.nis):.0f} sigma"
        others = {
            "motion": f"the answer has moved {by} at once",
            "vision": f"contacts and vision have differed {by}",
            "weight": f"the weight has contradicted the rest {by}",
        }
        return others.get(self.name, f"finger {self.name} contradicts the others")

    def after(self, share: float, nis: float, expected: float, rejected: float = 0.0) -> "Misfit":
        """Returns the averages with new values, whose share of the window is `share`."""
        now = nis, expected, rejected
        means = self.nis, self.expected, self.rejected
        return Misfit(self.name, *(old + share * (new - old) for old, new in zip(means, now, strict=True)))


@dataclass(frozen=True)
class Innovations:
    """How well all evidence has fitted the model, over a window."""

    misfits: dict[str, Misfit] = field(default_factory=dict)
    """By what is compared: fingers, "vision", "weight", "motion", "touch", "object"."""

    @cached_property
    def worst(self) -> Misfit | None:
        """What fits least of all that does not fit; None where everything fits."""
        return max((m for m in self.misfits.values() if m.contradicts), key=lambda m: m.factor, default=None)

    @cached_property
    def touch(self) -> str:
        """What contacts that have contradicted the model for a while suggest; empty where they have not."""
        for name, reason in SUSPICIONS.items():
            if name in self.misfits and self.misfits[name].contradicts:
                return reason
        return ""

    @property
    def factor(self) -> float:
        """By how much the answer's covariance is multiplied."""
        return max((m.factor for m in self.misfits.values()), default=1.0)

    def after(
        self, age: float, fingers: tuple[str, ...], estimate: PoseEstimate, prior: PosePrior
    ) -> "Innovations":
        """Returns the innovations with those of a correction, `age` seconds after the last one.

        `fingers`: those of the estimate's first contacts; others were remembered. Fingers that let go are forgotten.
        """
        share = 1 - math.exp(-age / WINDOW)
        known = self.misfits
        new = {name: misfit for name, misfit in known.items() if name in ("vision", "motion")}
        against = {c.evidence: c for c in estimate.conflicts}

        def add(name: str, nis: float, expected: float, rejected: bool = False) -> None:
            before = known.get(name) or Misfit(name, expected=expected)
            new[name] = before.after(share, nis, expected, float(rejected))

        if estimate.weight_fits is not None or "weight" in known:
            conflict = against.get("weight")
            add("weight", 0.0 if conflict is None else conflict.chi2, 3)
        for i, finger in enumerate(fingers):
            conflict = against.get(f"contact {i}")
            if conflict is not None:
                add(finger, conflict.chi2, conflict.freedom, i in estimate.outliers)
            elif finger in known:
                add(finger, 0.0, 3, i in estimate.outliers)
        wrong, other = contradicted(estimate, len(fingers))
        add(TOUCH, float(estimate.answer["chi2"]), float(estimate.answer["rows"]), wrong)
        add(OBJECT, 0.0, 0.0, other)
        inverse = np.linalg.inv(prior.covariance)
        off = se3.difference(estimate.T_palm_object, prior.T_palm_object)
        expected = 6 - float((inverse * estimate.bounded_covariance).sum())
        expected = float(np.clip(expected, 0, 6))
        add("vision", float(off @ inverse @ off), expected)
        return Innovations(new)

    def moved(
        self, age: float, model: ObjectModel, last: PoseEstimate, new: PoseEstimate, noise: Array
    ) -> "Innovations":
        """Returns the innovations with the step from the last answer to a new one, `age` seconds later.

        `noise` (6,): variance of the object's motion in between [m², rad²]. The largest step counts, and fades. Where
        the last answer named other poses that explain the touch, the step is that from the nearest of them.
        """
        others = [row for row in last.modes[1:] if row["weight"] > RELEVANT_WEIGHT]
        known = [(row["T_palm_object"], bounded_covariance(row["information"])) for row in others]
        nis = math.inf
        for T, covariance in ((last.T_palm_object, last.bounded_covariance), *known):
            step = se3.difference(model.nearest(new.T_palm_object, T), T)
            total = covariance + new.bounded_covariance + np.diag(noise)
            nis = min(nis, float(step @ np.linalg.solve(total, step)))
        before = self.misfits.get("motion", Misfit("motion")).nis * math.exp(-age / WINDOW)
        return replace(self, misfits={**self.misfits, "motion": Misfit("motion", max(nis, before), 6.0)})

    def covered(self, model: ObjectModel, estimate: PoseEstimate, prior: PosePrior) -> PoseEstimate:
        """Returns a correction's estimate with the information of touch divided by its coverage factor; `prior` is
        that of the correction."""
        touch = self.misfits[TOUCH]
        unit = np.repeat([1.0, model.radius], 3)
        scale = (NOISE_FREEDOM + touch.nis) / (NOISE_FREEDOM + touch.expected)
        lost = 1 - 1 / (COVERAGE * max(scale, 1.0))
        # In coordinates y = U' x, the information U U' is the identity, and that of the prior is at most that.
        values, vectors = np.linalg.eigh(in_metres(estimate.information, model.radius))
        values = np.maximum(values, 1e-12 * values[-1])  # rounding
        known = values > (1e-9 * values[-1] if estimate.covariance is None else 0.0)
        U = vectors[:, known] * np.sqrt(values[known]) * unit[:, None]
        prior_variances, axes = np.linalg.eigh(U.T @ prior.covariance @ U)
        left = 1 - lost * (1 - 1 / np.maximum(prior_variances, 1.0))
        information = (U @ axes * left) @ (U @ axes).T
        covariance = None
        if estimate.covariance is not None:
            W = vectors / np.sqrt(values) / unit[:, None] @ axes
            covariance = (W / left) @ W.T
        return estimate.with_gaussian(estimate.T_palm_object, covariance, information)

    def inflated(self, estimate: PoseEstimate) -> PoseEstimate:
        """Returns the estimate with its covariance inflated until the evidence fits."""
        # A variance stops growing where the object may be anywhere.
        widest = MAX_PROPAGATION / float(estimate.bounded_covariance.diagonal().max())
        if (factor := min(self.factor, max(widest, 1.0))) <= 1:
            return estimate
        covariance = None if estimate.covariance is None else factor * estimate.covariance
        return estimate.with_gaussian(estimate.T_palm_object, covariance, estimate.information / factor)


NO_INNOVATIONS = Innovations()


def contradicted(estimate: PoseEstimate, fingers: int) -> tuple[bool, bool]:
    """Returns whether contacts contradict the model, and whether no calibration of one finger can explain that.

    They do where they fit no pose, or one of the first `fingers` contacts had to be rejected; an answer that vision
    alone contradicts is none of these. One finger explains it if only one had to be, and if it is not too far off.
    """
    kept = [c for c in estimate.conflicts if not c.excluded]
    touch = [c for c in estimate.conflicts if c.evidence.startswith("contact")]
    now = [c for c in touch if c.excluded and int(c.evidence.split()[1]) < fingers]
    fits = estimate.consistent or (bool(kept) and all(c.excluded for c in touch))
    too_far = any(chi2_probability(c.chi2, c.freedom) > 1 - ONE_FINGER for c in now)
    return not fits or bool(now), not fits or too_far or len(now) > 1


def chi2_probability(chi2: float, n: int) -> float:
    """Returns the probability that the χ² of n residuals is less: with Student's t for residuals, χ²/n follows an F
    distribution (n, `NOISE_FREEDOM`), for four in closed form (Abramowitz and Stegun, 26.6.4)."""
    normal = NOISE_FREEDOM / (NOISE_FREEDOM + chi2)
    return float((1 - normal) ** (n / 2) * (1 + n / 2 * normal))
