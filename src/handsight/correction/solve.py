"""Corrections by the compiled solver: from one start, from many, and what is said of the minima."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from handsight._kernels import batch, records
from handsight._kernels.settings import CANDIDATE_APART, WIDEST_OF_ONE
from handsight._kernels.threads import in_parts
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes
from handsight.correction.estimate import PoseEstimate, PosePrior
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, Records, descents_at, poses_of
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

FEW = 128
"""Descents that are not worth another thread."""
ENDED = ["width", "converged", "cost", "coarse_cost", "chi2", "gain", "rows"]
"""What of an answer says whether it can stand."""
KEPT, KEPT_BLIND = 32, 64
"""Candidates that go on from the coarse field to the fine one."""


def solve_single_start(problem: Problem, T_start: Array | None = None) -> PoseEstimate | None:
    """The answer from vision's own pose; None where one start may not do, or the contacts do not fit there.

    `T_start` (4, 4): a pose that was right a moment ago, followed however little vision knows.
    """
    model, contacts, vision = problem.model, problem.contacts.record, problem.vision
    if vision is None or not model.record.symmetry_known:
        return None
    # Zeros, in a fifth of the time that np.zeros takes.
    rows = np.frombuffer(bytearray(records.PROBLEM.itemsize), dtype=records.PROBLEM)
    residuals, row = np.empty((len(contacts), 2)), rows[0]
    row["prior"], row["last"] = vision.record[0], len(contacts)
    if T_start is not None:
        row["follows"] = True
        row["start"]["rotation"], row["start"]["position"] = T_start[:3, :3], T_start[:3, 3]
    batch.correct_all(model.record.model, model.record.nodes, contacts, problem.outside, rows, residuals)
    return _accepted(row["answer"], residuals, searched=T_start is not None)


def solve_batch(
    model: ObjectModel, problems: Sequence[tuple[Contacts, PosePrior]]
) -> list[PoseEstimate | None]:
    """As `solve_single_start`, of many problems at once."""
    if not model.record.symmetry_known:
        return [None] * len(problems)
    counts = np.array([len(contacts) for contacts, _ in problems])
    contacts = np.concatenate([contacts.record for contacts, _ in problems])
    rows, residuals = np.zeros(len(problems), dtype=records.PROBLEM), np.empty((len(contacts), 2))
    rows["prior"] = np.concatenate([vision.record for _, vision in problems])
    rows["last"] = np.cumsum(counts)
    rows["first"] = rows["last"] - counts
    given = (*model.record[:2], contacts, NO_OUTSIDE)
    in_parts(lambda part: batch.correct_all(*given, part, residuals), (rows,), FEW // 4)
    # Each estimate keeps its own numbers alive, not those of all.
    return [
        _accepted(row["answer"].copy(), residuals[row["first"] : row["last"]].copy(), searched=False)
        for row in rows
    ]


def _accepted(answer: np.void, residuals: Array, *, searched: bool) -> PoseEstimate | None:
    """The answer of one start, or None where it cannot stand.

    `searched`: whether a wrong contact has been looked for; what fits then stands, though one may look suspicious.
    """
    # One by one takes twice as long.
    width, converged, cost, coarse_cost, chi2, gain, freedom = answer[ENDED].item()
    if not width < WIDEST_OF_ONE or not converged:
        return None
    if searched:
        stands = modes.fits(cost, freedom)
    else:
        stands = modes.beyond_doubt(cost, coarse_cost, freedom, width / WIDEST_OF_ONE)
        stands = stands and modes.unsuspicious(cost, freedom, gain)
    if not stands:
        return None
    return PoseEstimate(answer, (answer,), residuals, modes.fits(chi2, freedom))


def solve(problem: Problem, Ts_start: Array, used: Mask) -> tuple[Records, Mask]:
    """Minima (K,) DESCENT, cheapest first, and which contacts (K, n) count for each.

    Starts (K, 4, 4) → phase 1 (nearest samples) and the coarse field → the fine field. `used` is (1, n) for all starts
    alike or (K, n) for each its own.
    """
    descents = descents_at(Ts_start)
    masks, descents["set"] = np.unique(used, axis=0, return_inverse=True) if len(used) > 1 else (used, 0)
    given = (*problem.model.record[:2], problem.sets(masks), problem.prior, problem.outside)
    in_parts(partial(batch.coarse_solve, *given), (descents,), FEW)
    kept = descents[survivors(problem.model, descents, KEPT_BLIND if problem.blind else KEPT)]
    # Along a slide any place is a minimum: when blind, beside where each descent ended, the most likely one.
    ended = np.stack([kept, kept], axis=1) if problem.blind else kept[:, None].copy()
    in_parts(partial(batch.fine_solve, *given), (ended,), FEW)
    minima = ended[:, ::-1].T.reshape(-1)  # the most likely first: of equals they win
    minima = minima[np.argsort(minima["cost"], kind="stable")]
    return minima, masks[minima["set"]]


def survivors(model: ObjectModel, coarse: Records, most: int) -> Indices:
    """Indices of the descents worth finishing: cheap and no repeats, apart for each set of contacts."""
    order = np.argsort(coarse["cost"], kind="stable")
    if len(order) == 1:
        return order
    groups = [order[coarse["set"][order] == k] for k in np.unique(coarse["set"])]
    each = max(2, most // len(groups))
    return np.concatenate([distinct(model, coarse, group, each, CANDIDATE_APART) for group in groups])


def distinct(
    model: ObjectModel, descents: Records, order: Indices, most: int, limits: tuple[float, float]
) -> Indices:
    """Indices, in the given order, of descents that are no repeat of an earlier one; at most `most`."""
    if not model.record.symmetry_known:
        chosen = modes.distinct(model, poses_of(descents), order, most, limits)
        return np.array(chosen, dtype=np.int64)
    rows = np.empty(most, dtype=np.int64)
    return rows[: batch.distinct(model.record.model, descents, order, np.array(limits), rows)]


def largest_gain(problem: Problem, minimum: Records, used: Mask) -> float:
    """The most that χ² falls, to first order, when one contact is left out at a minimum (1,)."""
    return float(_summaries(problem, minimum, used)[0]["gain"])


def _summaries(problem: Problem, descents: Records, used: Mask, *, first_order: bool = False) -> Records:
    """(K,) ANSWER where descents (K,) ended; `used` (1, n)."""
    answers = np.zeros(len(descents), dtype=records.ANSWER)
    answers["pose"], answers["first_order"] = descents["pose"], first_order
    answers["iterations"], answers["converged"] = descents["iterations"], descents["converged"]
    given = (*problem.model.record[:2], problem.sets(used), problem.prior, problem.outside)
    batch.summarize_all(*given, answers)
    return answers


def summarize(problem: Problem, minima: Records, used: Mask) -> PoseEstimate:
    """The answer to a problem from its minima (K,), all of which use the contacts `used` (1, n)."""
    model, minima = problem.model, minima.copy()
    minima["set"] = 0
    if problem.vision is not None:
        if model.record.symmetry_known:
            batch.nearest_all(model.record.model, minima, problem.prior)
        else:
            T_vision = problem.vision.T_palm_object
            Ts = nearest(model.symmetries, poses_of(minima), T_vision, model.radius)
            minima["pose"] = descents_at(Ts)["pose"]
    batch.mode_weights(*model.record[:2], problem.sets(used), problem.prior, problem.outside, minima)
    order = np.argsort(-minima["log_weight"], kind="stable")
    chosen = minima[distinct(model, minima, order, modes.MOST_MODES, modes.APART)]
    answers = _summaries(problem, chosen, used)
    share = np.exp(chosen["log_weight"] - chosen["log_weight"][0])
    answers["weight"], answers["log_weight"] = share / share.sum(), chosen["log_weight"]
    answers["posterior_cost"] = chosen["posterior_cost"]
    rejected = tuple(int(i) for i in np.flatnonzero(~used[0]))
    consistent = modes.fits(answers[0]["chi2"], problem.freedom(used))
    return PoseEstimate(answers[0], tuple(answers), residuals(problem, chosen[:1]), consistent, rejected)


def summarize_pose(problem: Problem, descent: Records) -> PoseEstimate:
    """The answer (1,) of another method: its pose as it is, with the uncertainty that our evidence has there."""
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    answer = _summaries(problem, descent, used, first_order=True)[0]
    answer["weight"] = 1.0
    consistent = modes.fits(answer["chi2"], problem.freedom(used))
    return PoseEstimate(answer, (answer,), residuals(problem, descent), consistent)


def residuals(problem: Problem, minimum: Records) -> Array:
    """(n, 2) distance [m] and angle [rad] between each contact and the surface, at a minimum (1,)."""
    rows = np.empty((len(problem.contacts), 2))
    batch.residuals_at(*problem.model.record[:2], problem.contacts.record, minimum, rows)
    return rows


def cost(problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
    """Minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant; `used` (1, n)."""
    descents = descents_at(Ts_palm_object)
    given = (*problem.model.record[:2], problem.sets(used), problem.prior, problem.outside)
    batch.cost_all(*given, descents)
    return np.asarray(descents["posterior_cost"])


def kernel_call(model: ObjectModel, contacts: Contacts, vision: PosePrior) -> Callable[[], None]:
    """A call without arguments that runs the two phases of one problem, and nothing else, for measuring."""
    rows = np.zeros(1, dtype=records.PROBLEM)
    rows["prior"], rows["last"] = vision.record, len(contacts)
    return partial(batch.two_phases, *model.record[:2], contacts.record, NO_OUTSIDE, rows)
