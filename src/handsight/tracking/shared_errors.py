"""Contacts and weight of one instant, whose errors have the same joints behind them: one linear problem.

A joint that reads too much displaces every contact beyond it, and the centre of mass that the loads tell with them.
Taken for errors of each by itself, a part of what they say of the pose is lost. So pose and joint errors δq are solved
for together, to first order, at a pose that was found without that: contact i is off the surface by r + A (M x - K δq),
M what moving the object by x does to a contact that stays, K what the joints do; the weight says where c is, and what
δq goes with it.
"""

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior, WeightEvidence
from handsight.correction.solve import information_by_contact
from handsight.forces import Weighing
from handsight.objects import ObjectModel
from handsight.tracking.joint_offsets import JointOffsets

SMALL = 3.0
"""In standard deviations: a pose that would move farther is not where the problem is linear."""


def together(
    model: ObjectModel,
    estimate: PoseEstimate,
    touch: tuple[Contacts, Array],
    prior: PosePrior,
    weight: tuple[Weighing, WeightEvidence],
    offsets: JointOffsets,
) -> PoseEstimate:
    """Returns the estimate after its contacts and its weight have shared their joints' errors; as it was where they
    cannot.

    `touch`: the contacts, and how each changes along `offsets.root` (n, 6, j).
    """
    contacts, by_error = touch
    weighing, evidence = weight
    T, j = estimate.T_palm_object, len(offsets.joints)
    at_maximum = np.abs(T - estimate.T_palm_object_maximum).max() < 1e-9
    if (
        not (estimate.consistent and at_maximum and offsets.sigma)
        or estimate.outliers
        or model.symmetries.axes
    ):
        return estimate
    K = by_error @ np.linalg.inv(offsets.root)
    alone = contacts.covariance - K @ offsets.covariance @ K.swapaxes(1, 2)
    given = Contacts.trusted(contacts.points_palm, contacts.normals_palm, alone)
    information, gradient = information_by_contact(model, given, T)
    J = np.concatenate([moved_contacts(contacts, T), -K], axis=2)
    H = (J.swapaxes(1, 2) @ information @ J).sum(axis=0)
    slope = (J.swapaxes(1, 2) @ gradient[..., None]).sum(axis=0)[:, 0]
    by_prior = np.linalg.inv(prior.covariance)
    expected = model.nearest(prior.T_palm_object, T)
    H[:6, :6] += by_prior
    slope[:6] -= by_prior @ se3.difference(expected, T)
    arm = T[:3, :3] @ evidence.center_object
    B = np.zeros((3 + j, 6 + j))
    B[:3, :3], B[:3, 3:6], B[3:, 6:] = np.eye(3), -se3.skew(arm), np.eye(j)
    joint = weighing.joint_covariance[1:, 1:].copy()
    joint[:3, :3] = evidence.covariance
    by_weight = np.linalg.inv(joint + 1e-15 * np.eye(3 + j))
    off = np.concatenate([T[:3, 3] + arm - weighing.center_palm, -weighing.mean[4:]])
    H += B.T @ by_weight @ B
    slope += B.T @ by_weight @ off
    covariance = np.linalg.inv(H)
    step = -(covariance @ slope)[:6]
    own = estimate.bounded_covariance
    if not step @ np.linalg.solve(own, step) < SMALL**2:
        return estimate
    C = (covariance[:6, :6] + covariance[:6, :6].T) / 2
    return estimate.with_gaussian(se3.moved(T, step), C, np.asarray(np.linalg.inv(C)))


def moved_contacts(contacts: Contacts, T_palm_object: Array) -> Array:
    """Returns (n, 6, 6) what moving the object by (δp, δθ) does to contacts that stay: as if they moved the other
    way."""
    M = np.zeros((len(contacts), 6, 6))
    M[:, :3, :3] = -np.eye(3)
    M[:, :3, 3:] = se3.skew(contacts.points_palm - T_palm_object[:3, 3])
    M[:, 3:, 3:] = se3.skew(contacts.normals_palm)
    return M
