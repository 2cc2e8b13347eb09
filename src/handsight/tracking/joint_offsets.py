"""The constant errors of a hand's joints: learnt from one grip to the next, and common to all that a grip measures.

A joint reads too much by the same angle until it is calibrated again. Within one grip that looks like another pose of
the object. But contacts measure more than the six numbers of a pose: their residuals exclude some offsets, and grips
with differently bent fingers exclude the others.

A joint that reads too much displaces every contact beyond it, and the measured centre of mass as well. To treat these
errors as independent would lose a part of what they tell of the pose. So pose and offsets δq are solved for together,
to first order: if the pose moves by x and the joints read δq more than estimated, contact i is off the surface by

    r + A (M x - K δq),

where M is the effect of the object's motion on a contact that stays in the palm, and K the effect of the joints.
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
"""How much an offset changes from one grip to the next, as a share of its initial sigma: older grips count less."""


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """`JointOffsets` are the constant errors of joints: reading less true position, jointly Gaussian."""

    joints: tuple[str, ...]
    """The j joints that move a tip in the palm."""
    mean: Array
    """(j,) [rad], or [m] for prismatic joints."""
    covariance: Array
    """(j, j) of the offsets."""
    sigma: float
    """Standard deviation of each offset before the first grip [rad]."""
    sigma_reading: float
    """Standard deviation of a joint's error that changes from reading to reading [rad]."""

    @classmethod
    def of(cls, rig: Rig) -> "JointOffsets":
        """Returns the offsets before any grip: zero, with the rig's `sigma_joint_offset`."""
        joints, sigma = rig.hand.moving, rig.sigma_joint_offset
        covariance = sigma**2 * np.eye(len(joints))
        return cls(joints, np.zeros(len(joints)), covariance, sigma, rig.sigma_joint)

    @cached_property
    def root(self) -> Array:
        """(j, j) L, where L Lᵀ is the covariance of the errors that `corrected` positions still have."""
        reading = self.sigma_reading**2 + 1e-18  # so that exactly known offsets have a root too
        return np.asarray(np.linalg.cholesky(self.covariance + reading * np.eye(len(self.joints))))

    def corrected(self, joint_positions: Mapping[str, float]) -> Mapping[str, float]:
        """Returns joint positions without the offsets; joints that are missing, or not a number, stay so."""
        if not self.mean.any():
            return joint_positions
        offsets = dict(zip(self.joints, self.mean.tolist(), strict=True))
        return {name: angle - offsets.get(name, 0.0) for name, angle in joint_positions.items()}

    def after(
        self, model: ObjectModel, contacts: Contacts, by_error: Array, T_palm_object: Array, prior: PosePrior
    ) -> "JointOffsets":
        """Returns the offsets after a grip of an object near `T_palm_object` (4, 4); `prior`: its pose without touch.

        `contacts` (n) are computed from positions `corrected` by these offsets; `by_error` (n, 6, j) is their
        derivative along the columns of `root`. Offsets that are known exactly stay so.
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
        """Returns the estimate that follows from contacts and weight with common errors of the joints.

        `touch`: contacts and `by_error` as in `after`; `weight`: a weighing, and the evidence that was made of it. The
        estimate is unchanged unless it is a maximum at which everything fits, where the object has an axis of symmetry,
        and where the pose would move too far for a linear problem.
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

    def separated(self, contacts: Contacts, by_error: Array) -> tuple[Array, Array]:
        """Returns the change (n, 6, j) of contacts by the error of each joint, and their covariance (n, 6, 6) without
        the joints' constant errors; the arguments are those of `after`."""
        K = by_error @ np.linalg.inv(self.root)
        return K, contacts.covariance - K @ self.covariance @ K.swapaxes(1, 2)

    def _normal_equations(
        self, model: ObjectModel, contacts: Contacts, by_error: Array, T_palm_object: Array, prior: PosePrior
    ) -> tuple[Array, Array]:
        """Returns H (6 + j, 6 + j) and the slope (6 + j,) of the cost of contacts and prior, by pose and offsets."""
        K, alone = self.separated(contacts, by_error)
        H, slope = contact_equations(model, contacts, alone, -K, T_palm_object)
        by_prior = np.linalg.inv(prior.covariance)
        expected = model.nearest(prior.T_palm_object, T_palm_object)
        H[:6, :6] += by_prior
        slope[:6] -= by_prior @ se3.difference(expected, T_palm_object)
        return H, slope


def contact_equations(
    model: ObjectModel, contacts: Contacts, covariance: Array, by_parameter: Array, T_palm_object: Array
) -> tuple[Array, Array]:
    """Returns H (6 + k, 6 + k) and the slope (6 + k,) of half the cost of n contacts, by the object's pose at
    `T_palm_object` (4, 4) and by k parameters of the robot or of the object.

    `covariance` (n, 6, 6): of each contact's point and normal without the parameters' errors. `by_parameter` (n, 6, k):
    by how much points [m] and normals change if a parameter is larger than believed by one unit.
    """
    n = len(contacts)
    given = Contacts.trusted(contacts.points_palm, contacts.normals_palm, covariance)
    information, gradient = information_by_contact(model, given, T_palm_object)
    # As the object moves, a contact that stays in the palm moves the other way in the object's frame.
    by_pose = np.zeros((n, 6, 6))
    by_pose[:, :3, :3] = -np.eye(3)
    by_pose[:, :3, 3:] = se3.skew(contacts.points_palm - T_palm_object[:3, 3])
    by_pose[:, 3:, 3:] = se3.skew(contacts.normals_palm)
    J = np.concatenate([by_pose, by_parameter], axis=2)
    H = (J.swapaxes(1, 2) @ information @ J).sum(axis=0)
    slope = (J.swapaxes(1, 2) @ gradient[..., None]).sum(axis=0)[:, 0]
    return H, slope
