"""The poses at which descents start: draws from the prior; without vision, poses whose surface meets a contact; past
points of the hand, draws along what the contacts leave open.

Draws are along the object's own axes, and contacts are ordered by distances, so that neither another palm frame nor
another order of the contacts changes the starts.
"""

from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial

import numpy as np

from handsight import se3
from handsight._compiled.records import DESCENT, SAMPLES
from handsight._compiled.threads import in_parts
from handsight.checks import Array, Indices, Mask
from handsight.correction import modes, solve
from handsight.correction.estimate import PosePrior, bounded_covariance
from handsight.correction.kernels import batch, search
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, Records
from handsight.objects import ObjectModel

MIN_STARTS = 16  # with vision: starts from the narrowest prior
MAX_STARTS = 32  # with vision: starts from the widest prior
FINE_STEP = 2
"""With vision, where few contacts may have several minima: one start in so many skips phase 1 and the coarse field,
which lead to none of the minima that only the fine field has."""
BLIND_SPINS = 18  # without vision: turns about a contact's normal that are tried
MAX_ANCHORS = 3  # without vision: contacts on which the surface is laid
BLIND_KEPT = 384  # without vision: starts that are descended from
MAX_SCORING = 20
"""Without vision: most contacts by which starts are scored; more would not rank such coarse poses any better."""
FIRST_SCORING = 3  # without vision: the outermost contacts, by which every start is scored first
PROMISING_STARTS = 4  # one start in so many, of the lowest costs, is then scored by the other contacts too
FEW_SCORES = 512  # starts whose scores are too few to be shared with another thread
PAST_OUTSIDE = 192  # past points of the hand: poses that are drawn in a round along open directions
AROUND_ROUNDS = 3  # rounds, each around the likeliest poses of the round before
AROUND_KEPT = 12  # likeliest poses that are kept of a round
AROUND_SHRINK = 0.3  # factor on the spread from round to round


def usual(problem: Problem) -> int:
    """Returns the number of starts of a problem for which one is not enough; with vision, by the prior's width."""
    if problem.vision is None:
        return BLIND_KEPT
    if modes.several_minima(problem.model, problem.rows, len(problem.contacts)):
        return MAX_STARTS
    w = batch.width(problem.model.record.model, problem.vision.record)
    return int(min(max(round(80 * w), MIN_STARTS), MAX_STARTS))


def from_prior(vision: PosePrior, number: int) -> Records:
    """Returns (number,) DESCENT: the prior's own pose, then draws from it along the object's own axes."""
    kept = 1024  # draws that are cached; every problem takes the first ones of them
    descents = np.zeros(number, dtype=DESCENT)
    search.draw(vision.record, _draws(max(number, kept))[:number], descents)
    return descents


@lru_cache(maxsize=1)
def _draws(number: int) -> Array:
    """Returns standard normal draws (number, 6), the first of them zero."""
    draws = np.random.default_rng(0).normal(size=(number, 6))
    draws[0] = 0.0
    return draws


def past_outside(problem: Problem, vision: PosePrior, number: int) -> Array:
    """Returns poses (K, 4, 4) of low cost by all evidence, drawn around the minimum that contacts and vision have
    without what is outside, found from so many starts, along what it leaves open.

    Points of the hand amid the object push it to the nearest side, which may be the wrong one: they stop descents from
    nearly all draws.
    """
    free = replace(problem, outside=NO_OUTSIDE)
    everyone = problem.everyone
    found = solve.solve(free, from_prior(vision, number)[None], everyone)
    minimum = solve.summaries(free, found.minima[:1], everyone)[0]
    rng = np.random.default_rng(5)
    best = np.array(minimum["T_palm_object"])[None]
    values, vectors = np.linalg.eigh(bounded_covariance(minimum["information"]))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    R = best[0, :3, :3]
    for k in range(AROUND_ROUNDS):
        around = best[np.arange(PAST_OUTSIDE) % len(best)]
        steps = AROUND_SHRINK**k * (rng.normal(size=(len(around), 2, 3)) @ R.T).reshape(-1, 6) @ root
        poses = np.concatenate([best, se3.moved(around, steps)])
        cost = solve.cost(problem, poses, everyone)
        best = poses[np.argsort(cost, kind="stable")[:AROUND_KEPT]]
    return np.asarray(best)


