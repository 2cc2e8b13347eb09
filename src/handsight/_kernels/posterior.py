"""The posterior at a pose: its information, its cost, and what a contact gains by being left out.

Twins: `handsight.correction.two_phase.posterior`, `cost` and `gains`.
"""

from typing import Any

from handsight._kernels.algebra import factor, solved
from handsight._kernels.compiled import inner
from handsight._kernels.layout import (
    BLIND,
    CONTACT,
    COST,
    EQUATIONS,
    FINE,
    GRADIENT,
    HAND,
    HAS_NORMAL,
    NORMAL,
    SHARP,
)  # fmt: skip
from handsight._kernels.sight import add_sight, sight_cost
from handsight._kernels.solve import add_outside, beside
from handsight._kernels.touch import (
    BEND,
    DISTANCE,
    FACING,
    SLOPE,
    SURFACE,
    WHITE,
    add_touch,
    point_of,
    scatter,
    surface,
    surprise,
    weigh,
)  # fmt: skip


@inner
def at_edge(model: Any, contacts: Any, i: int, s: Any) -> bool:
    """Whether the surface bends as sharply as an edge, and the contact's normal tells the face."""
    bend = 0.0
    for k in range(9):
        bend += s[BEND + k] * s[BEND + k]
    return bend > model[SHARP] and contacts[CONTACT * i + HAS_NORMAL] > 0


@inner
def flatten(contacts: Any, i: int, s: Any) -> None:
    """A plane along the contact's normal in place of an edge."""
    for k in range(3):
        normal = contacts[CONTACT * i + NORMAL + k]
        s[SLOPE + k] = normal
        s[FACING + k] = normal
    for k in range(9):
        s[BEND + k] = 0.0


@inner
def touch_information(
    model: Any, singles: Any, contacts: Any, used: Any, pose: Any, each: Any, work: Any
) -> tuple[float, float]:
    """Writes every contact's equations (n, 56) by (δp, δθ); χ² and log det of what whitened them."""
    s, S, weight, rest = (
        work[:SURFACE],
        work[SURFACE : SURFACE + 16],
        work[35 : 35 + WHITE],
        work[35 + WHITE :],
    )
    chi2, log_spread = 0.0, 0.0
    for i in range(len(used)):
        equations = each[EQUATIONS * i : EQUATIONS * (i + 1)]
        equations[:] = 0.0
        if used[i]:
            surface(model, singles, FINE, contacts, point_of(i), pose, s)
            scatter(model, contacts, i, s, False, S, rest)
            log_spread += weigh(S, contacts[CONTACT * i + HAS_NORMAL] > 0, weight, 0)
            if at_edge(model, contacts, i, s):
                square, _ = surprise(contacts, i, s, S)
                flatten(contacts, i, s)
                add_touch(contacts, i, s, weight, 0, pose[9:], 1.0, equations)
                # What it pulls at is beyond the edge: only its own residuals count.
                equations[GRADIENT:COST] = 0.0
                equations[COST] = square
            else:
                add_touch(contacts, i, s, weight, 0, pose[9:], 1.0, equations)
            chi2 += equations[COST]
    return chi2, log_spread


@inner
def information(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, hand: Any, pose: Any, by_touch: Any, total: Any,
    each: Any, work: Any,
) -> tuple[float, float]:  # fmt: skip
    """Information (6, 6) of touch alone and of all, by (δp, δθ); χ², and cost without what holds the blind."""
    chi2, log_spread = touch_information(model, singles, contacts, used, pose, each, work)
    equations, rest = work[:EQUATIONS], work[EQUATIONS:]
    equations[:] = 0.0
    # A wall: it costs, but says nothing of the way back.
    add_outside(model, singles, FINE, hand, pose, pose[9:], 1.0, equations, rest)
    wall = equations[COST]
    equations[:] = 0.0
    if sight[0] != BLIND:
        add_sight(sight, pose, pose[9:], 1.0, equations, rest)
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for k in range(len(used)):
                value += each[EQUATIONS * k + 8 * i + j]
            by_touch[6 * i + j] = by_touch[6 * j + i] = value
            total[6 * i + j] = total[6 * j + i] = value + equations[8 * i + j]
    chi2 += equations[COST] + wall
    return chi2, chi2 + log_spread


@inner
def largest_gain(total: Any, each: Any, used: Any, work: Any) -> float:
    """The most that χ² falls, to first order, when one contact is left out; `work` (80)."""
    rest, factored, step = work[:36], work[36:72], work[72:78]
    most = 0.0
    for i in range(len(used)):
        if used[i]:
            at = EQUATIONS * i
            for k in range(36):
                rest[k] = total[k]
            for r in range(6):
                for c in range(r + 1):
                    rest[6 * r + c] -= each[at + 8 * r + c]
            gain = each[at + COST]
            ridge = 1e-12 * (total[0] + total[7] + total[14])
            if factor(rest, 6, 6, ridge, factored):
                solved(factored, 6, each, at + GRADIENT, step)
                for k in range(6):
                    gain += step[k] * each[at + GRADIENT + k]
            most = max(most, gain)
    return most


@inner
def cost(
    model: Any,
    singles: Any,
    contacts: Any,
    used: Any,
    sight: Any,
    anchor: Any,
    hand: Any,
    pose: Any,
    work: Any,
) -> float:
    """Minus two log of the posterior density at a pose, up to a constant."""
    s, S, rest = work[:SURFACE], work[SURFACE : SURFACE + 16], work[35:]
    total = 0.0
    for i in range(len(used)):
        if used[i]:
            surface(model, singles, FINE, contacts, point_of(i), pose, s)
            scatter(model, contacts, i, s, False, S, rest)
            square, log_spread = surprise(contacts, i, s, S)
            total += square + log_spread
    for i in range(HAND, len(hand), 3):
        if beside(model, hand, i, pose):
            continue
        surface(model, singles, FINE, hand, i, pose, s)
        depth = min(s[DISTANCE], 0.0) / hand[0]
        total += depth * depth
    if sight[0] != BLIND:
        total += sight_cost(sight, pose, rest)
    if anchor[0] != BLIND:
        total += sight_cost(anchor, pose, rest)
    return total
