"""A whole correction, or one stage of many, in one call from Python.

Twins: `handsight.correction.two_phase.solve`, `posterior` and `residuals`, `handsight.correction.modes.hypotheses`.
"""

from typing import Any

import numpy as np

from handsight._kernels.algebra import eigen
from handsight._kernels.compiled import entry, inner
from handsight._kernels.layout import (
    BALL,
    CENTER,
    CHI2,
    COARSE,
    COMPLETE,
    CONTACT,
    CONVERGED,
    COVARIANCE,
    COVARIANCE_OUT,
    DESCENT_COST,
    EQUATIONS,
    FINE,
    GAIN,
    HAS_NORMAL,
    INFORMATION_OUT,
    NORMAL,
    NORMALS,
    OPEN_COUNT,
    OPEN_OUT,
    POSTERIOR_COST,
    PRIOR_COVARIANCE,
    RADIUS,
    RESIDUALS,
    SIGHT,
    STEPS,
    TRANSFORM_OUT,
    VARIANCE,
    WIDTH,
)  # fmt: skip
from handsight._kernels.match import match
from handsight._kernels.modes import in_metres, secant, spread, unobservable
from handsight._kernels.posterior import information, largest_gain
from handsight._kernels.settings import COARSE_STEP, COARSE_STEPS, FINE_STEPS, SMALL_STEP
from handsight._kernels.sight import held, seen
from handsight._kernels.solve import WORK, descend, freeze
from handsight._kernels.symmetry import nearest
from handsight._kernels.touch import DISTANCE, FACING, SURFACE, WHITE, point_of, surface


