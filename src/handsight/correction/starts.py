"""Where descents begin: draws from the prior, or, blind, poses whose surface reaches a contact.

Draws are made along the object's own axes and ordered by lengths alone, so that another palm frame or another
order of the contacts gives the same starts.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight._kernels.records import DESCENT, POSE, SAMPLES
from handsight._kernels.runtime.threads import in_parts
from handsight._kernels.solve import batch, search
from handsight.checks import Array, Indices, Mask
from handsight.correction.estimate import PosePrior
from handsight.correction.problem import Problem, Records, taken
from handsight.objects import ObjectModel


class StartOptions(NamedTuple):
    """`StartOptions` say where searches start."""

    min_starts: int = 16  # starts from a prior
    max_starts: int = 32  # starts from a wide prior
    draws: int = 1024  # draws that are kept: the same for every problem, along its own axes
    blind_spins: int = 18  # turns about a contact's normal that are tried without vision
    max_anchors: int = 3  # contacts that these are laid on
    blind_kept: int = 384  # starts without vision that are descended from
    max_scoring: int = 20
    """Contacts by which starts without vision are scored: more of them tell no more of poses that are so far off."""
    first_scoring: int = 3  # the farthest contacts, which score every start
    promising: int = 4  # times as many of the best go on to be scored by the others as well
    serial: int = 512  # starts whose scores are not worth another thread


STARTS = StartOptions()


def usual(problem: Problem) -> int:
    """Returns how many starts a problem needs, where one does not do: as the prior is wide, or those of a blind one."""
    if problem.vision is None:
        return STARTS.blind_kept
    w = batch.width(problem.model.record.model, problem.vision.record)
    return int(min(max(round(80 * w), STARTS.min_starts), STARTS.max_starts))


def from_prior(vision: PosePrior, number: int) -> Records:
    """Returns (number,) DESCENT: the prior's own pose, then draws from it."""
    descents = np.zeros(number, dtype=DESCENT)
    draws = _few()[:number] if number <= STARTS.draws else _drawn(number)
    in_parts(partial(search.draw, vision.record), (draws, descents), STARTS.draws)
    return descents


def _drawn(number: int) -> Array:
    """Returns (number, 6) standard normal, the first at zero."""
    draws = np.random.default_rng(0).normal(size=(number, 6))
    draws[0] = 0.0
    return draws


@cache
def _few() -> Array:
    return _drawn(STARTS.draws)


@dataclass(frozen=True)
class Scored:
    """Starts without vision, and what each contact says of each: once, for every set of contacts."""

    descents: Records
    """(K,) DESCENT."""
    costs: Array
    """(K, m)"""
    contacts: Indices
    """(m,) which contacts they are of."""

    def best(self, used: Mask, number: int) -> Records:
        """Returns (number,) those that the contacts in use (n,) fit best, best first."""
        total = self.costs[:, used[self.contacts]].sum(axis=1)
        return taken(self.descents, np.argsort(total, kind="stable")[:number])


def blind(problem: Problem, used: Mask, *, prune: bool) -> Scored:
    """Returns poses in which a sample of the surface meets one of the contacts in use (n,).

    Each of three contacts serves as anchor in turn; where it has a normal the sample's is laid on it and the object
    spun about it, else it is turned at random. `prune`: only those that a few contacts find promising.
    """
    contacts, chosen = problem.contacts, np.flatnonzero(used)
    points = contacts.points_palm[chosen]
    order = np.argsort(np.linalg.norm(points - points.mean(axis=0), axis=1), kind="stable")[::-1]
    normalled = [i for i in order if contacts.has_normal[chosen[i]]]
    anchors = np.array((normalled or list(order))[: STARTS.max_anchors])
    descents = (_spun if normalled else _turned)(
        problem.model, points, contacts.normals_palm[chosen], anchors
    )
    if len(order) > STARTS.max_scoring:
        # Near the middle and far from it.
        order = order[np.linspace(0, len(order) - 1, STARTS.max_scoring).astype(int)]
    heard, sigmas = chosen[order], _sigmas(points, descents)
    if prune and len(heard) > STARTS.first_scoring:
        first = _scores(problem, heard[: STARTS.first_scoring], sigmas, descents).sum(axis=1)
        descents = taken(descents, np.argsort(first, kind="stable")[: len(first) // STARTS.promising])
    return Scored(descents, _scores(problem, heard, sigmas, descents), heard)


def _spun(model: ObjectModel, points: Array, normals: Array, anchors: Indices) -> Records:
    """Returns (K,) DESCENT: every surface sample on the anchors, spun about their normals in even steps from other
    contacts."""
    frames, center = np.zeros(len(anchors), dtype=POSE), points.mean(axis=0)
    for row, a in zip(frames, anchors, strict=True):
        hint = center - points[a] + 1e-6 * (points[a] - points[a - 1])
        row["rotation"], row["position"] = _frame(normals[a], hint), points[a]
    descents = np.zeros((len(anchors), STARTS.blind_spins, SAMPLES), dtype=DESCENT)
    search.spin(model.record.model, frames, descents)
    return descents.reshape(-1)


def _turned(model: ObjectModel, points: Array, _: Array, anchors: Indices) -> Records:
    """Returns (K,) DESCENT: every surface sample on the anchors, turned at random."""
    turns = _turns()
    arms = (turns.reshape(STARTS.blind_spins, SAMPLES, 3, 3) @ model.points_object[:, :, None])[
        ..., 0
    ].reshape(-1, 3)
    descents = np.zeros((len(anchors), len(turns)), dtype=DESCENT)
    descents["pose"]["rotation"] = turns
    descents["pose"]["position"] = points[anchors][:, None] - arms
    return descents.reshape(-1)


@cache
def _turns() -> Array:
    return se3.random(np.random.default_rng(0), STARTS.blind_spins * SAMPLES)[:, :3, :3]


def _frame(z: Array, hint: Array) -> Array:
    """Returns a rotation whose third column is `z` and whose first points as far along `hint` as it can."""
    x = hint - (hint @ z) * z
    if np.linalg.norm(x) < 1e-9 * (np.linalg.norm(hint) + 1e-300) or not x.any():
        x = np.eye(3)[np.argmin(np.abs(z))]
        x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _sigmas(points: Array, descents: Records) -> Array:
    """Returns sigmas of distance [m] and normal [rad]: half a step of the spin, seen from the object's origin."""
    step = 2 * np.pi / STARTS.blind_spins
    origins = descents["pose"]["position"][::16]  # their mean distance from the contacts, of some of them
    reach = np.linalg.norm(points - origins[:, None], axis=-1).mean() * step / 2
    return np.array([reach, step])


def _scores(problem: Problem, chosen: Indices, sigmas: Array, descents: Records) -> Array:
    """Returns (K, m) what contacts (m,) say of each start."""
    costs, contacts = np.empty((len(descents), len(chosen))), problem.contacts.record[chosen]
    given = (*problem.model.record[:2], contacts, sigmas)
    in_parts(partial(search.score, *given), (descents, costs), STARTS.serial)
    return costs
