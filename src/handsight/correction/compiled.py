"""The solver in compiled kernels: as `plain`, a hundred times as fast. Importing it costs numba's import."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from handsight._kernels import correct as kernel
from handsight._kernels import layout as at
from handsight._kernels import many
from handsight._kernels.settings import CANDIDATE_APART, OPEN
from handsight._kernels.threads import in_parts
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes, outliers, two_phase
from handsight.correction.estimate import Hypothesis, PoseEstimate, PosePrior, Residuals
from handsight.correction.pack import packed, packed_contacts, packed_poses, packed_prior, unpacked_poses
from handsight.correction.solve import Descent
from handsight.correction.starts import WIDEST_OF_ONE
from handsight.correction.two_phase import KEPT, KEPT_BLIND, Problem
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

FEW = 128
"""Descents that are not worth another thread."""
NO_HAND = np.array([1.0])
NOWHERE = np.empty(0)


def near(problem: Problem, T_start: Array | None = None) -> PoseEstimate | None:
    """The answer from vision's own pose; None where one start may not do, or the contacts do not fit there.

    `T_start` (4, 4): a pose that was right a moment ago, followed however little vision knows.
    """
    model, contacts, vision = problem.model, problem.contacts, problem.vision
    if vision is None:
        return None
    numbers, singles = packed(model)
    if numbers[at.SYMMETRY] == at.OTHER:
        return None
    n = len(contacts.points_palm)
    out, rows, prior = np.empty((1, at.RESIDUALS + 2 * n)), packed_contacts(contacts), packed_prior(vision)
    begins, hand = np.array((0, len(rows))), packed_hand(problem)
    start = NOWHERE if T_start is None else packed_poses(T_start)
    many.correct_all(numbers, singles, rows, begins, prior, start, hand, WIDEST_OF_ONE, out, 0, 1)
    return answer_of_one(contacts, out[0], searched=T_start is not None)


def near_all(model: ObjectModel, problems: Sequence[tuple[Contacts, PosePrior]]) -> list[PoseEstimate | None]:
    """As `near`, of many problems at once."""
    numbers, singles = packed(model)
    if numbers[at.SYMMETRY] == at.OTHER:
        return [None] * len(problems)
    counts = np.array([len(contacts) for contacts, _ in problems])
    begins = np.concatenate([[0], np.cumsum(counts * at.CONTACT)])
    rows = np.concatenate([packed_contacts(contacts) for contacts, _ in problems])
    priors = np.concatenate([packed_prior(vision) for _, vision in problems])
    answers = np.empty((len(problems), at.RESIDUALS + 2 * counts.max()))
    given = (numbers, singles, rows, begins, priors, NOWHERE, NO_HAND, WIDEST_OF_ONE, answers)
    in_parts(partial(many.correct_all, *given), len(problems), FEW // 4)
    # Each estimate keeps its own numbers alive, not those of all.
    found = zip(problems, counts, answers, strict=True)
    return [answer_of_one(problem[0], out[: at.RESIDUALS + 2 * n].copy()) for problem, n, out in found]


def answer_of_one(contacts: Contacts, out: Array, *, searched: bool = False) -> PoseEstimate | None:
    """The answer in a kernel's numbers, or None where it cannot stand.

    `searched`: whether a wrong contact has been looked for; what fits then stands, though one may look suspicious.
    """
    if not out[at.WIDTH] < WIDEST_OF_ONE or not out[at.CONVERGED]:
        return None
    n = len(contacts.points_palm)
    freedom = n + 2 * int(out[at.NORMALS])
    cost = float(out[at.DESCENT_COST])
    if not (modes.fits(cost, freedom) if searched else outliers.fits(cost, freedom, out[at.GAIN])):
        return None
    return _estimate(out, n, freedom, (), (_mode(out, 1.0),))


def kernel_call(model: ObjectModel, contacts: Contacts, vision: PosePrior) -> Any:
    """A call without arguments that runs the two phases of one problem, and nothing else, for measuring."""
    numbers, singles = packed(model)
    rows, prior, out = packed_contacts(contacts), packed_prior(vision), np.empty(at.RESIDUALS)
    return lambda: kernel.two_phases(numbers, singles, rows, prior, NO_HAND, out)


class _Packed:
    """A problem as the kernels take it."""

    def __init__(self, problem: Problem) -> None:
        self.model, self.singles = packed(problem.model)
        self.contacts, prior = packed_contacts(problem.contacts), packed_prior(problem.vision)
        self.sight, self.held, self.center = np.empty(at.SIGHT), np.empty(at.SIGHT), np.empty(3)
        kernel.prepare(self.model, self.contacts, prior, self.sight, self.held, self.center)
        self.first = self.sight if len(prior) else self.held
        self.hand = packed_hand(problem)
        self.floor = 1 / problem.model.radius**2 * (1.0 if problem.vision is None else 1e-9)
        self.least = 1 / (OPEN * problem.model.radius) ** 2 if problem.vision is None else 0.0

    @property
    def evidence(self) -> tuple[Array, Array, Array]:
        """Vision's, what holds the blind, the hand's."""
        return self.sight, self.held, self.hand


def packed_hand(problem: Problem) -> Array:
    """The hand's points after their sigma."""
    if not len(problem.outside_palm):
        return NO_HAND
    terms = problem.hand(problem.model.fine)
    if not terms:
        return NO_HAND
    return np.concatenate([[terms[0].sigma], problem.outside_palm.reshape(-1)])