@dataclass(frozen=True)
class ScoredStarts:
    """Starts without vision and the cost of each contact at each, for any set of contacts."""

    descents: Records
    """(K,) DESCENT."""
    costs: Array
    """(K, m) squared residuals of each contact at each start."""
    contacts: Indices
    """(m,) indices of the contacts by which the starts are scored."""

    def best(self, used: Mask, number: int) -> Records:
        """Returns the starts (number,) of the lowest cost by the contacts in use (n,), best first."""
        total = self.costs[:, used[self.contacts]].sum(axis=1)
        return self.descents.take(np.argsort(total, kind="stable")[:number])


def blind(problem: Problem, used: Mask, *, prune: bool) -> ScoredStarts:
    """Returns poses at which a sample of the surface meets one of the contacts in use (n,).

    Each of the outermost contacts is the anchor in turn. If contacts have normals, only these are anchors: the sample's
    normal is laid on the anchor's and the object is spun about it; else the object is turned at random. `prune`: only
    the best by the first few contacts are scored by all, and returned.
    """
    contacts = problem.contacts
    chosen = np.flatnonzero(used)
    points = contacts.points_palm[chosen]
    # The contacts farthest from their centroid come first.
    order = np.argsort(np.linalg.norm(points - points.mean(axis=0), axis=1), kind="stable")[::-1]
    normalled = [i for i in order if contacts.has_normal[chosen[i]]]
    anchors = np.array((normalled or list(order))[:MAX_ANCHORS])
    normals = contacts.normals_palm[chosen]
    descents = (
        _spun(problem.model, points, normals, anchors)
        if normalled
        else _turned(problem.model, points[anchors])
    )
    if len(order) > MAX_SCORING:
        # Evenly from the outermost to the innermost.
        order = order[np.linspace(0, len(order) - 1, MAX_SCORING).astype(int)]
    scoring = chosen[order]
    sigmas = _sigmas(points, descents)
    if prune and len(scoring) > FIRST_SCORING:
        first = _scores(problem, scoring[:FIRST_SCORING], sigmas, descents).sum(axis=1)
        descents = descents.take(np.argsort(first, kind="stable")[: len(first) // PROMISING_STARTS])
    return ScoredStarts(descents, _scores(problem, scoring, sigmas, descents), scoring)


def _spun(model: ObjectModel, points: Array, normals: Array, anchors: Indices) -> Records:
    """Returns (K,) DESCENT: every surface sample on every anchor, spun about its normal in even steps.

    The steps are counted from the direction of the centroid of the contacts, plus a little towards another contact in
    case that the centroid is on the normal.
    """
    hints = points.mean(axis=0) - points[anchors] + 1e-6 * (points[anchors] - points[anchors - 1])
    descents = np.zeros((len(anchors), BLIND_SPINS, SAMPLES), dtype=DESCENT)
    search.spin(model.record.model, np.stack([points[anchors], normals[anchors], hints], axis=1), descents)
    return descents.reshape(-1)


def _turned(model: ObjectModel, points: Array) -> Records:
    """Returns (K,) DESCENT: every surface sample on every anchor's point (a, 3), with the object turned at random."""
    turns = _turns()
    arms = turns.reshape(BLIND_SPINS, SAMPLES, 3, 3) @ model.points_object[:, :, None]
    descents = np.zeros((len(points), len(turns)), dtype=DESCENT)
    descents["pose"]["rotation"] = turns
    descents["pose"]["position"] = points[:, None] - arms.reshape(-1, 3)
    return descents.reshape(-1)


@cache
def _turns() -> Array:
    """Returns random rotations (m, 3, 3), `blind_spins` for each surface sample."""
    return se3.random(np.random.default_rng(0), BLIND_SPINS * SAMPLES)[:, :3, :3]


def _sigmas(points: Array, descents: Records) -> Array:
    """Returns the sigmas of scoring, of distance [m] and of normal [rad]: half a step of the spin at the contacts' mean
    distance from the object's origin, and a step."""
    step = 2 * np.pi / BLIND_SPINS
    origins = descents["pose"]["position"][::16]  # every 16th is enough for a mean
    reach = np.linalg.norm(points - origins[:, None], axis=-1).mean() * step / 2
    return np.array([reach, step])


def _scores(problem: Problem, chosen: Indices, sigmas: Array, descents: Records) -> Array:
    """Returns the cost of each chosen contact (m,) at each start, (K, m)."""
    costs = np.empty((len(descents), len(chosen)))
    contacts = problem.contacts.record[chosen]
    given = (*problem.model.record[:2], contacts, sigmas)
    in_parts(partial(search.score, *given), (descents, costs), FEW_SCORES)
    return costs
