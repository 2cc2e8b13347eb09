"""The entries of a correction: one correction from one start, or one stage of many descents, in one call.

`model` is an object's record in an array of one, `nodes` its grids' nodes. `contacts` (sets, n) are the contacts of a
problem, each set with its own `used`. `constraints` is an array of one CONSTRAINTS. Arguments that range over descents
may be a slice of them, so that several threads share the work.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, in_metres
from handsight._compiled.jit import entry, inner
from handsight._compiled.records import (
    ANSWER,
    DOUBTED,
    FLAT_DIRECTIONS,
    MEASURED,
    PRIOR_TERM,
    TERM,
    UNCERTAINTY,
    WEAK_PRIOR,
)
from handsight._compiled.stack import local
from handsight._compiled.symmetry import (
    are_distinct,
    nearest,
    pose_of,
    store_pose,
    store_transform,
    transform_of,
)
from handsight._compiled.vec3 import Pose, Vec3, cross, dot, norm, vector
from handsight.correction.kernels.contact_term import load_terms, surface_at
from handsight.correction.kernels.density import information, largest_gain, posterior_cost
from handsight.correction.kernels.doubt import is_suspicious, verdict, worst_contact
from handsight.correction.kernels.lattice import visit
from handsight.correction.kernels.levenberg import descend
from handsight.correction.kernels.match import match
from handsight.correction.kernels.mean import to_mean
from handsight.correction.kernels.prior_term import prior_cost, prior_width, vision_prior, weak_position_prior
from handsight.correction.kernels.search_options import DESCENT, MATCH, SEARCH
from handsight.correction.kernels.terms import Evidence, walls_met
from handsight.correction.kernels.uncertainty import summarize

LIMITS = DESCENT.coarse, DESCENT.fine


@inner
def load_evidence(model: Any, contacts: Any, constraints: Any, terms: Any, prior: Any, measured: Any) -> Vec3:
    """Returns the centroid of the contacts (n,); fills in their TERM (n,), and the PRIOR_TERM of the constraints' prior
    or, where they have none, of the weak prior on the position. Nothing is `measured` then."""
    measured.nodes = -1
    measured.points = 0
    center = load_terms(contacts, terms)
    if constraints.has_prior:
        vision_prior(model, constraints.prior, prior, local(UNCERTAINTY))
    else:
        weak_position_prior(model, center, prior)
    return center


@inner
def _solve(evidence: Evidence, pose: Pose, follows: bool, answer: Any) -> Pose:
    """Returns the minimum that a pose leads to in both phases, or, if it `follows`, on the fine field alone; writes
    costs, steps and convergence."""
    model = evidence.model
    steps = 0
    if not follows:
        pose, steps, _ = match(evidence, pose, MATCH.max_steps)
    cost = 0.0
    converged = False
    for phase in range(1 if follows else 0, 2):
        answer.coarse_cost = cost
        field = model.fine if phase else model.coarse
        pose, cost, more, converged = descend(evidence, field, pose, LIMITS[phase], True)
        steps += more
    answer.cost, answer.iterations, answer.converged = cost, steps, converged
    return pose


@inner
def _residual(model: Any, nodes: Any, contact: Any, pose: Pose) -> tuple[float, float]:
    """Returns distance [m] of a contact to the surface, and the angle [rad] between the normals, NaN without
    a normal."""
    distance, _, facing, _, _ = surface_at(nodes, model.fine, vector(contact.point), pose)
    if not contact.has_normal:
        return distance, np.nan
    normal = vector(contact.normal)
    return distance, np.arctan2(norm(cross(facing, normal)), dot(facing, normal))


@entry
def width(model: Any, constraints: Any) -> float:
    """Returns the `prior_width` of the constraints' prior."""
    return prior_width(model[0], constraints[0].prior)