def solve(problem: Problem, Ts_start: Array, used: Mask) -> tuple[Descent, Mask]:
    """Candidates, cheapest first, and which contacts (K, n) count for each."""
    p, blind = _Packed(problem), problem.vision is None
    poses, found = packed_poses(Ts_start), np.empty((len(Ts_start), 3))
    used = np.ascontiguousarray(used)
    shared = (p.model, p.singles, p.contacts)
    given = (*shared, used, p.first, p.sight, p.hand, p.center, poses, found)
    in_parts(partial(many.approach_all, *given), len(poses), FEW)
    keep = _survivors(problem, poses, found[:, 0], used, KEPT_BLIND if blind else KEPT)
    poses, steps = poses[keep], found[keep, 1]
    used_kept = np.ascontiguousarray(used[keep]) if len(used) > 1 else used
    likely = np.empty((len(keep) if blind else 0, 12))
    found = np.empty((len(keep) + len(likely), 3))
    rest = (*shared, used_kept, *p.evidence, p.center, poses, likely, found)
    in_parts(partial(many.finish_all, *rest), len(poses), FEW)
    used_all = np.broadcast_to(used_kept, (len(keep), used.shape[1]))
    if blind:
        # The most likely places first: of equals they win.
        half = len(keep)
        poses, found = np.concatenate([likely, poses]), np.concatenate([found[half:], found[:half]])
        used_all, steps = np.concatenate([used_all, used_all]), np.concatenate([steps, steps])
    order = np.argsort(found[:, 0], kind="stable")
    poses, found, steps = poses[order], found[order], steps[order]
    iterations = (steps + found[:, 1]).astype(np.int64)
    return Descent(unpacked_poses(poses), found[:, 0], iterations, found[:, 2] > 0), used_all[order]


