"""Corrections by the compiled solver: from one start, from many, and the answer at a minimum."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from handsight._kernels import records
from handsight._kernels.runtime.threads import in_parts
from handsight._kernels.solve import batch, search
from handsight._kernels.solve.options import SEARCH
from handsight._kernels.touch import surface_at_contacts
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes
from handsight.correction.estimate import PoseEstimate, PosePrior
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Budget, Problem, Records, descents_at, plain, poses_of, taken
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest


class SolveOptions(NamedTuple):
    """`SolveOptions` say how many starts are descended from at once, and how many minima are weighed."""

    serial: int = 128  # descents that are not worth another thread
    block: int = 64  # starts among which repeats are removed before phase 2 ends
    kept: int = 32  # minima that go on to be weighed, where there were more starts than a block
    kept_blind: int = 64  # the same without vision


SOLVE = SolveOptions()


def solve_single_start(problem: Problem, T_start: Array | None = None) -> PoseEstimate | None:
    """Returns the answer from vision's own pose; None where one start may not be enough, or does not fit.

    `T_start` (4, 4): a pose that was right a moment ago, from which to begin however wide vision's prior is.
    """
    model, contacts, vision = problem.model, problem.contacts.record, problem.vision
    if vision is None or not model.record.symmetry_known:
        return None
    # Zeros, in a fifth of the time that np.zeros takes.
    rows = np.frombuffer(bytearray(records.PROBLEM.itemsize), dtype=records.PROBLEM)
    residuals, row = np.empty((len(contacts), 2)), rows[0]
    row["constraints"], row["last"] = problem.constraints[0], len(contacts)
    if T_start is not None:
        row["follows"] = True
        row["start"]["rotation"], row["start"]["position"] = T_start[:3, :3], T_start[:3, 3]
    batch.correct_all(model.record.model, model.record.nodes, contacts, problem.outside, rows, residuals)
    return _accepted(row["answer"], residuals, searched=T_start is not None)


def solve_batch(
    model: ObjectModel, problems: Sequence[tuple[Contacts, PosePrior]]
) -> list[PoseEstimate | None]:
    """Returns the answers of `solve_single_start` to many problems of one object."""
    if not model.record.symmetry_known:
        return [None] * len(problems)
    counts = np.array([len(contacts) for contacts, _ in problems])
    contacts = np.concatenate([contacts.record for contacts, _ in problems])
    rows, residuals = np.zeros(len(problems), dtype=records.PROBLEM), np.empty((len(contacts), 2))
    # The first field of a problem; as numbers its copy takes a hundredth of the time.
    constraints = np.concatenate([plain(vision.record) for _, vision in problems])
    plain(rows)[:, : constraints.shape[1]] = constraints
    rows["last"] = np.cumsum(counts)
    rows["first"] = rows["last"] - counts
    given = (*model.record[:2], contacts, NO_OUTSIDE)
    in_parts(lambda part: batch.correct_all(*given, part, residuals), (rows,), SOLVE.serial // 4)
    # Copies, so that an estimate does not keep the numbers of all others in memory.
    return [
        _accepted(row["answer"].copy(), residuals[row["first"] : row["last"]].copy(), searched=False)
        for row in rows
    ]


def _accepted(answer: np.void, residuals: Array, *, searched: bool) -> PoseEstimate | None:
    """Returns the answer of one start, or None where it has to be doubted.

    `searched`: whether a wrong contact has been searched for already; then an answer that fits is enough.
    """
    ended = ["width", "converged", "cost", "coarse_cost", "chi2", "gain", "rows"]
    # Each field by itself would take twice as long.
    width, converged, cost, coarse_cost, chi2, gain, freedom = answer[ended].item()
    if not width < SEARCH.single_start_width or not converged:
        return None
    if searched:
        stands = modes.fits(cost, freedom)
    else:
        stands = modes.beyond_doubt(cost, coarse_cost, freedom, width / SEARCH.single_start_width)
        stands = stands and modes.unsuspicious(cost, freedom, gain)
    if not stands:
        return None
    return PoseEstimate(answer, (answer,), residuals, modes.fits(chi2, freedom))


@dataclass(frozen=True, slots=True)
class Candidates:
    """`Candidates` are minima of one and the same set of contacts."""

    minima: Records
    """(K,) DESCENT, weighed, cheapest first."""
    used: Mask
    """(1, n) bool."""
    freedom: int
    """Degrees of freedom of the χ² at a minimum."""

    @property
    def cost(self) -> float:
        """The cost of the cheapest."""
        return float(self.minima["cost"][0])

    @property
    def converged(self) -> bool:
        """Whether the cheapest is a minimum."""
        return bool(self.minima["converged"][0])

    def fits(self, alarm: float = modes.MODES.alarm) -> bool:
        """Returns whether the cheapest has squares below their 1 - alarm quantile."""
        return modes.fits(self.cost, self.freedom, alarm)

    def with_more(self, other: "Candidates") -> "Candidates":
        """Returns the minima of both, which use the same contacts."""
        minima = np.concatenate([plain(self.minima), plain(other.minima)]).view(records.DESCENT)[:, 0]
        minima = taken(minima, np.argsort(minima["cost"], kind="stable"))
        return Candidates(minima, self.used, self.freedom)


def solve(problem: Problem, starts: Records, used: Mask, budget: Budget | None = None) -> Candidates:
    """Returns the minima of one of the sets of contacts in `used` (S, n): that with the cheapest minimum of all.

    Starts (S, M) of each set → phase 1 (nearest samples) and the coarse field → the fine field. When the budget is
    spent, the starts that are left are skipped; the first never are.
    """
    model = problem.model
    work = partial(search.search, *problem.arguments(used))
    blocks = _searched(work, _blocks(starts, 2 if problem.blind else 1), budget)
    descents, ends = blocks.reshape(-1), blocks.shape[2]
    # The places of those that ended at a minimum of their own; of these, the ones of the best set.
    ended = ends * np.flatnonzero(descents["cost"][::ends] < np.inf)
    best = descents["set"][ended[descents["cost"][ended].argmin()]]
    if len(used) > 1:
        ended = ended[descents["set"][ended] == best]
    if len(ended) > SOLVE.block // 2:
        order = ended[np.argsort(descents["cost"][ended], kind="stable")]
        most = SOLVE.kept_blind if problem.blind else SOLVE.kept
        ended = distinct(model, descents, order, most, SEARCH.same_after_coarse)
    if problem.blind:
        # Along a flat direction any place is a minimum. Beside each, the most likely one; of equal ones that wins.
        ended = np.concatenate([ended + 1, ended])
    minima = taken(descents, ended[np.argsort(descents["cost"][ended], kind="stable")])
    minima["set"], chosen = 0, used[best : best + 1]
    if problem.vision is not None and not model.record.symmetry_known:
        Ts = nearest(model.symmetries, poses_of(minima), problem.vision.T_palm_object, model.radius)
        minima["pose"] = descents_at(Ts)["pose"]
    batch.weigh(*problem.arguments(chosen), minima)
    return Candidates(minima, chosen, problem.freedom(chosen))


def _searched(work: Callable[[Records], None], blocks: Records, budget: Budget | None) -> Records:
    """Returns the blocks after the work on them; when the budget is spent, only those worked on, at least the first."""
    least = -(-SOLVE.serial // blocks.shape[1])
    if budget is None or budget.ends == np.inf:
        in_parts(work, (blocks,), least)
        return blocks
    done = 0
    while done < len(blocks) and not (done and budget.spent()):
        in_parts(work, (blocks[done : done + 2 * least],), least)
        done += 2 * least
    return blocks[:done]


def _blocks(starts: Records, ends: int) -> Records:
    """Returns (B, m, ends) DESCENT: starts (S, M), those of one set dealt out evenly to blocks, filled up with descents
    of infinite cost."""
    sets, count = starts.shape
    number = -(-count // SOLVE.block)
    each = -(-count // number)
    dealt = np.zeros((sets, each * number), dtype=records.DESCENT)
    plain(dealt)[:, :count] = plain(starts)
    dealt["set"] = np.arange(sets)[:, None]
    dealt["cost"][:, count:] = np.inf
    blocks = dealt.reshape(sets, each, number).swapaxes(1, 2).reshape(sets * number, each, 1)
    return blocks if ends == 1 else np.repeat(blocks, ends, axis=2)


def distinct(
    model: ObjectModel, descents: Records, order: Indices, most: int, limits: tuple[float, float]
) -> Indices:
    """Returns indices, in the given order, of descents that are no repeat of an earlier one; at most `most`."""
    if not model.record.symmetry_known:
        chosen = modes.distinct(model, poses_of(descents), order, most, limits)
        return np.array(chosen, dtype=np.int64)
    rows = np.empty(most, dtype=np.int64)
    return rows[: batch.distinct(model.record.model, descents, order, np.array(limits), rows)]


def gains(problem: Problem, minimum: Records, used: Mask) -> Array:
    """Returns (n,) by how much χ² falls, to first order, when each contact is left out at a minimum (1,); `used` (1,
    n)."""
    arguments, answers = problem.arguments(used), np.zeros(1, dtype=records.ANSWER)
    answers["pose"], answers["first_order"] = minimum["pose"], True
    batch.summarize_all(*arguments, answers)
    return np.where(used[0], arguments[2][0]["gain"], 0.0)


def summaries(problem: Problem, descents: Records, used: Mask, *, first_order: bool = False) -> Records:
    """Returns (K,) ANSWER at the ends of descents (K,); `used` (1, n)."""
    answers = np.zeros(len(descents), dtype=records.ANSWER)
    answers["pose"], answers["first_order"] = descents["pose"], first_order
    answers["iterations"], answers["converged"] = descents["iterations"], descents["converged"]
    batch.summarize_all(*problem.arguments(used), answers)
    return answers


def summarize(problem: Problem, found: Candidates) -> PoseEstimate:
    """Returns the answer to a problem from its minima."""
    minima, used = found.minima, found.used
    order, chosen = np.argsort(-minima["log_weight"], kind="stable"), minima
    if len(minima) > 1:
        chosen = taken(minima, distinct(problem.model, minima, order, modes.MODES.max_modes, modes.SAME_MODE))
    answers = summaries(problem, chosen, used)
    share = np.exp(chosen["log_weight"] - chosen["log_weight"][0])
    answers["weight"], answers["log_weight"] = share / share.sum(), chosen["log_weight"]
    answers["posterior_cost"] = chosen["posterior_cost"]
    rejected = tuple(int(i) for i in np.flatnonzero(~used[0]))
    consistent = modes.fits(answers[0]["chi2"], found.freedom)
    return PoseEstimate(answers[0], tuple(answers), residuals(problem, chosen[:1]), consistent, rejected)


def summarize_pose(problem: Problem, descent: Records) -> PoseEstimate:
    """Returns another method's answer at a descent (1,): its pose, with the uncertainty of our evidence there."""
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    answer = summaries(problem, descent, used, first_order=True)[0]
    answer["weight"] = 1.0
    consistent = modes.fits(answer["chi2"], problem.freedom(used))
    return PoseEstimate(answer, (answer,), residuals(problem, descent), consistent)


