"""What Python calls: one correction after another, or one stage of many descents, in one call.

`model` is an object's record in an array of one, `nodes` its grids' nodes. `contacts` (sets, n) are the contacts of a
problem, each set with its own `used`. `prior` is one PRIOR, or none for an answer without vision. What ranges over
descents or problems takes a slice of them, so that several threads share the work.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.contact_term import Pose, prepare_term, surface_at
from handsight._kernels.dense6 import eigen, in_metres
from handsight._kernels.levenberg import Evidence, descend
from handsight._kernels.match import match
from handsight._kernels.posterior import information, posterior_cost
from handsight._kernels.prior_term import prior_cost, prior_width, vision_prior, weak_position_prior
from handsight._kernels.records import NO_PRIOR, PRIOR_TERM, TERM, UNCERTAINTY, WEAK_PRIOR
from handsight._kernels.settings import COARSE_LIMITS, FINE_LIMITS, WIDEST_OF_ONE
from handsight._kernels.simd import local
from handsight._kernels.symmetry import are_apart, nearest, pose_of, store_pose
from handsight._kernels.uncertainty import summarize
from handsight._kernels.vec3 import Vec3, add, cross, dot, norm, scale, store, sub, vector

LIMITS = COARSE_LIMITS, FINE_LIMITS


@inner
def _load_terms(contacts: Any, terms: Any) -> Vec3:
    """The centroid of the contacts; fills in their terms."""
    center = (0.0, 0.0, 0.0)
    for i in range(len(contacts)):
        contact, term = contacts[i], terms[i]
        # Field by field: numba assigns no record whole, and checks shapes at length where it assigns arrays.
        store(vector(contact.point), term.contact.point)
        store(vector(contact.normal), term.contact.normal)
        term.contact.has_normal, term.contact.used = contact.has_normal, contact.used
        term.contact.of_residual = contact.of_residual
        for j in range(6):
            for k in range(6):
                term.contact.covariance[j, k] = contact.covariance[j, k]
        prepare_term(contact, term)
        center = add(center, scale(vector(contact.point), 1 / len(contacts)))
    return center


@inner
def _fill_prior(model: Any, prior: Any, center: Vec3, term: Any) -> None:
    """Vision's evidence, or the weak one in its place."""
    if len(prior):
        vision_prior(model, prior[0], term, local(UNCERTAINTY))
    else:
        weak_position_prior(model, center, term)


@inner
def _solve(evidence: Evidence, pose: Pose, follows: bool, answer: Any) -> Pose:
    """The minimum that both phases lead to from a pose, or the fine field alone; writes costs, steps, convergence."""
    model, steps = evidence.model, 0
    if not follows:
        pose, steps = match(evidence, pose)
    cost, converged = 0.0, False
    for phase in range(1 if follows else 0, 2):
        answer.coarse_cost = cost
        field = model.fine if phase else model.coarse
        pose, cost, more, converged = descend(evidence, field, pose, LIMITS[phase], phase >= 0)
        steps += more
    answer.cost, answer.iterations, answer.converged = cost, steps, converged
    return pose


@inner
def _residual(evidence: Evidence, contact: Any, pose: Pose) -> tuple[float, float]:
    """Distance [m] of a contact to the surface, and the angle [rad] between the normals; NaN without one."""
    distance, _, facing, _, _ = surface_at(evidence.nodes, evidence.model.fine, vector(contact.point), pose)
    if not contact.has_normal:
        return distance, np.nan
    normal = vector(contact.normal)
    return distance, np.arctan2(norm(cross(facing, normal)), dot(facing, normal))


@inner
def _store_answer(pose: Pose, answer: Any) -> None:
    store_pose(pose, answer.pose)
    R, p = pose
    for i in range(3):
        for j in range(3):
            answer.T_palm_object[i, j] = R[i][j]
        answer.T_palm_object[i, 3] = p[i]
        answer.T_palm_object[3, i] = 0.0
    answer.T_palm_object[3, 3] = 1.0


@entry
def width(model: Any, prior: Any) -> float:
    """As `prior_width`, of an object and a prior alone."""
    return prior_width(model[0], prior[0])


