"""How well poses explain all touches so far."""

from collections.abc import Sequence

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.rig import Table
from handsight.search.proposals import tip_middle
from handsight.search.touch import Touch

PUSH = 0.001
"""How far a touch moves the object, per axis: older contacts are off by that for each later one [m]."""
FREEDOM = 5.0
"""Of Student's t: a contact at an edge, or beside what it seems to touch, is not what its covariance says."""


def contact_scores(
    model: ObjectModel, touches: Sequence[Touch], table: Table, Ts_world_object: Array
) -> Array:
    """(n, k) logarithms of how likely the k contacts among the touches are at each pose (n, 4, 4).

    Each is of its distance to the surface and of its normal, with Student's tails. The object stands on its table as
    exactly as that is known: height and tilt are marginalised.
    """
    met = [(len(touches) - 1 - i, touch) for i, touch in enumerate(touches)]
    given = [(later, touch.contact_world, touch.radius) for later, touch in met if touch.contact_world]
    R = Ts_world_object[:, :3, :3]
    middle = se3.apply(Ts_world_object, model.center_object[None])[:, 0]
    scores = np.empty((len(Ts_world_object), len(given)))
    for k, (later, contact, radius) in enumerate(given):
        normal, covariance, point = (
            contact.normals_palm[0],
            contact.covariance[0],
            tip_middle(contact, radius),
        )
        values = model.evaluate(np.einsum("nji,nj->ni", R, point - Ts_world_object[:, :3, 3]))
        n = np.einsum("nij,nj->ni", R, values.gradient)
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
        lever = np.cross(point - middle, n)
        of_point = np.trace(covariance[:3, :3]) / 3 + later * PUSH**2 + model.sigma_point**2
        of_distance = of_point + (table.sigma_height * n[:, 2]) ** 2
        of_distance += table.sigma_tilt**2 * (lever[:, :2] ** 2).sum(axis=1)
        bend = (values.hessian**2).sum(axis=(1, 2)) / 2
        of_normal = np.trace(covariance[3:, 3:]) / 2 + model.sigma_normal**2 + table.sigma_tilt**2
        of_normal = of_normal + bend * of_point
        off = 2 * np.arcsin(np.clip(np.linalg.norm(n - normal, axis=1) / 2, 0, 1))
        chi2 = (values.distance - radius) ** 2 / of_distance + off**2 / of_normal
        scores[:, k] = -(FREEDOM + 3) / 2 * np.log1p(chi2 / FREEDOM)
        scores[:, k] -= np.log(of_distance) / 2 + np.log(of_normal)
    return scores


def free_score(model: ObjectModel, touches: Sequence[Touch], Ts_world_object: Array) -> Array:
    """(n,) logarithms of how likely it is at each pose (n, 4, 4) that the tips met nothing where they met nothing.

    All of a sweep is wrong together, so it counts as its deepest point does; and what is inside is hit.
    """
    score = np.zeros(len(Ts_world_object))
    if not model.closed:
        return score
    Ts_object_world = se3.inverse(Ts_world_object)
    for i, touch in enumerate(touches):
        if not len(touch.free_world):
            continue
        points = se3.apply(Ts_object_world, touch.free_world)
        distance = model.evaluate(points.reshape(-1, 3)).distance.reshape(points.shape[:2])
        depth = np.maximum(touch.radius - distance.min(axis=1), 0.0)
        score -= depth**2 / (2 * (touch.sigma**2 + (len(touches) - 1 - i) * PUSH**2))
    return score
