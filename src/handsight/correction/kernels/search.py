"""Descents from many starts: where they begin, how promising each is, and the distinct minima that they lead to.

Starts come in blocks (B, M), each for one set of contacts. Repeats are looked for within a block only, so that the
answer is the same on any number of threads.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.records import (
    MEASURED,
    NO_PRIOR,
    POSE,
    PRIOR_TERM,
    TERM,
    UNCERTAINTY,
    WEAK_PRIOR,
)
from handsight._compiled.stack import local
from handsight._compiled.symmetry import are_distinct, pose_of, store_pose
from handsight._compiled.vec3 import (
    Mat33,
    Pose,
    Vec3,
    cross,
    dot,
    matmul,
    mul,
    norm,
    scale,
    sub,
    transpose,
    vector,
)
from handsight.correction.kernels.batch import load_evidence
from handsight.correction.kernels.contact_term import surface_at
from handsight.correction.kernels.levenberg import descend
from handsight.correction.kernels.match import are_near, match
from handsight.correction.kernels.prior_term import drawn, spread
from handsight.correction.kernels.search_options import DESCENT, MATCH, SEARCH
from handsight.correction.kernels.terms import PRIOR, Evidence, evidence_cost

LIMITS = DESCENT.coarse, DESCENT.fine
WORST = 1e300
"""The cost in place of a NaN or a larger one: such a descent is still an answer where there is no better one."""


@entry
def draw(constraints: Any, draws: Any, descents: Any) -> None:
    """Puts descents (K,) at a prior's pose moved by standard normal draws (K, 6) along the object's own axes."""
    prior = constraints[0].prior
    u = local(UNCERTAINTY)
    spread(prior, u)
    for k in range(len(descents)):
        store_pose(drawn(prior, draws[k], u), descents[k].pose)


@inner
def _frame(z: Vec3, hint: Vec3) -> Mat33:
    """Returns a rotation whose third column is `z` and whose first points as far along `hint` as it can."""
    x = sub(hint, scale(z, dot(hint, z)))
    if not norm(x) > 1e-9 * norm(hint):
        least = min(abs(z[0]), min(abs(z[1]), abs(z[2])))
        x = 1.0 if abs(z[0]) == least else 0.0, 1.0 if abs(z[1]) == least else 0.0, 0.0
        if x[0] == 0 and x[1] == 0:
            x = 0.0, 0.0, 1.0
        x = sub(x, scale(z, dot(x, z)))
    x = scale(x, 1 / norm(x))
    return transpose((x, cross(z, x), z))


@entry
def spin(model: Any, anchors: Any, descents: Any) -> None:
    """Lays every surface sample on every anchor, spun about its normal: descents (anchors, spins, samples).

    `anchors` (A, 3, 3): a contact's point and normal, and a direction from which the angles of the spin are counted.
    """
    samples = model[0].samples
    center = vector(model[0].center)
    for a in range(len(anchors)):
        point = vector(anchors[a, 0])
        palm = _frame(vector(anchors[a, 1]), vector(anchors[a, 2]))
        for k in range(descents.shape[1]):
            angle = 2 * np.pi * k / descents.shape[1]
            c, s = np.cos(angle), np.sin(angle)
            spun = matmul(palm, ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
            for i in range(descents.shape[2]):
                place = vector(samples[i, 0])
                R = matmul(spun, transpose(_frame(vector(samples[i, 1]), sub(place, center))))
                store_pose((R, sub(point, mul(R, place))), descents[a, k, i].pose)


@entry
def score(model: Any, nodes: Any, contacts: Any, sigmas: Any, descents: Any, costs: Any) -> None:
    """Fills in the squared residuals of each contact (n,) at each descent (K,): `costs` (K, n).

    `sigmas`: of distance [m] and normal [rad], as coarse as the starts are.
    """
    field = model[0].coarse
    by_distance, by_normal = 1 / sigmas[0] ** 2, 1 / sigmas[1] ** 2
    for k in range(len(descents)):
        pose = pose_of(descents[k].pose)
        for i in range(len(contacts)):
            contact = contacts[i]
            distance, _, facing, _, _ = surface_at(nodes, field, vector(contact.point), pose)
            cost = distance * distance * by_distance
            if contact.has_normal:
                error = sub(facing, vector(contact.normal))
                cost += dot(error, error) * by_normal
            costs[k, i] = cost


@inner
def _repeats(model: Any, rows: Any, k: int, pose: Pose, earlier: Any) -> bool:
    """Returns whether phase 1 led an earlier row nearly to this pose, not counting symmetries; if not, stores the pose.

    `earlier` (M,) POSE: where phase 1 led those of the first k rows that were not repeats.
    """
    for j in range(k):
        if rows[j, 0].cost < np.inf and are_near(model, pose, pose_of(earlier[j])):
            return True
    store_pose(pose, earlier[k])
    return False


@inner
def _select(model: Any, rows: Any, chosen: Any) -> int:
    """Returns how many descents are no repeats of cheaper ones, modulo symmetry; fills `chosen` with their indices,
    cheapest first."""
    count = 0
    taken = np.zeros(len(rows), np.bool_)
    for _ in range(len(rows)):
        best = -1
        least = np.inf
        for k in range(len(rows)):
            if not taken[k] and rows[k, 0].cost < least:
                best = k
                least = rows[k, 0].cost
        if best < 0:
            break
        taken[best] = True
        new = True
        pose = pose_of(rows[best, 0].pose)
        limits = SEARCH.same_after_coarse
        for j in range(count):
            if not are_distinct(model, pose, pose_of(rows[chosen[j], 0].pose), limits):
                new = False
                break
        if new:
            chosen[count] = best
            count += 1
        else:
            rows[best, 0].cost = np.inf
    return count


@entry
def search(model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, blocks: Any) -> None:
    """Moves starts (B, M, 1) to the minima that they lead to; a repeat within its block gets an infinite cost.

    Phase 1 and the coarse field come first, except for starts that are minima of other evidence already (`iterations`
    above 0); then the fine field for those that are left. Without vision blocks are (B, M, 2): along a flat direction
    any place is a minimum, and the second of each is moved on to the most likely one by the weak prior.
    """
    term = local(PRIOR_TERM)
    nothing = local(PRIOR_TERM)
    terms = np.empty(contacts.shape[1], TERM)
    nothing.kind = NO_PRIOR
    given = constraints[0]
    hand = outside.copy()
    measured = local(MEASURED)
    chosen = np.empty(blocks.shape[1], np.int64)
    earlier = np.empty(blocks.shape[1], POSE)
    for b in range(len(blocks)):
        rows = blocks[b]
        center = load_evidence(model[0], contacts[rows[0, 0].set], given, terms, term, measured)
        matching = Evidence(model[0], nodes, terms, hand, measured, given, term, center)
        # The weak prior keeps phase 1 from running away, but is no part of the cost by which minima are compared.
        weak = term.kind == WEAK_PRIOR
        fitting = Evidence(model[0], nodes, terms, hand, measured, given, nothing if weak else term, center)
        count = len(rows)
        ends = 1
        for phase in range(2):
            if phase == 1:
                count = _select(model[0], rows, chosen)
                ends = rows.shape[1]
            for m in range(count * ends):
                k, end = (chosen[m // ends], m % ends) if phase else (m, 0)
                row = rows[k, end]
                pose = pose_of(rows[k, 0].pose)
                steps = rows[k, 0].iterations
                if phase == 0:
                    if row.cost == np.inf:
                        continue
                    if row.iterations > 0:
                        row.cost = 0.0
                        store_pose(pose, earlier[k])
                        continue
                    new = True
                    done = False
                    while new and not done and steps < MATCH.max_steps:
                        left = MATCH.max_steps - steps if steps else SEARCH.first_steps
                        pose, more, done = match(matching, pose, left)
                        steps += more
                        new = not _repeats(model[0], rows, k, pose, earlier)
                    if not new:
                        row.cost = np.inf
                        continue
                evidence = matching if end else fitting
                field = model[0].fine if phase else model[0].coarse
                pose, cost, more, converged = descend(evidence, field, pose, LIMITS[phase], end == 0)
                if end:
                    cost -= evidence_cost(matching, PRIOR, pose)
                row.cost = min(cost, WORST) if cost == cost else WORST
                row.iterations = steps + (0 if end else more)
                row.converged = phase == 1 and converged
                store_pose(pose, row.pose)