def residuals(problem: Problem, minimum: Records) -> Array:
    """Returns (n, 2) distance [m] and angle [rad] between each contact and the surface, at a minimum (1,)."""
    rows = np.empty((len(problem.contacts), 2))
    batch.residuals_at(*problem.model.record[:2], problem.contacts.record, minimum, rows)
    return rows


def cost(problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
    """Returns minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant; `used` (1, n)."""
    descents = descents_at(Ts_palm_object)
    batch.cost_all(*problem.arguments(used), descents)
    return np.asarray(descents["posterior_cost"])


def information_by_contact(
    model: ObjectModel, contacts: Contacts, T_palm_object: Array
) -> tuple[Array, Array]:
    """Returns the information (n, 6, 6) about (point, normal) of each contact itself, with the object at
    `T_palm_object` (4, 4), and the gradient (n, 6) of half its squared residuals.

    Along the palm's axes, by [m] and by a change of the unit normal.
    """
    information, gradient = np.empty((len(contacts), 6, 6)), np.empty((len(contacts), 6))
    given = (*model.record[:2], contacts.record, descents_at(T_palm_object[None]))
    surface_at_contacts.information_by_contact(*given, information, gradient)
    return information, gradient


def kernel_call(model: ObjectModel, contacts: Contacts, vision: PosePrior) -> Callable[[], None]:
    """Returns a call without arguments that runs the two phases of one problem, and nothing else, for measuring."""
    rows = np.zeros(1, dtype=records.PROBLEM)
    rows["constraints"], rows["last"], rows["pose_only"] = vision.record, len(contacts), True
    given = (*model.record[:2], contacts.record, NO_OUTSIDE)
    return partial(batch.correct_all, *given, rows, np.empty((len(contacts), 2)))
