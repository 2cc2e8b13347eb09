"""The weight of the object in a hand as a sensor of its pose: it is weighed in the air, and hangs from one point."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.copies import shallow_copy
from handsight.correction import PoseEstimate, WeightEvidence
from handsight.forces.weigher import Weigher
from handsight.forces.weight import Weighing
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.weight import kept_center
from handsight.observation import Observation
from handsight.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class ObjectWeight:
    """An `ObjectWeight` is what the object in the hand weighs, by the fingertips' loads."""

    mass: float
    """[kg]"""
    sigma_mass: float
    center_object: Array
    """(3,) its centre of mass in the object's frame [m]."""
    covariance: Array
    """(3, 3) of that, along the object's axes, with the pose's uncertainty [m²]."""
    center_palm: Array
    """(3,) its centre of mass in the palm [m]."""
    covariance_palm: Array
    """(3, 3) of that, along the palm's axes [m²]."""
    directions: int
    """In how many directions of gravity it was weighed: after one, the centre's height along that is open."""
    reason: str
    """Why it is not believed; empty where it is."""
    biased: tuple[str, ...]
    """Fingers whose sensors read more in the air than their calibration leaves, which is subtracted."""

    def kept_by_symmetries(self, model: ObjectModel) -> tuple[Array, float]:
        """Returns the centre of mass (3,) that the object's symmetries allow [m], and its largest sigma."""
        zero = kept_center(model.symmetries, np.zeros(3))
        kept = np.column_stack([kept_center(model.symmetries, axis) - zero for axis in np.eye(3)])
        variances = np.linalg.eigvalsh(kept @ self.covariance @ kept.T)
        return kept_center(model.symmetries, self.center_object), float(np.sqrt(max(variances[-1], 1e-8)))


class WeightSensor:
    """A `WeightSensor` weighs the object while it is in the air, and tells where its known centre of mass is."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """A model without a centre of mass is weighed too, but its weight tells nothing of its pose."""
        mass, sigma_declared = model.mass, 0.03  # one standard deviation, as a part of the mass
        self.weigher = Weigher(rig, mass, sigma_declared * (mass or 0.0))
        self.model = model
        self._used: Weighing | None = None
        """The weighing that the last correction used."""

    def copied(self) -> "WeightSensor":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.weigher = shallow_copy(self.weigher)
        return copy

    def update(
        self,
        observation: Observation,
        touch: tuple[tuple[str, ...], Contacts | None],
        joints: tuple[Array, Array],
        *,
        grasped: bool,
        lifted: bool,
        finger_on_table: bool,
    ) -> None:
        """Weighs an object that is grasped and in the air; of one that is not, measures the tips' biases.

        `touch` (fingers and their contacts) and `joints` are as `Weigher.update` takes them.
        """
        reason = ""
        if not grasped:
            reason = "nothing is grasped"
        elif not lifted and observation.T_world_palm is not None:
            reason = "the palm has not risen since the grasp"
        elif finger_on_table:
            reason = "a finger is on the table"
        if reason:
            self.weigher.forget(reason)
            self.weigher.listen(observation)
        else:
            self.weigher.update(observation, *touch, joints)

    @property
    def news(self) -> bool:
        """Whether the weight says something else of the pose than at the last correction."""
        found, used = self.weigher.believed, self._used
        if found is used or self.model.center_of_mass is None:
            return False
        if found is None or used is None or found.directions != used.directions:
            return True
        return bool(np.abs(found.center_palm - used.center_palm).max() > 1e-3)  # [m]

    def evidence(self) -> WeightEvidence | None:
        """Returns where the object's centre of mass is; None where the model has none, or no weighing is believed."""
        found, center = self.weigher.believed, self.model.center_of_mass
        if found is None or center is None:
            return None
        own = self.model.sigma_center_of_mass**2 * np.eye(3)
        return WeightEvidence(center, found.center_palm, found.covariance_center + own)

    def used(self) -> Weighing | None:
        """Returns the weighing that is believed, with which later ones are compared by `news`: a correction uses it."""
        self._used = self.weigher.believed
        return self._used

    def of(self, estimate: PoseEstimate | None) -> ObjectWeight | None:
        """Returns the weight of an object at a pose; None where it was not weighed since it was grasped."""
        found = self.weigher.weighing
        if found is None or estimate is None:
            return None
        T = estimate.T_palm_object
        R, center = T[:3, :3], T[:3, :3].T @ (found.center_palm - T[:3, 3])
        by_pose = GaussianPose(T, estimate.bounded_covariance).at_point(center).covariance[:3, :3]
        reason, declared = self.weigher.reason, self.model.center_of_mass
        if not reason and estimate.weight_fits is False and declared is not None:
            off = 1e3 * float(np.linalg.norm(center - declared))
            reason = f"contacts and vision have the centre of mass elsewhere, by {off:.0f} mm"
        return ObjectWeight(
            mass=found.mass,
            sigma_mass=found.sigma_mass,
            center_object=center,
            covariance=R.T @ (found.covariance_center + by_pose) @ R,
            center_palm=found.center_palm,
            covariance_palm=found.covariance_center,
            directions=found.directions,
            reason=reason,
            biased=self.weigher.biased,
        )
