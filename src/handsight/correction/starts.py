"""Where descents begin: draws from the prior, or, blind, poses whose surface reaches a contact.

Draws are made along the object's own axes and ordered by lengths alone, so that another palm frame or another
order of the contacts gives the same starts.
"""

from functools import cache

import numpy as np

from handsight import se3
from handsight._kernels import batch
from handsight.checks import Array, Mask
from handsight.correction.estimate import PosePrior
from handsight.correction.problem import Problem, Records, descents_at
from handsight.objects import ObjectModel

LEAST_STARTS, MOST_STARTS = 16, 32
FEW = 1024
"""Draws that are kept: the same for every problem, along its own axes."""
BLIND_SPINS = 18
BLIND_KEPT = 384
MOST_HEARD = 20
"""Contacts by which starts without vision are scored: more of them tell no more of poses that are so far off."""


def count(model: ObjectModel, vision: PosePrior) -> int:
    """How many starts a prior of that width needs, where one does not do."""
    w = batch.width(model.record.model, vision.record)
    return int(np.clip(round(80 * w), LEAST_STARTS, MOST_STARTS))


def from_prior(vision: PosePrior, number: int) -> Array:
    """`number` poses (number, 4, 4): the prior's own, then draws from it."""
    T = vision.T_palm_object
    if number == 1:
        return T[None]
    R = T[:3, :3]
    covariance = se3.rotate_covariance(R.T, vision.covariance)
    scale = np.sqrt(np.diagonal(covariance)) + 1e-12
    correlation = covariance / np.outer(scale, scale)
    root = scale[:, None] * np.linalg.cholesky(correlation + 1e-9 * np.eye(6))
    draws = _standard(number) @ root.T
    both = np.hstack([draws[:, :3] @ R.T, draws[:, 3:] @ R.T])
    return se3.moved(np.broadcast_to(T, (number, 4, 4)), both)


def _standard(number: int) -> Array:
    """(number, 6) standard normal, the first at zero."""
    return _few()[:number] if number <= FEW else _drawn(number)


def _drawn(number: int) -> Array:
    draws = np.random.default_rng(0).normal(size=(number, 6))
    draws[0] = 0.0
    return draws


@cache
def _few() -> Array:
    return _drawn(FEW)


def blind(problem: Problem, used: Mask) -> Array:
    """Poses (K, 4, 4) in which a sample of the surface meets a contact, the best by all contacts kept.

    Each contact of the set `used` (1, n) serves as anchor in turn; where it has a normal the sample's is laid on it and
    the object spun about it, else it is turned at random.
    """
    model, contacts = problem.model, problem.contacts
    chosen = np.flatnonzero(used[0])
    points, normals = contacts.points_palm[chosen], contacts.normals_palm[chosen]
    center = points.mean(axis=0)
    order = np.argsort(np.linalg.norm(points - center, axis=1), kind="stable")[::-1]
    normalled = [i for i in order if contacts.has_normal[chosen[i]]]
    anchors = (normalled or list(order))[:3]
    poses = np.concatenate([_anchored(model, points[a], normals[a], points, a) for a in anchors])
    heard = problem.sets(used)[0]
    if len(order) > MOST_HEARD:
        # Near the middle and far from it.
        heard = heard[chosen[order[np.linspace(0, len(order) - 1, MOST_HEARD).astype(int)]]]
    return poses[np.argsort(_start_costs(model, heard, poses), kind="stable")[:BLIND_KEPT]]


def _anchored(model: ObjectModel, point: Array, normal: Array, points: Array, anchor: int) -> Array:
    """Every surface sample on the contact, spun about its normal in even steps from the other contacts."""
    s = len(model.points_object)
    if normal.any():
        palm = _basis(normal, points.mean(axis=0) - point + 1e-6 * (points[anchor - 1] - point))
        sample = np.stack(
            [
                _basis(n, p - model.center_object)
                for n, p in zip(model.normals_object, model.points_object, strict=True)
            ]
        )
        angle = 2 * np.pi * np.arange(BLIND_SPINS) / BLIND_SPINS
        about_z = np.zeros((BLIND_SPINS, 3))
        about_z[:, 2] = angle
        R = palm @ se3.rotation_exp(about_z)[:, None] @ sample.swapaxes(-1, -2)
    else:
        turns = se3.random(np.random.default_rng(0), BLIND_SPINS * s)[:, :3, :3]
        R = turns.reshape(BLIND_SPINS, s, 3, 3)
    p = point - (R @ model.points_object[:, :, None])[..., 0]
    return se3.compose(R, p).reshape(-1, 4, 4)


def _basis(z: Array, hint: Array) -> Array:
    """A rotation whose third column is `z` and whose first points as far along `hint` as it can."""
    x = hint - (hint @ z) * z
    if np.linalg.norm(x) < 1e-9 * (np.linalg.norm(hint) + 1e-300) or not x.any():
        x = np.eye(3)[np.argmin(np.abs(z))]
        x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _start_costs(model: ObjectModel, contacts: Records, poses: Array) -> Array:
    """(K,) what contacts (n,) say of each pose, with standard deviations as coarse as the starts are."""
    step = 2 * np.pi / BLIND_SPINS
    reach = np.linalg.norm(contacts["point"] - poses[:, None, :3, 3], axis=-1).mean() * step / 2
    descents = descents_at(poses)
    batch.start_costs(*model.record[:2], contacts, reach, step, descents)
    return np.asarray(descents["cost"])
