"""Calls of the compiled solver: from one start, from many, and for the answer at a minimum."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handsight._compiled.records import ANSWER, DESCENT, DOUBTED, ENOUGH, PROBLEM
from handsight._compiled.threads import in_parts
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes
from handsight.correction.estimate import PoseEstimate
from handsight.correction.kernels import batch, search, surface_at_contacts
from handsight.correction.kernels.search_options import ACCEPTANCE, SEARCH
from handsight.correction.problem import Problem, Records, descents_at, poses_of
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

FEW_DESCENTS = 128  # descents that are too few to be shared with another thread
BLOCK = 64  # starts that one call of the kernel descends from; it removes repeats among them on the way
MOST_MINIMA = 32  # most minima that are weighed
MOST_MINIMA_BLIND = 64  # the same without vision


def solve_usual(
    model: ObjectModel,
    contacts: Contacts,
    constraints: Records,
    outside: Records,
    mean: bool,
    T_start: Array | None = None,
) -> tuple[PoseEstimate | None, bool]:
    """Returns the answer of one descent, None where it is certainly not enough, and whether it certainly is.

    It takes records that are there already (`constraints` (1,) CONSTRAINTS, `outside` (m,) OUTSIDE): in a program that
    does other work between two corrections, whatever Python touches here is read from memory, which takes as long as
    the kernel.
    """
    (record, nodes, known), given = model.record, contacts.record
    if not known:
        return None, False
    rows = np.zeros(1, PROBLEM)
    row = rows[0]
    row["answer"]["mean"] = mean
    residuals = np.empty((len(given), 2))
    if T_start is not None:
        row["follows"] = True
        row["start"]["rotation"] = T_start[:3, :3]
        row["start"]["position"] = T_start[:3, 3]
    verdict = batch.correct(record, nodes, given, constraints, outside, rows, residuals)
    if verdict == DOUBTED:
        return None, False
    return PoseEstimate(rows["answer"], residuals), verdict == ENOUGH


@dataclass(frozen=True, slots=True)
class Candidates:
    """The minima that were found with one set of contacts in use."""

    minima: Records
    """(K,) DESCENT, weighed, cheapest first."""
    used: Mask
    """(1, n) whether each contact is in use."""
    freedom: int
    """Degrees of freedom of the χ² at the cheapest minimum."""
    gains: Array
    """(n,) by how much χ² falls, to first order, when each contact in use is left out, at the cheapest minimum."""

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
        minima = np.append(self.minima, other.minima)
        minima = minima.take(np.argsort(minima["cost"], kind="stable"))
        cheaper = self if self.cost <= other.cost else other
        return replace(cheaper, minima=minima)


def solve(problem: Problem, starts: Records, used: Mask) -> Candidates:
    """Returns the minima of one set of contacts: of the sets in `used` (S, n), the one with the cheapest minimum.

    `starts` (S, M): DESCENT, those of each set. All go through phase 1 (nearest samples) and the coarse distance field;
    those that do not repeat another one go on to the fine field.
    """
    model = problem.model
    arguments = problem.arguments(used)
    ends = 2 if problem.blind else 1
    blocks = _blocks(starts, ends)
    in_parts(partial(search.search, *arguments), (blocks,), -(-FEW_DESCENTS // blocks.shape[1]))
    descents = blocks.reshape(-1)
    # The indices of the descents that ended at minima of their own, cheapest first; of these, those of the best set.
    cost = descents["cost"][::ends]
    ended = np.argsort(cost, kind="stable")[: np.count_nonzero(cost < np.inf)] * ends
    best = int(descents["set"][ended[0]])
    ended = ended[descents["set"][ended] == best]
    if len(ended) > BLOCK // 2:
        most = MOST_MINIMA_BLIND if problem.blind else MOST_MINIMA
        ended = distinct(model, descents, ended, most, SEARCH.same_after_coarse)
    if problem.blind:
        # Along a flat direction every place is a minimum. The kernel has put the most likely one beside each minimum;
        # it comes first, so that the stable sort prefers it among equal costs.
        ended = np.concatenate([ended + 1, ended])
        ended = ended[np.argsort(descents["cost"][ended], kind="stable")]
    minima = descents.take(ended)
    minima["set"] = 0
    if problem.vision is not None and not model.record.symmetry_known:
        Ts = nearest(model.symmetries, poses_of(minima), problem.vision.T_palm_object, model.radius)
        minima["pose"] = descents_at(Ts)["pose"]
    chosen = used[best : best + 1]
    given = problem.arguments(chosen)
    batch.weigh(*given, minima)
    freedom = problem.freedom(chosen, int(minima["walls"][0]))
    return Candidates(minima, chosen, freedom, given[2]["gain"][0])


def _blocks(starts: Records, ends: int) -> Records:
    """Returns starts (S, M) as blocks (B, m, ends) of DESCENT, each with starts of one set, dealt out evenly.

    A block that is not full is filled up with descents of infinite cost. With two `ends` each start has a second
    record, for the most likely pose along a flat direction of its minimum.
    """
    sets, count = starts.shape
    number = -(-count // BLOCK)
    each = -(-count // number)
    dealt = starts.take(np.arange(each * number), axis=1, mode="wrap")
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
    problem: Problem, descents: Records, used: Mask, *, first_order: bool = False, mean: bool = False
) -> Records:
    """Returns (K,) ANSWER at the poses of descents (K,), with the contacts `used` (1, n).

    `first_order`: the uncertainty is from the Jacobian alone, for a pose that is no minimum. `mean`: whether those that
    are not Gaussian become means.
    """
    answers = np.zeros(len(descents), dtype=ANSWER)
    answers[list(DESCENT.names or ())] = descents
    answers["first_order"] = first_order
    answers["mean"] = mean
    batch.summarize_all(*problem.arguments(used), answers)
    return answers


def summarize(problem: Problem, found: Candidates, *, mean: bool = False) -> Records:
    """Returns (K,) ANSWER of the distinct ones of minima, likeliest first; `mean`: whether those that are not Gaussian
    become means."""
    minima = found.minima.take(np.argsort(-found.minima["log_weight"], kind="stable"))
    if len(minima) > 1:
        log_weight = minima["log_weight"]
        some = np.flatnonzero(log_weight > log_weight[0] - SEARCH.negligible)
        chosen = distinct(problem.model, minima, some, modes.MAX_MODES, modes.SAME_MODE)
        if not problem.blind:  # with those beside a mode, as they are parts of its mean
            likely = np.flatnonzero(log_weight > log_weight[0] - SEARCH.unlikely)
            beside = distinct(problem.model, minima, likely, modes.MAX_MINIMA, SEARCH.same_minimum)
            chosen = np.union1d(chosen, beside)
        minima = minima.take(chosen)
    return summaries(problem, minima, found.used, mean=mean)


def summarize_pose(problem: Problem, descent: Records) -> PoseEstimate:
    """Returns the estimate at the pose of another method's descent (1,), with the uncertainty of all evidence there."""
    answers = summaries(problem, descent, problem.everyone, first_order=True)
    answers["weight"] = 1.0
    freedom = problem.freedom(problem.everyone, int(answers["walls"][0]))
    consistent = modes.fits(answers["chi2"][0], freedom)
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
    in_parts(partial(batch.cost_all, *problem.arguments(used)), (descents,), BLOCK)
    return np.asarray(descents["posterior_cost"])


def information_by_contact(
    model: ObjectModel, contacts: Contacts, T_palm_object: Array
) -> tuple[Array, Array]:
    """Returns the information (n, 6, 6) that the surface gives about each contact's own (point, normal), and the
    gradient (n, 6) of half its squared residuals, with the object at `T_palm_object` (4, 4).

    Both are along the palm's axes, by the point [m] and by the change of the unit normal.
    """
    information = np.empty((len(contacts), 6, 6))
    gradient = np.empty((len(contacts), 6))
    given = (*model.record[:2], contacts.record, descents_at(T_palm_object[None]))
    surface_at_contacts.information_by_contact(*given, information, gradient)
    return information, gradient