@entry
def correct_all(model: Any, nodes: Any, contacts: Any, outside: Any, problems: Any, residuals: Any) -> None:
    """Answers every problem from its prior's own pose, where that is narrow enough for one start; else its width only.

    A problem that `follows` begins at a pose near by that was right, however wide the prior is. `contacts` (n,) of all
    problems one after another; `residuals` (n, 2) of each: distance [m], angle [rad].
    """
    prior, room = local(PRIOR_TERM), local(UNCERTAINTY)
    for k in range(len(problems)):
        problem, answer = problems[k], problems[k].answer
        answer.width = 0.0 if problem.follows else prior_width(model[0], problem.prior)
        if not answer.width < WIDEST_OF_ONE:
            continue
        terms = np.empty(problem.last - problem.first, TERM)
        center = _load_terms(contacts[problem.first : problem.last], terms)
        vision_prior(model[0], problem.prior, prior, room)
        evidence = Evidence(model[0], nodes, terms, outside, prior, center)
        prior_pose = pose_of(problem.prior.pose)
        start = pose_of(problem.start) if problem.follows else prior_pose
        pose = _solve(evidence, start, problem.follows != 0, answer)
        pose = nearest(model[0], pose, prior_pose)
        _store_answer(pose, answer)
        answer.first_order, answer.weight = 0, 1.0
        summarize(evidence, pose, answer)
        for i in range(len(terms)):
            row = residuals[problem.first + i]
            row[0], row[1] = _residual(evidence, terms[i].contact, pose)


@entry
def two_phases(model: Any, nodes: Any, contacts: Any, outside: Any, problems: Any) -> None:
    """As `correct_all`, the poses alone: nothing of what an answer says beside it."""
    prior, room = local(PRIOR_TERM), local(UNCERTAINTY)
    for k in range(len(problems)):
        problem, answer = problems[k], problems[k].answer
        terms = np.empty(problem.last - problem.first, TERM)
        center = _load_terms(contacts[problem.first : problem.last], terms)
        vision_prior(model[0], problem.prior, prior, room)
        evidence = Evidence(model[0], nodes, terms, outside, prior, center)
        start = pose_of(problem.prior.pose)
        pose = _solve(evidence, start, problem.follows != 0, answer)
        store_pose(pose, answer.pose)


@entry
def coarse_solve(model: Any, nodes: Any, contacts: Any, prior: Any, outside: Any, descents: Any) -> None:
    """Moves descents (K,) by phase 1 and on the coarse field."""
    term, nothing, terms = local(PRIOR_TERM), local(PRIOR_TERM), np.empty(contacts.shape[1], TERM)
    nothing.kind = NO_PRIOR
    for k in range(len(descents)):
        descent = descents[k]
        center = _load_terms(contacts[descent.set], terms)
        if k == 0:
            _fill_prior(model[0], prior, center, term)
        evidence = Evidence(model[0], nodes, terms, outside, term, center)
        pose, steps = match(evidence, pose_of(descent.pose))
        # The weak prior keeps phase 1 from running away, and has no say in what fits.
        fits = Evidence(model[0], nodes, terms, outside, term if len(prior) else nothing, center)
        pose, descent.cost, more, _ = descend(fits, model[0].coarse, pose, COARSE_LIMITS, k >= 0)
        descent.iterations, descent.converged = steps + more, 0
        store_pose(pose, descent.pose)


@entry
def fine_solve(model: Any, nodes: Any, contacts: Any, prior: Any, outside: Any, descents: Any) -> None:
    """Moves descents (K, 1) on the fine field; of (K, 2), without vision, the second on to the most likely pose.

    Along a slide any place is a minimum; the weak prior on the position says which is the most likely one.
    """
    term, nothing, terms = local(PRIOR_TERM), local(PRIOR_TERM), np.empty(contacts.shape[1], TERM)
    nothing.kind = NO_PRIOR
    for k in range(len(descents)):
        pose, steps = pose_of(descents[k, 0].pose), descents[k, 0].iterations
        center = _load_terms(contacts[descents[k, 0].set], terms)
        if k == 0:
            _fill_prior(model[0], prior, center, term)
        for j in range(descents.shape[1]):
            descent, weak = descents[k, j], term.kind == WEAK_PRIOR
            evidence = Evidence(model[0], nodes, terms, outside, nothing if weak and j == 0 else term, center)
            pose, cost, more, converged = descend(evidence, model[0].fine, pose, FINE_LIMITS, j == 0)
            steps += more if j == 0 else 0
            descent.cost, descent.iterations, descent.converged = cost, steps, converged
            if weak and j == 1:
                descent.cost -= prior_cost(term, pose)
            store_pose(pose, descent.pose)


