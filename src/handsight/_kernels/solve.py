"""Phase 2: Levenberg-Marquardt on a field, one pose at a time.

Twins: `handsight.correction.solve.descend`, `Chart`, and `handsight.correction.evidence.Outside`.
"""

from typing import Any

import numpy as np

from handsight._kernels.algebra import factor, solved
from handsight._kernels.compiled import inner
from handsight._kernels.layout import (
    BLIND,
    BOUNDS,
    COARSE,
    CONTACT,
    COST,
    EQUATIONS,
    GRADIENT,
    HAND,
    HAS_NORMAL,
    RADIUS,
)
from handsight._kernels.settings import MAX_TURN, SHORT_STEP
from handsight._kernels.sight import add_sight
from handsight._kernels.touch import (
    DISTANCE,
    SLOPE,
    SURFACE,
    WHITE,
    add_touch,
    point_of,
    scatter,
    surface,
    weigh,
)  # fmt: skip
from handsight._kernels.vectors import accumulate

WORK = 400
"""Numbers of workspace that serve every function of the correction, its weights apart."""


@inner
def add_outside(
    model: Any,
    singles: Any,
    field: int,
    hand: Any,
    pose: Any,
    center: Any,
    radius: float,
    equations: Any,
    work: Any,
) -> None:
    """Adds the hand's points that are inside the object."""
    s, weight = work[:SURFACE], work[SURFACE : SURFACE + 1]
    weight[0], r = 1 / (hand[0] * hand[0]), 1 / radius
    for i in range(HAND, len(hand), 3):
        if beside(model, hand, i, pose):
            continue
        surface(model, singles, field, hand, i, pose, s)
        depth = s[DISTANCE]
        if depth < 0:
            x, y, z = -s[SLOPE], -s[SLOPE + 1], -s[SLOPE + 2]
            a, b, c = hand[i] - center[0], hand[i + 1] - center[1], hand[i + 2] - center[2]
            row = (x, y, z, (b * z - c * y) * r, (c * x - a * z) * r, (a * y - b * x) * r, depth)
            accumulate(weight, 0, row, equations)


@inner
def beside(model: Any, x: Any, at: int, pose: Any) -> bool:
    """Whether the palm point at `x[at]` is outside the box around the object: most of a hand is."""
    lx, ly, lz = x[at] - pose[9], x[at + 1] - pose[10], x[at + 2] - pose[11]
    for k in range(3):
        p = lx * pose[k] + ly * pose[3 + k] + lz * pose[6 + k]
        if p < model[BOUNDS + k] or p > model[BOUNDS + 3 + k]:
            return True
    return False


@inner
def evaluate(
    model: Any, singles: Any, field: int, contacts: Any, weight: Any, sight: Any, hand: Any, center: Any, pose: Any,
    equations: Any, work: Any,
) -> None:  # fmt: skip
    """Normal equations by (τ, radius ω) of all evidence at a pose."""
    equations[:] = 0.0
    s = work[:SURFACE]
    for i in range(len(contacts) // CONTACT):
        if weight[WHITE * i] != 0.0:
            surface(model, singles, field, contacts, point_of(i), pose, s)
            add_touch(contacts, i, s, weight, WHITE * i, center, model[RADIUS], equations)
    _add_others(model, singles, field, sight, hand, center, pose, equations, work)


@inner
def freeze(
    model: Any, singles: Any, field: int, contacts: Any, used: Any, weight: Any, sight: Any, hand: Any, center: Any,
    pose: Any, equations: Any, work: Any,
) -> None:  # fmt: skip
    """As `evaluate`, after writing the weights (n, 4, 4) of the contacts as they are there; zeros for the unused."""
    equations[:] = 0.0
    s, S, rest = work[:SURFACE], work[SURFACE : SURFACE + 16], work[SURFACE + 16 :]
    for i in range(len(used)):
        at = WHITE * i
        if used[i]:
            surface(model, singles, field, contacts, point_of(i), pose, s)
            scatter(model, contacts, i, s, field == COARSE, S, rest)
            weigh(S, contacts[CONTACT * i + HAS_NORMAL] > 0, weight, at)
            add_touch(contacts, i, s, weight, at, center, model[RADIUS], equations)
        else:
            weight[at : at + WHITE] = 0.0
    _add_others(model, singles, field, sight, hand, center, pose, equations, work)


@inner
def _add_others(
    model: Any,
    singles: Any,
    field: int,
    sight: Any,
    hand: Any,
    center: Any,
    pose: Any,
    equations: Any,
    work: Any,
) -> None:
    """Adds what is no contact."""
    if len(hand) > HAND:
        add_outside(model, singles, field, hand, pose, center, model[RADIUS], equations, work)
    if sight[0] != BLIND:
        add_sight(sight, pose, center, model[RADIUS], equations, work)


@inner
def damped(equations: Any, radius: float, damping: float, step: Any, work: Any) -> None:
    """A Levenberg-Marquardt step (6), its turn at most MAX_TURN; what nothing observes stays."""
    trace = 0.0
    for k in range(6):
        trace += equations[9 * k]
    if not factor(equations, 6, 8, (damping + 1e-12) * trace, work):
        step[:] = np.nan  # no step; its cost is no number and it is not taken
        return
    solved(work, 6, equations, GRADIENT, step)
    turn = np.sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5]) / radius
    scale = -MAX_TURN / max(turn, MAX_TURN)
    for k in range(6):
        step[k] *= scale