def _survivors(problem: Problem, poses: Array, costs: Array, used: Mask, most: int) -> Indices:
    """Indices of the descents worth finishing (as `two_phase.survivors`)."""
    order = np.argsort(costs, kind="stable")
    if len(order) == 1:
        return order
    groups = two_phase.groups_of(used, order)
    each = max(2, most // len(groups))
    return np.concatenate([_distinct(problem.model, poses, g, each, CANDIDATE_APART) for g in groups])


def _distinct(
    model: ObjectModel, poses: Array, order: Indices, most: int, limits: tuple[float, float]
) -> Indices:
    numbers, _ = packed(model)
    if numbers[at.SYMMETRY] == at.OTHER:
        return np.array(modes.distinct(model, unpacked_poses(poses), order, most, limits), dtype=np.int64)
    chosen = np.empty(most, dtype=np.int64)
    return chosen[: many.distinct(numbers, poses, order, most, *limits, chosen)]


def largest_gain(problem: Problem, T_palm_object: Array, used: Mask) -> float:
    """The most that χ² falls, to first order, when one contact is left out."""
    return float(_explain(_Packed(problem), packed_poses(T_palm_object[None]), used)[0, at.GAIN])


def _explain(p: _Packed, poses: Array, used: Mask) -> Array:
    answers = np.empty((len(poses), at.RESIDUALS + 2 * used.shape[1]))
    answers[:, :12] = poses
    many.explain_all(
        p.model, p.singles, p.contacts, np.ascontiguousarray(used[0]), *p.evidence, p.least, answers
    )
    return answers


def explained(problem: Problem, descent: Descent, used: Mask) -> PoseEstimate:
    """The answer to a problem from its minima, all of which use the contacts `used` (1, n)."""
    p, model = _Packed(problem), problem.model
    poses = packed_poses(descent.Ts_palm_object)
    if problem.vision is not None:
        if p.model[at.SYMMETRY] == at.OTHER:
            Ts = nearest(model.symmetries, descent.Ts_palm_object, problem.vision.T_palm_object, model.radius)
            poses = packed_poses(Ts)
        else:
            many.nearest_all(p.model, poses, packed_prior(problem.vision)[:12])
    weights = np.empty((len(poses), 2))
    one = np.ascontiguousarray(used[0])
    many.weigh_all(p.model, p.singles, p.contacts, one, *p.evidence, poses, p.floor, weights)
    order = np.argsort(-weights[:, 0], kind="stable")
    chosen = _distinct(model, poses, order, modes.MOST_MODES, modes.APART)
    share = np.exp(weights[chosen, 0] - weights[chosen[0], 0])
    answers = _explain(p, poses[chosen], used)
    answers[:, at.POSTERIOR_COST] = weights[chosen, 1]
    answers[0, at.STEPS] = descent.iterations[chosen[0]]
    answers[0, at.CONVERGED] = descent.converged[chosen[0]]
    ranked = tuple(
        _mode(row, float(weight)) for row, weight in zip(answers, share / share.sum(), strict=True)
    )
    rejected = tuple(int(i) for i in np.flatnonzero(~one))
    return _estimate(answers[0], used.shape[1], two_phase.freedom(problem, used), rejected, ranked)


def cost(problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
    """Minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant."""
    p, costs = _Packed(problem), np.empty(len(Ts_palm_object))
    one, poses = np.ascontiguousarray(used[0]), packed_poses(Ts_palm_object)
    many.cost_all(p.model, p.singles, p.contacts, one, *p.evidence, poses, costs)
    return costs


def _mode(out: Array, weight: float) -> Hypothesis:
    sigma = out[at.COVARIANCE_OUT : at.OPEN_OUT].reshape(6, 6) if out[at.COMPLETE] else None
    information = out[at.INFORMATION_OUT : at.COVARIANCE_OUT].reshape(6, 6)
    T = out[at.TRANSFORM_OUT : at.INFORMATION_OUT].reshape(4, 4)
    return Hypothesis(T, information, sigma, weight, float(out[at.POSTERIOR_COST]))


def _estimate(
    out: Array, n: int, freedom: int, rejected: tuple[int, ...], ranked: tuple[Hypothesis, ...]
) -> PoseEstimate:
    best, open_count = ranked[0], int(out[at.OPEN_COUNT])
    return PoseEstimate(
        T_palm_object=best.T_palm_object,
        covariance=best.covariance,
        information=best.information,
        converged=bool(out[at.CONVERGED]),
        iterations=int(out[at.STEPS]),
        residuals=Residuals(
            out[at.RESIDUALS : at.RESIDUALS + n], out[at.RESIDUALS + n : at.RESIDUALS + 2 * n]
        ),
        unobservable=out[at.OPEN_OUT : at.OPEN_OUT + 6 * open_count].reshape(open_count, 6),
        consistent=modes.fits(float(out[at.CHI2]), freedom),
        outliers=rejected,
        hypotheses=ranked,
    )