@entry
def start_costs(
    model: Any, nodes: Any, contacts: Any, sigma_distance: float, sigma_normal: float, descents: Any
) -> None:
    """Fills in what contacts (n,) say of descents (K,), with sigmas [m], [rad] as coarse as the starts are."""
    field = model[0].coarse
    for k in range(len(descents)):
        pose, cost = pose_of(descents[k].pose), 0.0
        for i in range(len(contacts)):
            contact = contacts[i]
            if contact.used:
                distance, _, facing, _, _ = surface_at(nodes, field, vector(contact.point), pose)
                cost += (distance / sigma_distance) ** 2
                if contact.has_normal:
                    error = sub(facing, vector(contact.normal))
                    cost += dot(error, error) / (sigma_normal * sigma_normal)
        descents[k].cost = cost


@entry
def mode_weights(model: Any, nodes: Any, contacts: Any, prior: Any, outside: Any, descents: Any) -> None:
    """Fills in the weights of minima (K,), log of `exp(-cost/2) √det Σ`, and their cost.

    Σ over the directions known better than the prior, or, without vision, than the object's own size.
    """
    term, u, terms = local(PRIOR_TERM), local(UNCERTAINTY), np.empty(contacts.shape[1], TERM)
    radius = model[0].radius
    floor = (1e-9 if len(prior) else 1.0) / (radius * radius)
    for k in range(len(descents)):
        descent = descents[k]
        center = _load_terms(contacts[descent.set], terms)
        if k == 0:
            _fill_prior(model[0], prior, center, term)
        evidence = Evidence(model[0], nodes, terms, outside, term, center)
        pose = pose_of(descent.pose)
        _, cost = information(evidence, pose, u.by_touch, u.wider, u.equations)
        if term.kind == WEAK_PRIOR:
            cost += prior_cost(term, pose)
        in_metres(u.wider, radius, u.matrix)
        eigen(u.matrix, u.values, u.vectors)
        volume = 0.0
        for i in range(6):
            volume -= 0.5 * np.log(max(u.values[i], floor))
        descent.log_weight, descent.posterior_cost = volume - cost / 2, cost


@entry
def summarize_all(model: Any, nodes: Any, contacts: Any, prior: Any, outside: Any, answers: Any) -> None:
    """Completes answers (K,) whose pose is there; of the first set of contacts."""
    term, terms = local(PRIOR_TERM), np.empty(contacts.shape[1], TERM)
    center = _load_terms(contacts[0], terms)
    _fill_prior(model[0], prior, center, term)
    evidence = Evidence(model[0], nodes, terms, outside, term, center)
    for k in range(len(answers)):
        pose = pose_of(answers[k].pose)
        _store_answer(pose, answers[k])
        summarize(evidence, pose, answers[k])


@entry
def cost_all(model: Any, nodes: Any, contacts: Any, prior: Any, outside: Any, descents: Any) -> None:
    """Fills in minus two log of the posterior density of descents (K,), by the first set of contacts."""
    term, terms = local(PRIOR_TERM), np.empty(contacts.shape[1], TERM)
    center = _load_terms(contacts[0], terms)
    _fill_prior(model[0], prior, center, term)
    evidence = Evidence(model[0], nodes, terms, outside, term, center)
    for k in range(len(descents)):
        descents[k].posterior_cost = posterior_cost(evidence, pose_of(descents[k].pose))


@entry
def residuals_at(model: Any, nodes: Any, contacts: Any, descent: Any, residuals: Any) -> None:
    """Distance [m] and angle [rad] (n, 2) of contacts (n,) to the surface, at the first descent's pose."""
    nothing, terms = local(PRIOR_TERM), np.empty(0, TERM)
    evidence = Evidence(model[0], nodes, terms, terms, nothing, (0.0, 0.0, 0.0))
    for i in range(len(contacts)):
        residuals[i, 0], residuals[i, 1] = _residual(evidence, contacts[i], pose_of(descent[0].pose))


@entry
def nearest_all(model: Any, descents: Any, prior: Any) -> None:
    """Replaces the poses of descents (K,) by their equivalents nearest to the prior's."""
    for k in range(len(descents)):
        store_pose(nearest(model[0], pose_of(descents[k].pose), pose_of(prior[0].pose)), descents[k].pose)


@entry
def distinct(model: Any, descents: Any, order: Any, limits: Any, chosen: Any) -> int:
    """How many descents, in the given order, are no repeat of an earlier one; fills `chosen` with them.

    `limits` (2,): apart are poses that differ by more than a shift [m] or a turn [rad].
    """
    count = 0
    for index in order:
        if count == len(chosen):
            break
        new = True
        for k in range(count):
            pose, other = pose_of(descents[index].pose), pose_of(descents[chosen[k]].pose)
            if not are_apart(model[0], pose, other, limits):
                new = False
                break
        if new:
            chosen[count] = index
            count += 1
    return count