@entry
def correct(
    model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, problems: Any, residuals: Any
) -> int:
    """Solves a problem (1,) at its prior's pose if the prior is narrow enough for one start, else fills in its width
    only. Returns the verdict.

    A problem that `follows` begins at its `start` instead, however wide the prior is; of one that is `pose_only` only
    the pose is computed, for benchmarks. `residuals` (n, 2) are written: distance [m], angle [rad].
    """
    prior, measured, flat = local(PRIOR_TERM), local(MEASURED), local(FLAT_DIRECTIONS)
    hand = outside.copy()
    trial = local(ANSWER)
    problem = problems[0]
    answer = problems[0].answer
    given = constraints[0]
    any_width = problem.follows or problem.pose_only
    answer.width = 0.0 if any_width else prior_width(model[0], given.prior)
    answer.verdict = DOUBTED
    if not answer.width < SEARCH.single_start_width:
        return DOUBTED
    terms = np.empty(len(contacts), TERM)
    center = load_evidence(model[0], contacts, given, terms, prior, measured)
    evidence = Evidence(model[0], nodes, terms, hand, measured, given, prior, center)
    prior_pose = pose_of(given.prior.pose)
    follows = problem.follows != 0
    worst = 0
    coarse_cost = 0.0
    pose = pose_of(problem.start) if follows else prior_pose
    answer.first_order = 0
    answer.weight = 1.0
    # Where a contact does not fit, it may only have led the descent astray: that goes on without the worst one, and
    # from there with all, unless χ² falls less without it than to first order.
    for attempt in range(3):
        pose = _solve(evidence, pose, follows or attempt > 0, trial if attempt == 1 else answer)
        if attempt == 1:
            terms[worst].contact.used = 1
            fall = answer.cost - trial.cost
            if fall < answer.gain:
                terms[worst].contact.gain = fall
                answer.gain = terms[worst_contact(terms)].contact.gain
                if not is_suspicious(answer):
                    break
            continue
        pose = nearest(model[0], pose, prior_pose)
        store_pose(pose, answer.pose)
        store_transform(pose, answer.T_palm_object)
        if problem.pose_only:
            return DOUBTED
        summarize(evidence, pose, answer, flat)
        if attempt == 2:
            answer.coarse_cost = coarse_cost
        elif follows or not is_suspicious(answer):
            break
        else:
            worst = worst_contact(terms)
            coarse_cost = answer.coarse_cost
            terms[worst].contact.used = 0
    answer.verdict = found = verdict(evidence, follows, attempt > 0, answer)
    if found != DOUBTED:
        to_mean(evidence, problems.answer, 0, flat, -np.inf)
    pose = transform_of(answer.T_palm_object)
    for i in range(len(terms)):
        residuals[i, 0], residuals[i, 1] = _residual(model[0], nodes, terms[i].contact, pose)
    return found


@entry
def weigh(model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, descents: Any) -> None:
    """Fills in the weights of minima (K,), log of `exp(-cost/2) √det Σ`, their cost, and the largest gain of a contact;
    the contacts' gains at the first minimum, the cheapest, are written too. Those that cost much more weigh nothing.

    The first set of contacts is used. Σ is over the directions that are known better than by the prior or, without
    vision, better than the object's own size. With a prior the poses are replaced by their equivalents nearest to it.
    """
    term = local(PRIOR_TERM)
    measured = local(MEASURED)
    u = local(UNCERTAINTY)
    radius = model[0].radius
    terms = np.empty(contacts.shape[1], TERM)
    floor = (1e-9 if constraints[0].has_prior else 1.0) / (radius * radius)
    center = load_evidence(model[0], contacts[0], constraints[0], terms, term, measured)
    evidence = Evidence(model[0], nodes, terms, outside.copy(), measured, constraints[0], term, center)
    for k in range(len(descents)):
        descent = descents[k]
        pose = pose_of(descent.pose)
        if descent.cost > descents[0].cost + SEARCH.dear:
            descent.log_weight = -np.inf
            continue
        if constraints[0].has_prior:
            pose = nearest(model[0], pose, pose_of(constraints[0].prior.pose))
            store_pose(pose, descent.pose)
        _, cost = information(evidence, pose, u.wider, u)
        if term.kind == WEAK_PRIOR:
            cost += prior_cost(term, pose)
        in_metres(u.wider, radius, u.matrix)
        eigen(u.matrix, u.values, u.vectors)
        volume = 0.0
        for i in range(6):
            volume -= 0.5 * np.log(max(u.values[i], floor))
        descent.log_weight = volume - cost / 2
        descent.posterior_cost = cost
        descent.gain = largest_gain(evidence, u)
        descent.walls = walls_met(evidence, pose) if u.walls[6, 6] > 0 else 0
        for i in range(len(terms) if k == 0 else 0):
            contacts[0, i].gain = terms[i].contact.gain