@inner
def stepped(pose: Any, step: Any, center: Any, radius: float, out: Any) -> None:
    """The pose after a step about `center`; the turn by Cayley's map, which needs no sine."""
    x, y, z = step[3] / (2 * radius), step[4] / (2 * radius), step[5] / (2 * radius)
    k = 2 / (1 + x * x + y * y + z * z)
    a, b, c = 1 - k * (y * y + z * z), k * (x * y - z), k * (x * z + y)
    d, e, f = k * (x * y + z), 1 - k * (x * x + z * z), k * (y * z - x)
    g, h, i = k * (x * z - y), k * (y * z + x), 1 - k * (x * x + y * y)
    for j in range(3):
        p, q, r = pose[j], pose[3 + j], pose[6 + j]
        out[j], out[3 + j], out[6 + j] = a * p + b * q + c * r, d * p + e * q + f * r, g * p + h * q + i * r
    p, q, r = pose[9] - center[0], pose[10] - center[1], pose[11] - center[2]
    out[9] = a * p + b * q + c * r + center[0] + step[0]
    out[10] = d * p + e * q + f * r + center[1] + step[1]
    out[11] = g * p + h * q + i * r + center[2] + step[2]


@inner
def descend(
    model: Any, singles: Any, field: int, contacts: Any, weight: Any, sight: Any, hand: Any, center: Any, pose: Any,
    most: int, small: float, work: Any,
) -> tuple[float, int, bool]:  # fmt: skip
    """Moves `pose`, whose equations `work` begins with, to a minimum; cost, steps tried, whether the last was small."""
    radius = model[RADIUS]
    now, new, rest = work[:EQUATIONS], work[EQUATIONS : 2 * EQUATIONS], work[2 * EQUATIONS :]
    step, candidate, scratch = rest[:6], rest[6:18], rest[18:]
    damping, tried, converged = 1e-6, 0, False
    while tried < most and not converged:
        damped(now, radius, damping, step, scratch)
        stepped(pose, step, center, radius, candidate)
        evaluate(model, singles, field, contacts, weight, sight, hand, center, candidate, new, scratch)
        tried += 1
        # At rounding level the cost cannot tell better from worse; such a step counts as taken.
        if new[COST] <= now[COST] + 1e-12 * (1 + now[COST]):
            longest = 0.0
            length = 0.0
            for i in range(6):
                longest = max(longest, abs(step[i]))
                length += now[9 * i] * step[i] * step[i]
                for j in range(i):
                    length += 2 * now[8 * i + j] * step[i] * step[j]
            converged = length < small * small or longest < SHORT_STEP * radius
            pose[:] = candidate
            now[:] = new
            damping = max(damping * 0.1, 1e-9)
        else:
            damping = min(damping * 30, 1e3)
    return now[COST], tried, converged
