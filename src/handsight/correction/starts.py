"""Where descents begin: draws from the prior; without vision, poses whose surface reaches a contact; on a tactile
array, poses that cover the right taxels.

Draws are made along the object's own axes and ordered by lengths alone, so that another palm frame or another
order of the contacts gives the same starts.
"""

from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight._kernels.records import DESCENT, SAMPLES
from handsight._kernels.runtime.threads import in_parts
from handsight._kernels.solve import batch, search
from handsight.checks import Array, Indices, Mask
from handsight.correction import solve
from handsight.correction.estimate import PoseEstimate, PosePrior
from handsight.correction.problem import Problem, Records, taken
from handsight.objects import ObjectModel


class StartOptions(NamedTuple):
    """`StartOptions` say where searches start."""

    min_starts: int = 16  # starts from a prior
    max_starts: int = 32  # starts from a wide prior
    blind_spins: int = 18  # turns about a contact's normal that are tried without vision
    max_anchors: int = 3  # contacts that these are laid on
    blind_kept: int = 384  # starts without vision that are descended from
    max_scoring: int = 20
    """Contacts by which starts without vision are scored: more of them say no more of poses that are so far off."""
    first_scoring: int = 3  # the farthest contacts, which score every start
    promising: int = 4  # times as many of the best go on to be scored by the others as well
    serial: int = 512  # starts whose scores are not worth another thread
    footprint_draws: int = 384  # poses of a round of draws around those that cover the right taxels
    footprint_rounds: int = 3  # rounds, each around the likeliest poses of the one before
    footprint_kept: int = 12  # likeliest poses of a round
    footprint_shrink: float = 0.3  # factor on the spread of each round


STARTS = StartOptions()


def usual(problem: Problem) -> int:
    """Returns the number of starts of a problem for which one is not enough: with vision by the prior's width."""
    if problem.vision is None:
        return STARTS.blind_kept
    w = batch.width(problem.model.record.model, problem.vision.record)
    return int(min(max(round(80 * w), STARTS.min_starts), STARTS.max_starts))


def from_prior(vision: PosePrior, number: int) -> Records:
    """Returns (number,) DESCENT: the prior's own pose, then draws from it along the object's own axes."""
    kept = 1024  # of these, the first ones are the draws of every problem
    descents, draws = np.zeros(number, dtype=DESCENT), _draws(max(number, kept))[:number]
    in_parts(partial(search.draw, vision.record), (draws, descents), kept)
    return descents


@lru_cache(maxsize=1)
def _draws(number: int) -> Array:
    """Returns (number, 6) standard normal, the first at zero."""
    draws = np.random.default_rng(0).normal(size=(number, 6))
    draws[0] = 0.0
    return draws


