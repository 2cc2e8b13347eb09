"""Many descents, minima or corrections at once; those that take a range of them run on several threads.

Twins: `handsight.correction.two_phase.solve` and `survivors`, `handsight.correction.modes.hypotheses`.
"""

from typing import Any

import numpy as np

from handsight._kernels.algebra import eigen
from handsight._kernels.compiled import entry
from handsight._kernels.correct import answer_near, approach, explain, finish, space
from handsight._kernels.layout import BLIND, CONTACT, COST, EQUATIONS, FINE, PRIOR, RADIUS
from handsight._kernels.modes import in_metres
from handsight._kernels.posterior import cost, information
from handsight._kernels.settings import FINE_STEPS, SMALL_STEP
from handsight._kernels.sight import sight_cost
from handsight._kernels.solve import WORK, descend, evaluate
from handsight._kernels.symmetry import are_apart, nearest
from handsight._kernels.touch import WHITE


@entry
def approach_all(
    model: Any, singles: Any, contacts: Any, used: Any, first: Any, sight: Any, hand: Any, center: Any, poses: Any,
    found: Any, start: int, stop: int,
) -> None:  # fmt: skip
    """Moves poses (K, 12) by phase 1 and on the coarse field; `found` (K, 3): cost, steps, converged."""
    n = used.shape[1]
    work = np.empty(space(n))
    for k in range(start, stop):
        row = used[min(k, len(used) - 1)]
        found[k, 0], found[k, 1] = approach(
            model, singles, contacts, row, first, sight, hand, center, poses[k], work[: WHITE * n], work[WHITE * n :]
        )  # fmt: skip
        found[k, 2] = 0.0


@entry
def finish_all(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, anchor: Any, hand: Any, center: Any, poses: Any,
    likely: Any, found: Any, start: int, stop: int,
) -> None:  # fmt: skip
    """Moves poses (K, 12) on the fine field; `found` (K, 3), or (2 K, 3) with `likely` (K, 12) for the blind.

    Along a slide any place is a minimum: `likely` is, beside where a descent ended, the most likely one.
    """
    n, count = used.shape[1], len(poses)
    work = np.empty(space(n))
    for k in range(start, stop):
        weight, rest = work[: WHITE * n], work[WHITE * n :]
        row = used[min(k, len(used) - 1)]
        value, steps, converged = finish(
            model, singles, contacts, row, sight, hand, center, poses[k], weight, rest
        )
        found[k, 0], found[k, 1], found[k, 2] = value, steps, converged
        if len(likely):
            pose = likely[k]
            pose[:] = poses[k]
            equations, scratch = rest[:EQUATIONS], rest[EQUATIONS:]
            evaluate(model, singles, FINE, contacts, weight, anchor, hand, center, pose, equations, scratch)
            _, _, converged = descend(
                model, singles, FINE, contacts, weight, anchor, hand, center, pose, FINE_STEPS, SMALL_STEP, rest
            )  # fmt: skip
            evaluate(
                model, singles, FINE, contacts, weight, sight, hand, center, pose, rest[:EQUATIONS], rest[EQUATIONS:]
            )  # fmt: skip
            found[count + k, 0], found[count + k, 1], found[count + k, 2] = rest[COST], steps, converged


@entry
def weigh_all(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, anchor: Any, hand: Any, poses: Any, floor: float,
    weights: Any,
) -> None:  # fmt: skip
    """`weights` (K, 2) of minima: log of `exp(-cost/2) √det Σ`, and the cost; `floor`: least information [1/m²]."""
    n = len(used)
    for k in range(len(poses)):
        work, total, each = np.empty(WORK), np.empty(72), np.empty(EQUATIONS * n)
        values, vectors = work[:6], work[6:42]
        _, value = information(
            model, singles, contacts, used, sight, hand, poses[k], total[:36], total[36:], each, work
        )
        if anchor[0] != BLIND:
            value += sight_cost(anchor, poses[k], work)
        in_metres(total[36:], model[RADIUS], total[:36])
        eigen(total[:36], 6, values, vectors)
        volume = 0.0
        for i in range(6):
            volume -= 0.5 * np.log(max(values[i], floor))
        weights[k, 0], weights[k, 1] = volume - value / 2, value


@entry
def explain_all(
    model: Any,
    singles: Any,
    contacts: Any,
    used: Any,
    sight: Any,
    anchor: Any,
    hand: Any,
    least: float,
    answers: Any,
) -> None:
    """Completes answers (K, m) whose first 12 numbers are a pose."""
    n = len(used)
    for k in range(len(answers)):
        work, each = np.empty(WORK), np.empty(EQUATIONS * n)
        explain(model, singles, contacts, used, sight, anchor, hand, least, answers[k], work, each)


@entry
def cost_all(
    model: Any,
    singles: Any,
    contacts: Any,
    used: Any,
    sight: Any,
    anchor: Any,
    hand: Any,
    poses: Any,
    costs: Any,
) -> None:
    """Minus two log of the posterior density at poses (K, 12), up to a constant."""
    for k in range(len(poses)):
        work = np.empty(WORK)
        costs[k] = cost(model, singles, contacts, used, sight, anchor, hand, poses[k], work)


@entry
def nearest_all(model: Any, poses: Any, reference: Any) -> None:
    """Replaces poses (K, 12) by their equivalents nearest to the reference."""
    work, out = np.empty(WORK), np.empty(12)
    for k in range(len(poses)):
        nearest(model, poses[k], reference, out, work)
        poses[k] = out


@entry
def distinct(model: Any, poses: Any, order: Any, most: int, shift: float, turn: float, chosen: Any) -> int:
    """Writes which poses, in the given order, are no repeat of an earlier one, at most `most`; how many."""
    work, count = np.empty(WORK), 0
    for index in order:
        new = True
        for k in range(count):
            if not are_apart(model, poses[index], poses[chosen[k]], shift, turn, work):
                new = False
                break
        if new:
            chosen[count] = index
            count += 1
            if count == most:
                break
    return count


@entry
def correct_all(
    model: Any,
    singles: Any,
    contacts: Any,
    begins: Any,
    priors: Any,
    poses: Any,
    hand: Any,
    widest: float,
    answers: Any,
    start: int,
    stop: int,
) -> None:
    """Answers (P, m) of corrections from each prior's own pose; `begins` (P + 1): where each one's contacts do.

    `poses` (12 P), if not empty: the pose that each follows instead.
    """
    for k in range(start, stop):
        mine = contacts[begins[k] : begins[k + 1]]
        prior = priors[PRIOR * k : PRIOR * (k + 1)]
        work = np.empty(space(len(mine) // CONTACT))
        begin = poses[12 * k : 12 * (k + 1)]
        answer_near(model, singles, mine, prior, begin, hand, widest, answers[k], work)
