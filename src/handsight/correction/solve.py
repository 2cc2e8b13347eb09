"""Calls of the compiled solver: from one start, from many, and for the answer at a minimum."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from handsight._kernels.records import ANSWER, CONSTRAINTS, DESCENT, DOUBTED, ENOUGH, PROBLEM
from handsight._kernels.runtime.threads import in_parts
from handsight._kernels.solve import batch, search
from handsight._kernels.solve.options import ACCEPTANCE, SEARCH
from handsight._kernels.touch import surface_at_contacts
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import conflicts, modes
from handsight.correction.estimate import PoseEstimate
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Budget, Problem, Records, descents_at, plain, poses_of, taken
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest


class SolveOptions(NamedTuple):
    """`SolveOptions` are the numbers of descents that go together, and of minima that are weighed."""

    serial: int = 128  # descents that are too few to be shared with another thread
    block: int = (
        64  # starts that one call of the kernel descends from; it removes repeats among them on the way
    )
    kept: int = 32  # most minima that are weighed
    kept_blind: int = 64  # the same without vision


SOLVE = SolveOptions()


def solve_usual(
    model: ObjectModel,
    contacts: Contacts,
    constraints: Records,
    outside: Records,
    mean: int,
    T_start: Array | None = None,
) -> tuple[PoseEstimate | None, bool]:
    """Returns the answer of one descent, None where it is certainly not enough, and whether it certainly is.

    It is `solve_single_start` of records that are there already (`constraints` (1,) CONSTRAINTS, `outside` (m,)
    OUTSIDE): in a program that does other work between two corrections, whatever Python touches here is read from
    memory, which takes as long as the kernel.
    """
    (record, nodes, known), given = model.record, contacts.record
    if not known:
        return None, False
    rows, residuals = np.ndarray(1, PROBLEM, bytearray(BLANK[mean])), np.ndarray((len(given), 2))
    if T_start is not None:
        row = rows[0]
        row["follows"] = True
        row["start"]["rotation"], row["start"]["position"] = T_start[:3, :3], T_start[:3, 3]
    verdict = batch.correct_all(record, nodes, given, constraints, outside, rows, residuals)
    if verdict == DOUBTED:
        return None, False
    return PoseEstimate.trusted(rows["answer"], residuals), verdict == ENOUGH


def solve_single_start(
    problem: Problem, T_start: Array | None = None, *, mean: int = 0
) -> PoseEstimate | None:
    """Returns the answer of one descent from vision's own pose; None where one start may not be enough, or where the
    evidence does not fit at its end.

    `T_start` (4, 4): a pose that was right a moment ago, at which the descent starts instead, however wide the prior.
    `mean`: that of its ANSWER.
    """
    if problem.vision is None:
        return None
    estimate, enough = solve_usual(
        problem.model, problem.contacts, problem.constraints, problem.outside, mean, T_start
    )
    enough = enough and not problem.taxels and problem.depth is None
    return estimate if estimate is None or enough or fits(problem, estimate) else None


def fits(problem: Problem, estimate: PoseEstimate) -> bool:
    """Returns whether no evidence contradicts the rest at an estimate with all contacts in use."""
    return conflicts.judged(problem, estimate.answer, np.ones((1, len(problem.contacts)), dtype=bool))[0]


_BLANK = np.zeros(3, dtype=PROBLEM)
_BLANK["answer"]["mean"] = range(3)
BLANK = tuple(row.tobytes() for row in _BLANK)
"""The bytes of a PROBLEM by its answer's `mean`: copied, they take a fifth of the time of an array that is filled."""