def within_footprint(problem: Problem, estimate: PoseEstimate) -> Array:
    """Returns (K, 4, 4) poses at which all evidence is likeliest, drawn around an estimate by the contacts alone.

    For a face that lies on a tactile array: an untouched taxel under it says that the face is too deep, not where it
    should end. That evidence has no slope, and a descent would stay where vision was; so poses are drawn from what the
    contacts leave open.
    """
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    rng = np.random.default_rng(5)
    values, vectors = np.linalg.eigh(estimate.bounded_covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    best, count = estimate.T_palm_object_maximum[None], STARTS.footprint_draws
    for k in range(STARTS.footprint_rounds):
        around = best[np.arange(count) % len(best)]
        steps = STARTS.footprint_shrink**k * rng.normal(size=(count, 6)) @ root.T
        poses = np.concatenate([best, se3.moved(around, steps)])
        cost = solve.cost(problem, poses, used)
        best = poses[np.argsort(cost, kind="stable")[: STARTS.footprint_kept]]
    return best


@dataclass(frozen=True)
class Scored:
    """A `Scored` are starts without vision and each contact's cost of each, once for every set of contacts."""

    descents: Records
    """(K,) DESCENT."""
    costs: Array
    """(K, m)"""
    contacts: Indices
    """(m,) indices of the contacts by which the starts are scored."""

    def best(self, used: Mask, number: int) -> Records:
        """Returns the starts (number,) that fit the contacts in use (n,) best, best first."""
        total = self.costs[:, used[self.contacts]].sum(axis=1)
        return taken(self.descents, np.argsort(total, kind="stable")[:number])


def blind(problem: Problem, used: Mask, *, prune: bool) -> Scored:
    """Returns poses in which a sample of the surface meets one of the contacts in use (n,).

    Each of three contacts is the anchor in turn: where it has a normal the sample's is laid on it and the object spun
    about it, else the object is turned at random. `prune`: only those that a few contacts find promising.
    """
    contacts, chosen = problem.contacts, np.flatnonzero(used)
    points = contacts.points_palm[chosen]
    # The farthest from their centroid first.
    order = np.argsort(np.linalg.norm(points - points.mean(axis=0), axis=1), kind="stable")[::-1]
    normalled = [i for i in order if contacts.has_normal[chosen[i]]]
    anchors = np.array((normalled or list(order))[: STARTS.max_anchors])
    normals = contacts.normals_palm[chosen]
    descents = (
        _spun(problem.model, points, normals, anchors)
        if normalled
        else _turned(problem.model, points[anchors])
    )
    if len(order) > STARTS.max_scoring:
        # Near the middle and far from it.
        order = order[np.linspace(0, len(order) - 1, STARTS.max_scoring).astype(int)]
    scoring, sigmas = chosen[order], _sigmas(points, descents)
    if prune and len(scoring) > STARTS.first_scoring:
        first = _scores(problem, scoring[: STARTS.first_scoring], sigmas, descents).sum(axis=1)
        descents = taken(descents, np.argsort(first, kind="stable")[: len(first) // STARTS.promising])
    return Scored(descents, _scores(problem, scoring, sigmas, descents), scoring)


def _spun(model: ObjectModel, points: Array, normals: Array, anchors: Indices) -> Records:
    """Returns (K,) DESCENT: every surface sample on the anchors, spun about their normals in even steps, which are
    counted from the direction of the other contacts."""
    hints = points.mean(axis=0) - points[anchors] + 1e-6 * (points[anchors] - points[anchors - 1])
    descents = np.zeros((len(anchors), STARTS.blind_spins, SAMPLES), dtype=DESCENT)
    search.spin(model.record.model, np.stack([points[anchors], normals[anchors], hints], axis=1), descents)
    return descents.reshape(-1)


def _turned(model: ObjectModel, points: Array) -> Records:
    """Returns (K,) DESCENT: every surface sample on the anchors' points, turned at random."""
    turns = _turns()
    arms = turns.reshape(STARTS.blind_spins, SAMPLES, 3, 3) @ model.points_object[:, :, None]
    descents = np.zeros((len(points), len(turns)), dtype=DESCENT)
    descents["pose"]["rotation"] = turns
    descents["pose"]["position"] = points[:, None] - arms.reshape(-1, 3)
    return descents.reshape(-1)


@cache
def _turns() -> Array:
    return se3.random(np.random.default_rng(0), STARTS.blind_spins * SAMPLES)[:, :3, :3]


def _sigmas(points: Array, descents: Records) -> Array:
    """Returns sigmas of distance [m] and normal [rad] for scoring: half a step of the spin at a contact, and a step."""
    step = 2 * np.pi / STARTS.blind_spins
    origins = descents["pose"]["position"][::16]  # their mean distance from the contacts, of some of them
    reach = np.linalg.norm(points - origins[:, None], axis=-1).mean() * step / 2
    return np.array([reach, step])


def _scores(problem: Problem, chosen: Indices, sigmas: Array, descents: Records) -> Array:
    """Returns the costs (K, m) of contacts (m,) at each start."""
    costs, contacts = np.empty((len(descents), len(chosen))), problem.contacts.record[chosen]
    given = (*problem.model.record[:2], contacts, sigmas)
    in_parts(partial(search.score, *given), (descents, costs), STARTS.serial)
    return costs
