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
from handsight.correction import PosePrior
from handsight.correction.solve import information_by_contact
from handsight.objects import ObjectModel
from handsight.rig import Rig

CREEP = 0.1
"""How much an offset changes from one grip to the next, as a share of its initial sigma: older grips count less."""


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """The constant errors of joints: reading less true position, jointly Gaussian."""

    joints: tuple[str, ...]
    """The j joints that move a tip in the palm."""
    mean: Array
    """(j,) [rad], or [m] for prismatic joints."""
    covariance: Array
    """(j, j) of the offsets."""
    prior: Array
    """(j, j) covariance of the offsets before the first grip."""
    reading: Array
    """(j, j) covariance of the joints' errors that change from reading to reading."""

    @classmethod
    def of(cls, rig: Rig) -> "JointOffsets":
        """Returns the offsets before any grip: zero, with the rig's `sigma_joint_offset`; coupled joints share those
        of the joints that they follow."""
        joints = rig.hand.moving
        constant = rig.joint_errors(joints, rig.sigma_joint_offset)
        changing = rig.sigma_joint * rig.hand.couplings.changes(joints, {})
        prior = constant @ constant.T
        # So that exactly known offsets have a root too.
        reading = changing @ changing.T + 1e-18 * np.eye(len(joints))
        return cls(joints, np.zeros(len(joints)), prior, prior, reading)

    @cached_property
    def root(self) -> Array:
        """(j, j) L, where L Lᵀ is the covariance of the errors that `corrected` positions still have."""
        return np.asarray(np.linalg.cholesky(self.covariance + self.reading))

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
        if not self.prior.diagonal().all():
            return self
        H, slope = self._normal_equations(model, contacts, by_error, T_palm_object)
        by_prior = np.linalg.inv(prior.covariance)
        expected = model.nearest(prior.T_palm_object, T_palm_object)
        H[:6, :6] += by_prior
        slope[:6] -= by_prior @ se3.difference(expected, T_palm_object)
        H[6:, 6:] += np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(H)
        crept = covariance[6:, 6:] + CREEP**2 * self.prior
        mean = self.mean - (covariance @ slope)[6:]
        return replace(self, mean=mean, covariance=(crept + crept.T) / 2)

    def _normal_equations(
        self, model: ObjectModel, contacts: Contacts, by_error: Array, T_palm_object: Array
    ) -> tuple[Array, Array]:
        """Returns H (6 + j, 6 + j) and the slope (6 + j,) of half the cost of the contacts, by pose and offsets."""
        K = by_error @ np.linalg.inv(self.root)
        alone = contacts.covariance - K @ self.covariance @ K.swapaxes(1, 2)
        given = Contacts.trusted(contacts.points_palm, contacts.normals_palm, alone)
        information, gradient = information_by_contact(model, given, T_palm_object)
        # As the object moves, a contact that stays in the palm moves the other way in the object's frame.
        by_pose = np.zeros((len(contacts), 6, 6))
        by_pose[:, :3, :3] = -np.eye(3)
        by_pose[:, :3, 3:] = se3.skew(contacts.points_palm - T_palm_object[:3, 3])
        by_pose[:, 3:, 3:] = se3.skew(contacts.normals_palm)
        J = np.concatenate([by_pose, -K], axis=2)
        H = (J.swapaxes(1, 2) @ information @ J).sum(axis=0)
        slope = (J.swapaxes(1, 2) @ gradient[..., None]).sum(axis=0)[:, 0]
        return H, slope