@entry
def summarize_all(
    model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, answers: Any
) -> None:
    """Completes answers (K,) whose pose is filled in, with the first set of contacts, and turns them into means where
    they ask for it; the contacts' gains at the first pose are written too."""
    term = local(PRIOR_TERM)
    measured = local(MEASURED)
    terms = np.empty(contacts.shape[1], TERM)
    flat = local(FLAT_DIRECTIONS)
    best = -np.inf
    center = load_evidence(model[0], contacts[0], constraints[0], terms, term, measured)
    evidence = Evidence(model[0], nodes, terms, outside.copy(), measured, constraints[0], term, center)
    for k in range(len(answers)):
        pose = pose_of(answers[k].pose)
        store_transform(pose, answers[k].T_palm_object)
        summarize(evidence, pose, answers[k], flat)
        best = to_mean(evidence, answers, k, flat, best)
        for i in range(len(terms) if k == 0 else 0):
            contacts[0, i].gain = terms[i].contact.gain


@entry
def cost_all(model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, descents: Any) -> None:
    """Fills in minus two log of the posterior density of descents (K,), with the first set of contacts."""
    term = local(PRIOR_TERM)
    measured = local(MEASURED)
    terms = np.empty(contacts.shape[1], TERM)
    center = load_evidence(model[0], contacts[0], constraints[0], terms, term, measured)
    evidence = Evidence(model[0], nodes, terms, outside.copy(), measured, constraints[0], term, center)
    for k in range(len(descents)):
        descents[k].posterior_cost = posterior_cost(evidence, pose_of(descents[k].pose))


@entry
def visit_all(
    model: Any, nodes: Any, contacts: Any, constraints: Any, outside: Any, T_mode: Any, flat: Any, points: Any
) -> None:
    """Fills in points (K,) LATTICE_POINT along the directions `flat` (1,) from a pose (4, 4), with the first set of
    contacts; see `lattice.visit`."""
    term = local(PRIOR_TERM)
    measured = local(MEASURED)
    terms = np.empty(contacts.shape[1], TERM)
    load_evidence(model[0], contacts[0], constraints[0], terms, term, measured)
    mode = transform_of(T_mode)
    u = local(UNCERTAINTY)
    given = constraints[0]
    evidence = Evidence(model[0], nodes, terms, outside.copy(), measured, given, term, mode[1])
    for k in range(len(points)):
        visit(evidence, mode, flat[0], points[k], u)


@entry
def residuals_at(model: Any, nodes: Any, contacts: Any, T_palm_object: Any, residuals: Any) -> None:
    """Writes distance [m] and angle [rad] (n, 2) of contacts (n,) to the surface, at a pose (4, 4)."""
    for i in range(len(contacts)):
        pose = transform_of(T_palm_object)
        residuals[i, 0], residuals[i, 1] = _residual(model[0], nodes, contacts[i], pose)


@entry
def distinct(model: Any, descents: Any, order: Any, limits: Any, chosen: Any) -> int:
    """Returns how many descents, in the given order, repeat no earlier one; fills `chosen` with their indices.

    `limits` (2,): two poses are distinct when they differ by more than a shift [m] or a turn [rad].
    """
    count = 0
    for index in order:
        if count == len(chosen):
            break
        new = True
        for k in range(count):
            pose = pose_of(descents[index].pose)
            other = pose_of(descents[chosen[k]].pose)
            if not are_distinct(model[0], pose, other, limits):
                new = False
                break
        if new:
            chosen[count] = index
            count += 1
    return count
