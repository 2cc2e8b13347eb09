"""The constant errors of a hand's joints: learnt from one grip to the next, shared by all that a grip measures.

A joint reads too much by the same angle until somebody calibrates it again. Within one grip that looks like another
pose. But contacts say more than the six numbers of a pose: their residuals say which offsets are impossible, and grips
with the fingers bent otherwise say the rest.

A joint that reads too much displaces every contact beyond it, and the measured centre of mass as well. If
each were given errors of its own, a part of what they say of the pose would be lost. So pose and offsets δq are solved
for together, to first order: if the pose moves by x and the joints read δq more than believed, contact i is off the
surface by r + A (M x - K δq), with M the effect of the object's motion on a contact that stays in the palm, and K that
of the joints.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior, WeightEvidence
from handsight.correction.solve import information_by_contact
from handsight.forces import Weighing
from handsight.objects import ObjectModel
from handsight.rig import Rig

CREEP = 0.1
"""By how much an offset changes from one grip to the next, in its first sigmas: what was learnt grows old."""


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """`JointOffsets` say by how much joints read too much, jointly Gaussian."""

    joints: tuple[str, ...]
    """The j joints that move a tip in the palm."""
    mean: Array
    """(j,) [rad], of slides [m]."""
    covariance: Array
    """(j, j)"""
    sigma: float
    """Of each offset before the first grip [rad]."""
    sigma_reading: float
    """Of what changes from reading to reading [rad]."""

    @classmethod
    def of(cls, rig: Rig) -> "JointOffsets":
        """Returns the offsets before any grip: zero, with the rig's `sigma_joint_offset`."""
        joints, sigma = rig.hand.moving, rig.sigma_joint_offset
        covariance = sigma**2 * np.eye(len(joints))
        return cls(joints, np.zeros(len(joints)), covariance, sigma, rig.sigma_joint)

    @cached_property
    def root(self) -> Array:
        """(j, j) L, L Lᵀ the covariance of the errors that `corrected` positions still have."""
        reading = self.sigma_reading**2 + 1e-18  # offsets known exactly have a root too
        return np.asarray(np.linalg.cholesky(self.covariance + reading * np.eye(len(self.joints))))

    def corrected(self, joint_positions: Mapping[str, float]) -> Mapping[str, float]:
        """Returns joint positions without the offsets; joints that are missing, or no number, stay so."""
        if not self.mean.any():
            return joint_positions
        offsets = dict(zip(self.joints, self.mean.tolist(), strict=True))
        return {name: angle - offsets.get(name, 0.0) for name, angle in joint_positions.items()}

    def after(
        self, model: ObjectModel, contacts: Contacts, by_error: Array, T_palm_object: Array, prior: PosePrior
    ) -> "JointOffsets":
        """Returns the offsets after a grip of an object that is near `T_palm_object` (4, 4), `prior` without touch.

        `contacts` (n) are at positions `corrected` by these offsets; `by_error` (n, 6, j) is their derivative along
        `root`. Offsets that are known exactly stay so.
        """
        if not self.sigma:
            return self
        H, slope = self._normal_equations(model, contacts, by_error, T_palm_object, prior)
        H[6:, 6:] += np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(H)
        crept = covariance[6:, 6:] + (CREEP * self.sigma) ** 2 * np.eye(len(self.joints))
        mean = self.mean - (covariance @ slope)[6:]
        return replace(self, mean=mean, covariance=(crept + crept.T) / 2)

    def shared(
        self,
        model: ObjectModel,
        estimate: PoseEstimate,
        touch: tuple[Contacts, Array],
        prior: PosePrior,
        weight: tuple[Weighing, WeightEvidence],
    ) -> PoseEstimate:
        """Returns the estimate after its contacts and its weight have shared their joints' errors.

        `touch`: contacts and `by_error` as `after` takes them. The estimate stays as it was where it is not a maximum
        at which everything fits, where the object has a symmetry axis, and where the pose would move too far for a
        linear problem.
        """
        T, j = estimate.T_palm_object, len(self.joints)
        at_maximum = np.abs(T - estimate.T_palm_object_maximum).max() < 1e-9
        fits = estimate.consistent and not estimate.outliers and at_maximum
        if not fits or not self.sigma or model.symmetries.axes:
            return estimate
        H, slope = self._normal_equations(model, *touch, T, prior)
        weighing, evidence = weight
        arm = T[:3, :3] @ evidence.center_object
        B = np.zeros((3 + j, 6 + j))
        B[:3, :6], B[3:, 6:] = se3.point_jacobian(arm)[:3], np.eye(j)
        joint = weighing.joint_covariance[1:, 1:].copy()
        joint[:3, :3] = evidence.covariance
        by_weight = np.linalg.inv(joint + 1e-15 * np.eye(3 + j))
        off = np.concatenate([T[:3, 3] + arm - weighing.center_palm, -weighing.mean[4:]])
        H += B.T @ by_weight @ B
        slope += B.T @ by_weight @ off
        covariance = np.linalg.inv(H)
        step = -(covariance @ slope)[:6]
        if not step @ np.linalg.solve(estimate.bounded_covariance, step) < 3.0**2:  # in standard deviations
            return estimate
        C = (covariance[:6, :6] + covariance[:6, :6].T) / 2
        return estimate.with_gaussian(se3.moved(T, step), C, np.asarray(np.linalg.inv(C)))

    def _normal_equations(
        self, model: ObjectModel, contacts: Contacts, by_error: Array, T_palm_object: Array, prior: PosePrior
    ) -> tuple[Array, Array]:
        """Returns H (6 + j, 6 + j) and the slope (6 + j,) of pose and offsets, by the contacts and the pose's prior."""
        K, n = by_error @ np.linalg.inv(self.root), len(contacts)
        alone = contacts.covariance - K @ self.covariance @ K.swapaxes(1, 2)
        given = Contacts.trusted(contacts.points_palm, contacts.normals_palm, alone)
        information, gradient = information_by_contact(model, given, T_palm_object)
        # M: a contact that stays moves the other way in the object's frame.
        M = np.zeros((n, 6, 6))
        M[:, :3, :3] = -np.eye(3)
        M[:, :3, 3:] = se3.skew(contacts.points_palm - T_palm_object[:3, 3])
        M[:, 3:, 3:] = se3.skew(contacts.normals_palm)
        J = np.concatenate([M, -K], axis=2)
        H = (J.swapaxes(1, 2) @ information @ J).sum(axis=0)
        slope = (J.swapaxes(1, 2) @ gradient[..., None]).sum(axis=0)[:, 0]
        by_prior = np.linalg.inv(prior.covariance)
        expected = model.nearest(prior.T_palm_object, T_palm_object)
        H[:6, :6] += by_prior
        slope[:6] -= by_prior @ se3.difference(expected, T_palm_object)
        return H, slope