@inner
def variances(contacts: Any) -> None:
    """Fills in each contact's mean variances, of its point per axis and of its normal per tangent axis."""
    for i in range(len(contacts) // CONTACT):
        v = CONTACT * i + COVARIANCE
        point, normal = 0.0, 0.0
        for k in range(3):
            point += contacts[v + 7 * k]
            normal += contacts[v + 21 + 7 * k]
        off = 0.0
        for k in range(3):
            for j in range(6):
                off = max(off, abs(contacts[v + 6 * k + j] - (point / 3 if j == k else 0.0)))
        contacts[CONTACT * i + BALL] = 1.0 if off <= 1e-12 * point else 0.0
        contacts[CONTACT * i + VARIANCE], contacts[CONTACT * i + VARIANCE + 1] = point / 3, normal / 2


@inner
def middle(contacts: Any, center: Any) -> None:
    """The centroid (3) of the contacts."""
    n = len(contacts) // CONTACT
    center[:] = 0.0
    for i in range(n):
        for k in range(3):
            center[k] += contacts[CONTACT * i + k] / n


@inner
def approach(
    model: Any, singles: Any, contacts: Any, used: Any, first: Any, sight: Any, hand: Any, center: Any, pose: Any,
    weight: Any, work: Any,
) -> tuple[float, int]:  # fmt: skip
    """Phase 1, with the evidence `first` beside the samples, then the coarse field; cost and steps."""
    steps = match(model, singles, contacts, used, first, center, pose, work)
    freeze(
        model, singles, COARSE, contacts, used, weight, sight, hand, center, pose, work[:EQUATIONS], work[EQUATIONS:]
    )  # fmt: skip
    cost, more, _ = descend(
        model, singles, COARSE, contacts, weight, sight, hand, center, pose, COARSE_STEPS, COARSE_STEP, work
    )
    return cost, steps + more


@inner
def finish(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, hand: Any, center: Any, pose: Any, weight: Any,
    work: Any,
) -> tuple[float, int, bool]:  # fmt: skip
    """Phase 2 on the fine field; cost, steps, whether it converged."""
    freeze(
        model, singles, FINE, contacts, used, weight, sight, hand, center, pose, work[:EQUATIONS], work[EQUATIONS:]
    )  # fmt: skip
    return descend(
        model, singles, FINE, contacts, weight, sight, hand, center, pose, FINE_STEPS, SMALL_STEP, work
    )


@inner
def residuals(model: Any, singles: Any, contacts: Any, pose: Any, out: Any, work: Any) -> None:
    """Distance [m] of each contact to the surface, then the angle [rad] between the normals; NaN without one."""
    n = len(contacts) // CONTACT
    s = work[:SURFACE]
    for i in range(n):
        c = CONTACT * i
        surface(model, singles, FINE, contacts, point_of(i), pose, s)
        out[i] = s[DISTANCE]
        ax, ay, az = s[FACING], s[FACING + 1], s[FACING + 2]
        bx, by, bz = contacts[c + NORMAL], contacts[c + NORMAL + 1], contacts[c + NORMAL + 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        angle = np.arctan2(np.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)
        out[n + i] = angle if contacts[c + HAS_NORMAL] > 0 else np.nan


@inner
def explain(
    model: Any, singles: Any, contacts: Any, used: Any, sight: Any, anchor: Any, hand: Any, least: float, out: Any,
    work: Any, each: Any,
) -> None:  # fmt: skip
    """What is known of the pose `out[:12]`: everything an answer says beside it."""
    pose, total, sigma = out[:12], out[INFORMATION_OUT:COVARIANCE_OUT], out[COVARIANCE_OUT:OPEN_OUT]
    by_touch, values, vectors, rest = work[:36], work[36:42], work[42:78], work[78:]
    chi2, cost = information(model, singles, contacts, used, sight, hand, pose, by_touch, total, each, rest)
    out[CHI2], out[POSTERIOR_COST] = chi2, cost
    out[GAIN] = largest_gain(total, each, used, rest)
    out[OPEN_COUNT] = unobservable(model, by_touch, pose, out[OPEN_OUT:RESIDUALS], rest)
    in_metres(total, model[RADIUS], by_touch)
    eigen(by_touch, 6, values, vectors)
    secant(model, singles, contacts, used, sight, anchor, hand, pose, values, vectors, rest)
    out[COMPLETE] = spread(values, vectors, model[RADIUS], least, total, sigma, rest)
    residuals(model, singles, contacts, pose, out[RESIDUALS:], rest)
    out[NORMALS] = 0.0
    for i in range(len(used)):
        out[NORMALS] += contacts[CONTACT * i + HAS_NORMAL]
    transform = out[TRANSFORM_OUT:INFORMATION_OUT]
    for i in range(3):
        for k in range(3):
            transform[4 * i + k] = pose[3 * i + k]
        transform[4 * i + 3] = pose[9 + i]
        transform[12 + i] = 0.0
    transform[15] = 1.0


@inner
def width(model: Any, prior: Any) -> float:
    """How far the prior lets a point of the surface be (twin: `handsight.correction.starts.width`)."""
    R, C = prior, PRIOR_COVARIANCE
    x = R[0] * model[CENTER] + R[1] * model[CENTER + 1] + R[2] * model[CENTER + 2]
    y = R[3] * model[CENTER] + R[4] * model[CENTER + 1] + R[5] * model[CENTER + 2]
    z = R[6] * model[CENTER] + R[7] * model[CENTER + 1] + R[8] * model[CENTER + 2]
    xx, yy, zz = prior[C + 21], prior[C + 28], prior[C + 35]
    xy, xz, yz = prior[C + 22], prior[C + 23], prior[C + 29]
    spread = prior[C] + prior[C + 7] + prior[C + 14]
    # Of the object's middle: δp + δθ × (x, y, z).
    spread += xx * (y * y + z * z) + yy * (x * x + z * z) + zz * (x * x + y * y)
    spread -= 2 * (xy * x * y + xz * x * z + yz * y * z)
    spread += 2 * (prior[C + 4] * z - prior[C + 5] * y)
    spread += 2 * (prior[C + 11] * x - prior[C + 9] * z)
    spread += 2 * (prior[C + 15] * y - prior[C + 16] * x)
    radius = model[RADIUS]
    return np.sqrt(spread + radius * radius * (xx + yy + zz)) / (2 * radius)


@inner
def start(model: Any, contacts: Any, prior: Any, center: Any, sight: Any, pose: Any, work: Any) -> None:
    """What a correction begins with."""
    variances(contacts)
    middle(contacts, center)
    seen(model, prior, sight, work)
    pose[:] = prior[:12]


@inner
def space(n: int) -> int:
    """Numbers of workspace for a correction of n contacts."""
    return WORK + (WHITE + EQUATIONS) * n + 16 + SIGHT


@inner
def answer_near(
    model: Any, singles: Any, contacts: Any, prior: Any, begin: Any, hand: Any, widest: float, out: Any, work: Any
) -> None:  # fmt: skip
    """One correction from the prior's own pose; where the prior is wider than `widest`, its width and no more.

    `begin` (12), if not empty, is a pose near by that was right: it is followed, however wide the prior is.
    """
    out[WIDTH] = 0.0 if len(begin) else width(model, prior)
    if not out[WIDTH] < widest:
        return
    n = len(contacts) // CONTACT
    used = np.ones(n, dtype=np.bool_)
    weight, each = work[WORK : WORK + WHITE * n], work[WORK + WHITE * n : WORK + (WHITE + EQUATIONS) * n]
    rest = work[WORK + (WHITE + EQUATIONS) * n :]
    center, pose, sight, anchor = rest[:3], rest[3:15], rest[15 : 15 + SIGHT], rest[15 + SIGHT : 16 + SIGHT]
    anchor[0] = 0.0
    start(model, contacts, prior, center, sight, pose, work)
    steps = 0
    if len(begin):
        pose[:] = begin
    else:
        _, steps = approach(model, singles, contacts, used, sight, sight, hand, center, pose, weight, work)
    cost, more, converged = finish(model, singles, contacts, used, sight, hand, center, pose, weight, work)
    nearest(model, pose, prior, out[:12], work)
    out[DESCENT_COST], out[STEPS], out[CONVERGED] = cost, steps + more, converged
    explain(model, singles, contacts, used, sight, anchor, hand, 0.0, out, work, each)


@entry
def two_phases(model: Any, singles: Any, contacts: Any, prior: Any, hand: Any, out: Any) -> None:
    """`out[:15]`: pose, cost, steps and whether it converged; nothing of what an answer says beside it."""
    n = len(contacts) // CONTACT
    work, used = np.empty(space(n)), np.ones(n, dtype=np.bool_)
    weight, rest = work[WORK : WORK + WHITE * n], work[WORK + (WHITE + EQUATIONS) * n :]
    center, sight, pose = rest[:3], rest[15 : 15 + SIGHT], out[:12]
    start(model, contacts, prior, center, sight, pose, work)
    _, steps = approach(model, singles, contacts, used, sight, sight, hand, center, pose, weight, work)
    cost, more, converged = finish(model, singles, contacts, used, sight, hand, center, pose, weight, work)
    out[DESCENT_COST], out[STEPS], out[CONVERGED] = cost, steps + more, converged


@entry
def prepare(model: Any, contacts: Any, prior: Any, sight: Any, anchor: Any, center: Any) -> None:
    """Fills in what a problem's descents share: vision's evidence, or, for an empty prior, what holds the blind."""
    variances(contacts)
    middle(contacts, center)
    sight[:] = 0.0
    anchor[:] = 0.0
    if len(prior):
        seen(model, prior, sight, np.empty(WORK))
    else:
        held(model, center, anchor)
