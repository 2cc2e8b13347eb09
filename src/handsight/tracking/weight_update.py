"""What a tracker makes of the object's weight: it is weighed in the air, and its centre of mass tells its pose."""

from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.copies import shallow_copy
from handsight.correction import PoseEstimate, PosePrior, WeightEvidence
from handsight.forces import Weigher, Weighing
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.grasp import GRASP
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.shared_errors import together

SIGMA_MASS = 0.03
"""Of a mass that is declared: one standard deviation as a part of it."""
NEWS = 1e-3
"""A centre of mass that has moved by so much in the palm tells another pose [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectWeight:
    """An `ObjectWeight` is what the object in the hand weighs, as the fingertips' loads tell it."""

    mass: float
    """[kg]"""
    sigma_mass: float
    center_object: Array
    """(3,) its centre of mass in the object's frame [m]: as uncertain as the pose is, too."""
    covariance: Array
    """(3, 3) of that, along the object's axes [m²]."""
    center_palm: Array
    """(3,) the same in the palm [m]."""
    covariance_palm: Array
    """(3, 3)"""
    directions: int
    """In how many directions of gravity it was weighed: of one, the centre's height along that is open."""
    reason: str
    """Why it is not believed; empty where it is."""
    biased: tuple[str, ...]
    """Fingers whose sensors have read more in the air than their calibration leaves: it is taken off."""


class WeightUpdate:
    """A `WeightUpdate` is the weight of the object as a sensor of its pose, and what has become of it."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """Where the model has a centre of mass its weight tells the pose; else it is weighed all the same."""
        mass = model.mass
        self.weigher = Weigher(rig, mass, SIGMA_MASS * (mass or 0.0))
        self.model = model
        self.left_out = 0
        """Corrections that all else but the weight contradicted it in, and that were made without it."""
        self._reported: Weighing | None = None
        """By the last correction."""
        self._height: float | None = None
        """Of the palm in the world when the object was grasped [m]."""

    def copied(self) -> "WeightUpdate":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.weigher = shallow_copy(self.weigher)
        return copy

    def update(
        self, observation: Observation, touch: FingertipContacts, offsets: JointOffsets, *, grasped: bool
    ) -> None:
        """Weighs what is grasped and in the air."""
        T, reason = observation.T_world_palm, ""
        if not grasped:
            self._height, reason = None, "nothing is grasped"
        elif T is not None:
            height = float(T[2, 3])
            self._height = height if self._height is None else min(self._height, height)
            if height < self._height + GRASP.lifted:
                reason = "the palm has not risen since the grasp"
        if not reason and "on the table" in touch.reasons.values():
            reason = "a finger is on the table"
        if reason:
            self.weigher.forget(reason)
            self.weigher.listen(observation)
            return
        self.weigher.update(observation, touch.fingers, touch.contacts, (offsets.mean, offsets.root))

    @property
    def news(self) -> bool:
        """Whether the weight tells something else of the pose than at the last correction."""
        found, reported = self.weigher.believed, self._reported
        if found is reported or self.model.center_of_mass is None:
            return False
        if found is None or reported is None or found.directions != reported.directions:
            return True
        return bool(np.abs(found.center_palm - reported.center_palm).max() > NEWS)

    def evidence(self) -> WeightEvidence | None:
        """Returns where the object's centre of mass is; None where the model has none, or the weight is not
        believed."""
        found, center = self.weigher.believed, self.model.center_of_mass
        if found is None or center is None:
            return None
        own = self.model.sigma_center_of_mass**2 * np.eye(3)
        return WeightEvidence(center, found.center_palm, found.covariance_center + own)

    def shared(
        self, estimate: PoseEstimate, touch: FingertipContacts | None, prior: PosePrior, offsets: JointOffsets
    ) -> PoseEstimate:
        """Returns a correction by `touch` after its contacts and its weight have shared their joints' errors.

        As it was where the weight had no say; `touch` is None where other contacts had one.
        """
        weighing, evidence = self.weigher.believed, self.evidence()
        self._reported = weighing
        if estimate.weight_fits is False:
            self.left_out += 1
        if not estimate.weight_fits or weighing is None or evidence is None:
            return estimate
        if touch is None or touch.contacts is None or touch.by_error is None:
            return estimate
        given = touch.contacts, touch.by_error
        return together(self.model, estimate, given, prior, (weighing, evidence), offsets)

    def of(self, estimate: PoseEstimate | None) -> ObjectWeight | None:
        """Returns what the object weighs, where it is at a pose; None where it was not weighed since it was grasped."""
        found = self.weigher.weighing
        if found is None or estimate is None:
            return None
        T, J = estimate.T_palm_object, _by_pose(found, estimate.T_palm_object)
        R = T[:3, :3]
        covariance = R.T @ (found.covariance_center + J @ estimate.bounded_covariance @ J.T) @ R
        reason = self.weigher.reason
        center, declared = R.T @ (found.center_palm - T[:3, 3]), self.model.center_of_mass
        if not reason and estimate.weight_fits is False and declared is not None:
            off = 1e3 * float(np.linalg.norm(center - declared))
            reason = f"contacts and vision have the centre of mass elsewhere, by {off:.0f} mm"
        return ObjectWeight(
            mass=found.mass,
            sigma_mass=found.sigma_mass,
            center_object=center,
            covariance=covariance,
            center_palm=found.center_palm,
            covariance_palm=found.covariance_center,
            directions=found.directions,
            reason=reason,
            biased=self.weigher.biased,
        )


def _by_pose(found: Weighing, T_palm_object: Array) -> Array:
    """Returns (3, 6) how far the object's point at the centre of mass moves by (δp, δθ)."""
    return se3.point_jacobian(found.center_palm - T_palm_object[:3, 3])[:3]
