"""The hand's constant joint errors, learnt from one grip to the next.

A joint reads the same angle too much as long as nobody calibrates it anew. Within a grip that cannot be told from
another pose. But contacts say more than the six numbers of a pose: what is left over says how the offsets can not be,
and grips with the fingers bent otherwise say the rest.
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
"""By how much an offset changes from a grip to the next, in its sigmas at first: what was learnt does not hold for
ever."""


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
    """Of an offset at first [rad]."""
    sigma_reading: float
    """Of what changes from reading to reading [rad]."""

    @classmethod
    def of(cls, rig: Rig) -> "JointOffsets":
        """Returns the offsets as the rig says: none, give or take `sigma_joint_offset`."""
        joints, sigma = rig.hand.moving, rig.sigma_joint_offset
        covariance = sigma**2 * np.eye(len(joints))
        return cls(joints, np.zeros(len(joints)), covariance, sigma, rig.sigma_joint)

    @cached_property
    def root(self) -> Array:
        """(j, j) L, L Lᵀ the covariance of what positions that were `corrected` are still wrong by."""
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
        """Returns the offsets after a grip of an object at about `T_palm_object` (4, 4), where `prior` had it without
        touch.

        `contacts` (n): at positions `corrected` by these offsets; `by_error` (n, 6, j): how they change, along `root`.
        Pose and offsets are solved for together, to first order: where the pose moves by x and the offsets are b more
        than thought, contact i is off the surface by r + A (M x - K b), M what moving the object does to a contact that
        stays, K what the joints do. Offsets that are known exactly stay so.
        """
        if not self.sigma:
            return self
        K, j = by_error @ np.linalg.inv(self.root), len(self.joints)
        alone = contacts.covariance - K @ self.covariance @ K.swapaxes(1, 2)
        given = Contacts.trusted(contacts.points_palm, contacts.normals_palm, alone)
        information, gradient = information_by_contact(model, given, T_palm_object)
        M = np.zeros((len(contacts), 6, 6))
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
        H[6:, 6:] += np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(H)
        crept = covariance[6:, 6:] + (CREEP * self.sigma) ** 2 * np.eye(j)
        mean = self.mean - (covariance @ slope)[6:]
        return replace(self, mean=mean, covariance=(crept + crept.T) / 2)
