"""Registration: the pose from up to thousands of contacts, some of them wrong, in groups that share an error.

The unknowns are the object's pose and the error of each group, a shift and a turn of all its contacts. A turn of the
contacts changes their residuals as the opposite turn of the object does, so one row has the derivatives by both, and
the errors are eliminated by the Schur complement, as landmarks are in bundle adjustment: time and memory are linear in
the contacts. A contact is right, or right but for its normal (near an edge the surface's normal changes within the
error of the point), or wrong; its residuals count by the probabilities of the three.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, factor, in_metres, scale_turns, solve
from handsight._compiled.jit import entry, inner
from handsight._compiled.normal_equations import add_row
from handsight._compiled.records import (
    MEASURED,
    NO_PRIOR,
    PRIOR_TERM,
    TERM,
    UNCERTAINTY,
    VISION_PRIOR,
    WORKSPACE,
)
from handsight._compiled.stack import local
from handsight._compiled.symmetry import nearest, pose_of, store_pose, store_transform
from handsight._compiled.vec3 import Pose, Vec3, add, apply, cross, dot, mul, neg, scale, store, sub, vector
from handsight.correction.kernels.batch import load_evidence
from handsight.correction.kernels.contact_term import Frame, add_contact, distance_row, surface_at, whiten
from handsight.correction.kernels.density import group_gain
from handsight.correction.kernels.integration_options import CALIBRATION
from handsight.correction.kernels.levenberg import LONGEST_STEP, damped_step, retract, step_size
from handsight.correction.kernels.prior_term import about_point, prior_square
from handsight.correction.kernels.search_options import DESCENT, REGISTRATION
from handsight.correction.kernels.spurious_information import (
    add_spurious_information,
    subtract_spurious_information,
)
from handsight.correction.kernels.terms import FIXED_NOISE, PRIOR, WALLS, Evidence, add_evidence, walls_met
from handsight.correction.kernels.uncertainty import column, second_order_information, unobservable
from handsight.objects.kernels.field import FLAT

AGAIN = 0
ANEW = 1
DONE = 2
"""Stages of a descent."""


@inner
def responsibilities(square: float, by_distance: float, wrong: float) -> tuple[float, float, float]:
    """Returns the cost of a contact, and the probabilities that it is right and that its distance alone is.

    `square`, `by_distance`: its squared residuals [σ²], all and of the distance (infinite for one without a normal);
    `wrong`: those of a wrong one. The cost is minus two log of the sum of the three densities.
    """
    right = np.exp(-0.5 * min(square, 1400.0))
    flipped = np.exp(-0.5 * min(by_distance + REGISTRATION.flip_cost, 1400.0))
    total = right + flipped + np.exp(-0.5 * wrong)
    return -2 * np.log(total), right / total, flipped / total


@inner
def add_registered(
    evidence: Evidence, contacts: Any, of_group: Any, groups: Any, pose: Pose, frame: Frame, stage: int,
    squares: Any, own: Any,
) -> float:  # fmt: skip
    """Fills in the equations and the weight of all groups, of which the last has the contacts that are of none; returns
    the contacts' cost.

    `stage`: AGAIN keeps the contacts' last weights, ANEW makes new ones, and DONE also fills in the groups' spurious
    information. `squares` (n, 3) is written: squared residuals, and the probabilities that a contact is right, and that
    its distance alone is.
    """
    model = evidence.model
    field = evidence.model.fine
    cost = 0.0
    for g in range(len(groups)):
        groups[g].equations[:] = 0.0
    for i in range(len(contacts)):
        term = evidence.terms[i]
        group = groups[of_group[i]]
        moved = pose_of(group.pose)
        softness = group.softness
        store(apply(moved, vector(contacts[i].point)), term.contact.point)
        store(mul(moved[0], vector(contacts[i].normal)), term.contact.normal)
        surface = surface_at(evidence.nodes, field, vector(term.contact.point), pose)
        if stage != AGAIN:
            whiten(model, evidence.nodes, field, term, surface)
        own[:] = 0.0
        add_contact(term, surface, frame, own)
        square = own[6, 6]
        by_distance = np.inf
        if term.contact.has_normal:
            by_distance = surface[0] * surface[0] / term.variance_distance
        wrong = REGISTRATION.wrong_cost if term.contact.has_normal else REGISTRATION.wrong_distance
        rho, right, flipped = responsibilities(square / softness, by_distance / softness, wrong)
        cost += softness * rho
        squares[i, 0], squares[i, 1], squares[i, 2] = square, right, flipped
        equations = group.equations
        K = surface[3]
        normal = vector(term.contact.normal)
        if stage == DONE and dot(K[0], K[0]) + dot(K[1], K[1]) + dot(K[2], K[2]) > model.edge_curvature2:
            # An edge stops a contact on one side only: it counts as a plane (see `density.contact_information`).
            own[:] = 0.0
            add_contact(term, (surface[0], normal, normal, FLAT, surface[4]), frame, own)
            for k in range(6):
                own[6, k] = own[k, 6] = 0.0
            own[6, 6] = square
            flipped = 0.0
        for r in range(7):
            for c in range(7):
                equations[r, c] += right * own[r, c]
        if flipped > 1e-6:
            row = distance_row(vector(term.contact.point), neg(surface[1]), surface[0], frame)
            add_row(flipped / term.variance_distance, row, equations)
        if stage == DONE and right > 0.5:
            add_spurious_information(model, evidence.nodes, term, surface, pose, group.spurious)
    for g in range(len(groups) - 1):
        group = groups[g]
        softness = groups[g].softness
        square = 0.0
        for r in range(6):
            for c in range(6):
                square += group.error[r] * group.information[r, c] * group.error[c]
        rho, group.weight, _ = responsibilities(square / softness, np.inf, REGISTRATION.wrong_group)
        group.square = square
        cost += softness * rho
    return cost


@inner
def reduce(group: Any, shared: bool, damping: float, total: Any, u: Any) -> None:
    """Adds a group's equations to `total` without its error: H A⁻¹ L and L A⁻¹ g + H A⁻¹ Λ e, with H and g those of its
    contacts, Λ the information of its error e, L = Λ + damping, and A = H + L."""
    H = group.equations
    L = u.wider
    gradient = group.equations[6]
    if not shared:
        for r in range(7):
            for c in range(7):
                total[r, c] += H[r, c]
        return
    trace = 0.0
    for r in range(6):
        trace += H[r, r] + group.weight * group.information[r, r]
    for r in range(6):
        for c in range(6):
            L[r, c] = group.weight * group.information[r, c] + (damping * trace if r == c else 0.0)
            u.matrix[r, c] = H[r, c] + L[r, c]
    if not factor(u.matrix, 6, 1e-12 * trace, group.factor):
        return
    solve(group.factor, 6, gradient, u.row)
    for r in range(6):
        for c in range(6):
            total[6, r] += L[r, c] * u.row[c]
    for r in range(6):
        u.row[r] = 0.0
        for c in range(6):
            u.row[r] += group.weight * group.information[r, c] * group.error[c]
    solve(group.factor, 6, u.row, u.column)
    for r in range(6):
        for c in range(6):
            total[6, r] += H[r, c] * u.column[c]
    for k in range(6):
        for r in range(6):
            u.row[r] = L[r, k]
        solve(group.factor, 6, u.row, u.column)
        for r in range(6):
            for c in range(6):
                total[r, k] += H[r, c] * u.column[c]


@inner
def moved_group(group: Any, step: Any, center: Vec3, radius: float, u: Any, out: Any) -> None:
    """Fills in `out`, a copy of the GROUP, with pose and error after the step that goes with one of the object's pose:
    A⁻¹ (g + H δx - Λ e)."""
    for r in range(6):
        u.row[r] = group.equations[6, r]
        for c in range(6):
            u.row[r] += group.equations[r, c] * step[c]
            u.row[r] -= group.weight * group.information[r, c] * group.error[c]
    solve(group.factor, 6, u.row, u.column)
    shift = vector(u.column)
    turn = vector(u.column[3:])
    store_pose(retract(pose_of(group.pose), (shift, turn), center, radius), out.pose)
    for r in range(6):
        out.error[r] = group.error[r] + u.column[r]


@inner
def _descend(
    evidence: Evidence, contacts: Any, of_group: Any, groups: Any, pose: Pose, squares: Any
) -> tuple[Pose, float, int, bool]:
    """Returns the pose after a damped descent, its cost, the steps tried, and whether it converged; the groups move
    with it."""
    workspace, u, memory = local(WORKSPACE), local(UNCERTAINTY), local(UNCERTAINTY)
    model = evidence.model
    center = evidence.center
    radius = evidence.model.radius
    last = len(groups) - 1
    kinds = WALLS | FIXED_NOISE | PRIOR
    frame = (center, radius)
    now = workspace.now
    others = u.walls
    trial = groups.copy()
    candidate = pose
    six = u.values
    damping = 1e-9
    cost = np.inf
    tried = -1
    converged = False
    longest = 0.0
    square = np.inf
    while True:
        stage = ANEW if tried < 0 else AGAIN
        new = add_registered(
            evidence, contacts, of_group, trial, candidate, frame, stage, squares, memory.equations
        )
        workspace.next[:] = 0.0
        add_evidence(evidence, kinds, model.fine, candidate, frame, workspace.next)
        new += workspace.next[6, 6]
        tried += 1
        if tried == 0 or new <= cost + 1e-10 * (1 + abs(cost)):
            converged = tried > 0 and square < REGISTRATION.small_step**2
            pose, cost = candidate, new
            for g in range(len(groups)):
                groups[g] = trial[g]
            for r in range(7):
                for c in range(7):
                    others[r, c] = workspace.next[r, c]
            damping = max(0.1 * damping, 1e-12)
        else:
            damping = max(30 * damping, 1e-6)
        if converged or tried == REGISTRATION.max_steps or damping > 1e3:
            return pose, cost, tried, converged
        for r in range(7):
            for c in range(7):
                now[r, c] = others[r, c]
        for g in range(len(groups)):
            reduce(groups[g], g < last, damping, now, u)
        step = damped_step(now, radius, damping, LONGEST_STEP, workspace)
        longest, square = step_size(now, step)
        if longest < DESCENT.short_step * radius / 100:
            square = 0.0
        for r in range(3):
            six[r], six[3 + r] = step[0][r], step[1][r]
        for g in range(last):
            moved_group(groups[g], six, center, radius, u, trial[g])
        candidate = retract(pose, step, center, radius)


@inner
def _sharpen(of_group: Any, groups: Any, squares: Any) -> bool:
    """Fills in each group's next factor on its covariances: that by which its median contact misses, but smaller than
    the last one by at least a few times, and at least 1. Returns whether all are 1."""
    done = True
    for g in range(len(groups)):
        own = squares[of_group == g, 0]
        median = np.median(own) / REGISTRATION.median_square if len(own) else 1.0
        groups[g].softness = max(1.0, min(median, groups[g].softness / REGISTRATION.sharper))
        done = done and groups[g].softness == 1.0
    return done


@inner
def _calibrate(
    evidence: Evidence, contacts: Any, of_group: Any, groups: Any, pose: Pose, here: float, squares: Any, u: Any
) -> None:  # fmt: skip
    """Lowers the eigenvalues of an information [1/m²] in wide directions to what the cost beside the pose shows, with
    the groups moved along; as `uncertainty.calibrated_information` does without groups."""
    model = evidence.model
    memory = local(UNCERTAINTY)
    trial = groups.copy()
    kinds = WALLS | FIXED_NOISE | PRIOR
    frame = (pose[1], 1.0)
    radius = evidence.model.radius
    for k in range(6):
        change = 0.0
        if not 1 / (REGISTRATION.wide_sigma * radius) ** 2 > u.values[k] > 1 / (radius * radius):
            continue
        for side in range(2):
            length = (1 - 2 * side) * CALIBRATION.stride / np.sqrt(u.values[k])
            step = column(u.vectors, k, length, radius)
            store(step[0], memory.values)
            store(step[1], memory.values[3:])
            for g in range(len(groups) - 1):
                moved_group(groups[g], memory.values, pose[1], 1.0, memory, trial[g])
            beside = retract(pose, step, pose[1], 1.0)
            cost = add_registered(
                evidence, contacts, of_group, trial, beside, frame, AGAIN, squares, memory.equations
            )
            memory.prior[:] = 0.0
            add_evidence(evidence, kinds, model.fine, beside, frame, memory.prior)
            rise = (cost + memory.prior[6, 6] - here) / (length * length * u.values[k])
            change += 0.5 * min(max(rise, CALIBRATION.min_factor), 1.0)
        u.values[k] *= change


@inner
def _summarize(
    evidence: Evidence, contacts: Any, of_group: Any, groups: Any, pose: Pose, squares: Any, answer: Any
) -> None:
    """Fills in an ANSWER of a pose, all but the pose itself."""
    model = evidence.model
    u = local(UNCERTAINTY)
    memory = local(UNCERTAINTY)
    last = len(groups) - 1
    frame = (pose[1], 1.0)
    lever = sub(pose[1], evidence.center)
    for g in range(len(groups)):
        group = groups[g]
        group.spurious[:] = 0.0
        turn = scale(vector(group.error[3:]), 1 / model.radius)
        store(add(vector(group.error), cross(turn, lever)), group.error)
        store(turn, group.error[3:])
        scale_turns(group.information, model.radius, u.matrix)
        about_point(u.matrix, lever, group.information)
    add_registered(evidence, contacts, of_group, groups, pose, frame, DONE, squares, memory.equations)
    total = memory.walls
    chi2 = 0.0
    rows = 0.0
    total[:] = 0.0
    for i in range(len(contacts)):
        share = 3.0 if contacts[i].has_normal else 1.0
        rows += squares[i, 1] * share + squares[i, 2]
    for g in range(len(groups)):
        chi2 += groups[g].equations[6, 6] + groups[g].weight * groups[g].square
        subtract_spurious_information(groups[g].equations, groups[g].spurious, model.radius)
        reduce(groups[g], g < last, 0.0, total, u)
    # Where the contacts miss by more than they are said to, all of them are taken to be that much worse.
    excess = chi2 / max(rows - 6, 1.0)
    if rows < REGISTRATION.many_rows or excess < 1 + 3 * np.sqrt(2 / max(rows, 1.0)):
        excess = 1.0
    u.equations[:] = 0.0
    u.prior[:] = 0.0
    u.walls[:] = 0.0
    add_evidence(evidence, WALLS, model.fine, pose, frame, u.walls)
    add_evidence(evidence, FIXED_NOISE, model.fine, pose, frame, u.equations)
    if evidence.prior.kind == VISION_PRIOR:
        add_evidence(evidence, PRIOR, model.fine, pose, frame, u.prior)
    for r in range(6):
        for c in range(6):
            u.by_touch[r, c] = total[r, c] / excess + u.equations[r, c]
            answer.information[r, c] = u.wider[r, c] = u.by_touch[r, c] + u.prior[r, c]
    answer.chi2 = chi2 + u.equations[6, 6] + u.prior[6, 6] + u.walls[6, 6]
    answer.rows = round(rows)
    answer.gain = 0.0
    answer.walls = walls_met(evidence, pose) if u.walls[6, 6] > 0 else 0
    answer.prior_gain = max(group_gain(evidence, u.prior, u), prior_square(evidence.prior, pose))
    answer.outside_gain = group_gain(evidence, u.walls, u)
    answer.open_count = unobservable(model, u.by_touch, pose, answer.unobservable, u)
    in_metres(answer.information, model.radius, u.matrix)
    eigen(u.matrix, u.values, u.vectors)
    _calibrate(evidence, contacts, of_group, groups, pose, answer.cost, squares.copy(), u)
    least = 0.0 if evidence.prior.kind == VISION_PRIOR else 1 / (CALIBRATION.open_sigma * model.radius) ** 2
    volume = 0.0
    for k in range(6):
        volume -= 0.5 * np.log(max(u.values[k], 1 / (model.radius * model.radius)))
    answer.log_weight = volume - answer.cost / 2
    answer.complete = second_order_information(model, least, answer, u)


@entry
def register(
    model: Any, nodes: Any, contacts: Any, crowds: Any, of_group: Any, groups: Any, center: Any, constraints: Any,
    outside: Any, squares: Any, answer: Any,
) -> None:  # fmt: skip
    """Moves the first of `answer` (1,), whose pose is filled in, to the minimum of all evidence, and completes it.

    `crowds` (n,): how many contacts are near each on the surface; `of_group` (n,): its index among `groups`, whose
    error is by steps (τ, radius ω) about `center` (3,); the last one is of contacts without a group. `groups` and
    `squares` (n, 3) are written: squared residuals, and the probabilities that the contact is right, and that its
    distance alone is.
    """
    term = local(PRIOR_TERM)
    measured = local(MEASURED)
    terms = np.empty(len(contacts), TERM)
    load_evidence(model[0], contacts, constraints[0], terms, term, measured)
    if not constraints[0].has_prior:
        term.kind = NO_PRIOR
    for i in range(len(terms)):
        terms[i].crowd = crowds[i]
    hand = outside.copy()
    given = constraints[0]
    row = answer[0]
    evidence = Evidence(model[0], nodes, terms, hand, measured, given, term, vector(center))
    pose = pose_of(row.pose)
    tried = 0
    done = False
    memory = local(UNCERTAINTY).equations
    frame = vector(center), model[0].radius
    for g in range(len(groups)):
        groups[g].softness = np.inf
    while not done:
        # Of the last pose that was accepted: the last one that was tried may be another.
        add_registered(evidence, contacts, of_group, groups, pose, frame, ANEW, squares, memory)
        done = _sharpen(of_group, groups, squares)
        pose, row.cost, more, row.converged = _descend(evidence, contacts, of_group, groups, pose, squares)
        tried += more
    if constraints[0].has_prior:
        pose = nearest(model[0], pose, pose_of(constraints[0].prior.pose))
    row.iterations = tried
    store_pose(pose, row.pose)
    store_transform(pose, row.T_palm_object)
    _summarize(evidence, contacts, of_group, groups, pose, squares, row)