def solve_batch(
    model: ObjectModel, problems: Sequence[Problem], kinds: Sequence[int]
) -> list[PoseEstimate | None]:
    """Returns the answer of `solve_single_start` to each of many problems of one object, of nothing but contacts and
    vision, each with its own `mean`."""
    if not model.record.symmetry_known:
        return [None] * len(problems)
    counts = np.array([len(problem.contacts) for problem in problems])
    contacts = np.concatenate([problem.contacts.record for problem in problems])
    rows, residuals = np.zeros(len(problems), dtype=PROBLEM), np.empty((len(contacts), 2))
    # Copied as plain numbers they take a hundredth of the time.
    numbers = np.concatenate([plain(problem.constraints) for problem in problems])
    constraints = numbers.view(CONSTRAINTS)[:, 0]
    rows["last"], rows["answer"]["mean"] = np.cumsum(counts), kinds
    rows["first"] = rows["last"] - counts

    def work(given: Records, part: Records) -> None:
        batch.correct_all(*model.record[:2], contacts, given, NO_OUTSIDE, part, residuals)

    in_parts(work, (constraints, rows), SOLVE.serial // 4)
    found: list[PoseEstimate | None] = []
    for problem, row in zip(problems, rows, strict=True):
        # Copied, so that an estimate does not keep the arrays of all problems in memory.
        answer, verdict = np.ndarray(1, ANSWER, bytearray(row["answer"])), row["answer"]["verdict"]
        estimate = PoseEstimate(answer, residuals[row["first"] : row["last"]].copy())
        enough = verdict == ENOUGH or (verdict != DOUBTED and fits(problem, estimate))
        found.append(estimate if enough else None)
    return found


@dataclass(frozen=True, slots=True)
class Candidates:
    """`Candidates` are the minima that were found with one set of contacts in use."""

    minima: Records
    """(K,) DESCENT, weighed, cheapest first."""
    used: Mask
    """(1, n) whether each contact is in use."""
    freedom: int
    """Degrees of freedom of the χ² at a minimum."""
    gains: Array
    """(n,) by how much χ² falls, to first order, when each contact in use is left out, at the cheapest minimum."""
    falls: Array
    """(n,) by how much χ² fell when each contact that is not in use was left out; 0 for the others."""

    @property
    def cost(self) -> float:
        """The cost of the cheapest minimum."""
        return float(self.minima["cost"][0])

    @property
    def converged(self) -> bool:
        """Whether the descent to the cheapest minimum converged."""
        return bool(self.minima["converged"][0])

    def fits(self, alarm: float = ACCEPTANCE.alarm) -> bool:
        """Returns whether the cheapest minimum passes the χ² test of level `alarm`."""
        return modes.fits(self.cost, self.freedom, alarm)

    def with_more(self, other: "Candidates") -> "Candidates":
        """Returns the minima of both, which must use the same contacts."""
        minima = np.concatenate([plain(self.minima), plain(other.minima)]).view(DESCENT)[:, 0]
        minima = taken(minima, np.argsort(minima["cost"], kind="stable"))
        gains = self.gains if self.cost <= other.cost else other.gains
        return replace(self, minima=minima, gains=gains)


def solve(problem: Problem, starts: Records, used: Mask, budget: Budget | None = None) -> Candidates:
    """Returns the minima of one set of contacts: of the sets in `used` (S, n), the one with the cheapest minimum.

    `starts` (S, M): DESCENT, those of each set. All go through phase 1 (nearest samples) and the coarse distance field;
    those that do not repeat another one go on to the fine field. When the budget is spent, the remaining starts are
    skipped, but never the first ones.
    """
    model, arguments, ends = problem.model, problem.arguments(used), 2 if problem.blind else 1
    descents = _searched(partial(search.search, *arguments), _blocks(starts, ends), budget).reshape(-1)
    # The indices of the descents that ended at minima of their own, cheapest first; of these, those of the best set.
    cost = descents["cost"][::ends]
    ended = np.argsort(cost, kind="stable")[: np.count_nonzero(cost < np.inf)] * ends
    best = int(descents["set"][ended[0]])
    if len(used) > 1:
        ended = ended[descents["set"][ended] == best]
    if len(ended) > SOLVE.block // 2:
        most = SOLVE.kept_blind if problem.blind else SOLVE.kept
        ended = distinct(model, descents, ended, most, SEARCH.same_after_coarse)
    if problem.blind:
        # Along a flat direction every place is a minimum. The kernel has put the most likely one beside each minimum;
        # it comes first, so that the stable sort prefers it among equal costs.
        ended = np.concatenate([ended + 1, ended])
        ended = ended[np.argsort(descents["cost"][ended], kind="stable")]
    minima, chosen, contacts = taken(descents, ended), used[best : best + 1], arguments[2][best : best + 1]
    minima["set"] = 0
    if problem.vision is not None and not model.record.symmetry_known:
        Ts = nearest(model.symmetries, poses_of(minima), problem.vision.T_palm_object, model.radius)
        minima["pose"] = descents_at(Ts)["pose"]
    batch.weigh(*arguments[:2], contacts, *arguments[3:], minima)
    return Candidates(minima, chosen, problem.freedom(chosen), contacts["gain"][0], np.zeros(used.shape[1]))


def _searched(work: Callable[[Records], None], blocks: Records, budget: Budget | None) -> Records:
    """Returns the blocks after the work on them, in threads; when the budget is spent, only those that were reached."""
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
    """Returns starts (S, M) as blocks (B, m, ends) of DESCENT, each with starts of one set, dealt out evenly.

    A block that is not full is filled up with descents of infinite cost. With two `ends` each start has a second
    record, for the most likely pose along a flat direction of its minimum.
    """
    sets, count = starts.shape
    number = -(-count // SOLVE.block)
    if sets == number == ends == 1:
        return np.asarray(plain(starts).copy().view(DESCENT))
    each = -(-count // number)
    dealt = np.zeros((sets, each * number), dtype=DESCENT)
    plain(dealt)[:, :count] = plain(starts)
    dealt["set"] = np.arange(sets)[:, None]
    dealt["cost"][:, count:] = np.inf
    blocks = dealt.reshape(sets, each, number).swapaxes(1, 2).reshape(sets * number, each, 1)
    return np.repeat(blocks, ends, axis=2)


def distinct(
    model: ObjectModel, descents: Records, order: Indices, most: int, limits: tuple[float, float]
) -> Indices:
    """Returns the indices of at most `most` descents, in the given order, each distinct from those before.

    `limits`: the shift [m] and the turn [rad] up to which two poses are the same.
    """
    if not model.record.symmetry_known:
        chosen = modes.distinct(model, poses_of(descents), order, most, limits)
        return np.array(chosen, dtype=np.int64)
    rows = np.empty(most, dtype=np.int64)
    return rows[: batch.distinct(model.record.model, descents, order, np.array(limits), rows)]


def summaries(
    problem: Problem, descents: Records, used: Mask, *, first_order: bool = False, mean: int = 0
) -> Records:
    """Returns (K,) ANSWER at the poses of descents (K,), with the contacts `used` (1, n).

    `first_order`: the uncertainty is from the Jacobian alone, for a pose that is no minimum. `mean`: of the first
    ANSWER; the others become no mean where they are Gaussian.
    """
    answers = np.zeros(len(descents), dtype=ANSWER)
    plain(answers)[:, : DESCENT.itemsize // 8] = plain(descents)
    answers["first_order"], answers["mean"], answers["mean"][:1] = first_order, min(mean, 1), mean
    batch.summarize_all(*problem.arguments(used), answers)
    return answers


def summarize(problem: Problem, found: Candidates, *, mean: int = 0) -> Records:
    """Returns (K,) ANSWER of the distinct ones of minima, likeliest first; `mean` is that of the first one."""
    minima = found.minima
    order, chosen = np.argsort(-minima["log_weight"], kind="stable"), minima
    if len(minima) > 1:
        order = order[
            : np.count_nonzero(minima["log_weight"] > minima["log_weight"][order[0]] - SEARCH.negligible)
        ]
        each = distinct(problem.model, minima, order, modes.MODES.max_modes, modes.SAME_MODE)
        if not problem.blind:  # with those beside a mode, as they are parts of its mean
            likely = order[minima["log_weight"][order] > minima["log_weight"][order[0]] - SEARCH.unlikely]
            beside = distinct(problem.model, minima, likely, modes.MODES.max_minima, SEARCH.same_minimum)
            among = np.zeros(len(minima), dtype=bool)
            among[each] = among[beside] = True
            each = order[among[order]]
        chosen = taken(minima, each)
    return summaries(problem, chosen, found.used, mean=mean)


def summarize_pose(problem: Problem, descent: Records) -> PoseEstimate:
    """Returns the estimate at the pose of another method's descent (1,), with the uncertainty of all evidence there."""
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    answers = summaries(problem, descent, used, first_order=True)
    answers["weight"] = 1.0
    consistent = modes.fits(answers["chi2"][0], problem.freedom(used))
    return PoseEstimate(answers, residuals(problem, answers["T_palm_object"][0]), consistent)


def residuals(problem: Problem, T_palm_object: Array) -> Array:
    """Returns the distance [m] and the angle [rad] between each contact and the surface (n, 2), at a pose (4, 4)."""
    rows = np.empty((len(problem.contacts), 2))
    batch.residuals_at(*problem.model.record[:2], problem.contacts.record, T_palm_object, rows)
    return rows


def cost(problem: Problem, Ts_palm_object: Array, used: Mask) -> Array:
    """Returns minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant.

    `used` (1, n): the contacts in use.
    """
    descents = descents_at(Ts_palm_object)
    in_parts(partial(batch.cost_all, *problem.arguments(used)), (descents,), SOLVE.block)
    return np.asarray(descents["posterior_cost"])


def information_by_contact(
    model: ObjectModel, contacts: Contacts, T_palm_object: Array
) -> tuple[Array, Array]:
    """Returns the information (n, 6, 6) that the surface gives about each contact's own (point, normal), and the
    gradient (n, 6) of half its squared residuals, with the object at `T_palm_object` (4, 4).

    Both are along the palm's axes, by the point [m] and by the change of the unit normal.
    """
    information, gradient = np.empty((len(contacts), 6, 6)), np.empty((len(contacts), 6))
    given = (*model.record[:2], contacts.record, descents_at(T_palm_object[None]))
    surface_at_contacts.information_by_contact(*given, information, gradient)
    return information, gradient
