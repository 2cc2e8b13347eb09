"""Loads over time: ratios, means over short times, and turns of ratio vectors, by which friction is learnt."""

import math
from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight.forces.kernels.slip_records import FIRST, FRICTION, MOST_READINGS, SLIP


@inner
def _length(x: float, y: float, z: float, w: float) -> float:
    return math.sqrt(x * x + y * y + z * z + w * w)


@inner
def _upper(one: Any, ratios: Any) -> float:
    """Returns the mean ratio of the upper half of the last readings, of two at least; `ratios` is memory."""
    for k in range(one.count):
        at = k
        while at > 0 and ratios[at - 1] < one.last[k, 0]:
            ratios[at] = ratios[at - 1]
            at -= 1
        ratios[at] = one.last[k, 0]
    best = min(max(2, one.count // 2), one.count)
    total = 0.0
    for k in range(best):
        total += ratios[k]
    return total / best


@inner
def _read(one: Any, load: Any, noise: float, mu: float, stamp: float, is_new: bool) -> None:
    """Adds a reading with a normal force to a sensor's last ones; `noise` is that of the ratio."""
    tangential = _length(load[0], load[1], load[2], load[4] / FRICTION.torsion)
    normal = load[3]
    # A running mean with weight w for the last reading has a variance smaller by w / (2 - w).
    wanted = (SLIP.ratio_sigma * mu) ** 2
    old = 0
    kept = 0
    weight = min(2 * wanted / (noise**2 + wanted), 1.0)
    if not is_new:
        tangential = one.tangential + weight * (tangential - one.tangential)
        normal = one.normal + weight * (normal - one.normal)
        first = stamp - SLIP.window - 1e-9
        while old < one.count - 1 and (one.last[old, 1] < first or one.count - old >= MOST_READINGS):
            old += 1
        kept = one.count - old
        for k in range(kept):
            one.last[k] = one.last[k + old]
    one.tangential = tangential
    one.normal = normal
    one.count = kept + 1
    one.last[kept, 0] = tangential / normal
    one.last[kept, 1] = stamp
    one.last[kept, 2] = load[3]


@inner
def _turned(one: Any, relative: float, rise: float, straight: bool, read: Any) -> bool:
    """Returns whether the ratio vector of a sensor's mean load has moved, or is longer than it has kept up.

    `straight`: whether a normal force that changes counts as a motion of that vector too.
    """
    scale = one.mean[3] * relative
    x, y, z = one.mean[0] / scale, one.mean[1] / scale, one.mean[2] / scale
    w = one.mean[4] / FRICTION.torsion / scale
    anchor = one.anchor
    length = _length(x, y, z, w)
    was = 0.0 if math.isnan(one.kept_up) else one.kept_up
    risen = length > was
    if risen:
        one.kept_up = was + rise * (length - was)
    size = _length(anchor[0], anchor[1], anchor[2], anchor[3])
    away = _length(x - anchor[0], y - anchor[1], z - anchor[2], w - anchor[3])
    if straight:
        away = math.hypot(away, size * (one.mean[3] / anchor[4] - 1))
    if away <= FRICTION.min_turn * size:
        return risen
    least, most = min(size, length), max(size, length)
    # A motion that hardly changed the length was a turn. Without an anchor the comparisons are false.
    counts = least >= FRICTION.min_ratio and most <= FRICTION.max_ratio
    if counts and most - least <= FRICTION.max_radial * away:
        read.turned = math.sqrt(least * most)
    anchor[0] = x
    anchor[1] = y
    anchor[2] = z
    anchor[3] = w
    anchor[4] = one.mean[3]
    return True


@entry
def follow_loads(
    limits: Any,
    numbers: Any,
    loads: Any,
    stamp: float,
    since: float,
    mu: float,
    straight: bool,
    memory: Any,
    read: Any,
) -> tuple[bool, float, float]:
    """Returns whether friction may be another one now, the ratio that two sensors have kept up, and the largest gain.

    `loads` (n, 5): on the sensors of `numbers` (n,), which count `limits` (2 m) LOAD_LIMITS, those of m six-axis
    sensors and those of taxels in their place; NaN where a load is unknown. `since`: the time since the last update
    [s]; `mu`: the coefficient of friction, 1 where it is unknown; `straight`: whether a constant ratio under a changing
    force shows friction. Writes `memory` (m) LOAD_MEMORY and `read` (n) LOAD_READ.
    """
    goes_on = since <= SLIP.max_gap
    news = False
    gain = 0.0
    m = len(memory)
    follow, slowly = 1 - math.exp(-since / SLIP.time_constant), 1 - math.exp(-since / SLIP.rest)
    rise = 1 - math.exp(-min(since if goes_on else 0.0, FRICTION.keep_up) / FRICTION.keep_up)
    loaded = np.zeros(m, dtype=np.bool_)
    ratios = np.empty(MOST_READINGS)
    for i in range(len(loads)):
        limit = limits[numbers[i]]
        one = memory[numbers[i] % m]
        load = loads[i]
        out = read[i]
        out.measured = abs(load[0] + load[1] + load[2] + load[3] + load[4]) < np.inf
        out.ratio = np.nan
        out.highest = np.nan
        out.turned = 0.0
        if not (out.measured and load[3] > 0):
            continue
        loaded[numbers[i] % m] = True
        gain = max(gain, limit.gain)
        is_new = not goes_on or math.isnan(one.mean[0])
        for k in range(5):
            one.mean[k] = load[k] if is_new else one.mean[k] + follow * (load[k] - one.mean[k])
            one.rest[k] = load[k] if is_new else one.rest[k] + slowly * (load[k] - one.rest[k])
        _read(one, load, limit.noise / load[3], mu, stamp, is_new)
        if one.mean[3] > limit.sure_force:
            news |= _turned(one, limit.relative, rise, straight, out)
        else:
            one.anchor[:] = np.nan
        if one.mean[3] > limit.min_force:
            # What taxels miss of a load changes with the place that is touched: theirs is at the limit where it may be.
            out.ratio = _upper(one, ratios) * (1 + SLIP.gain_sigmas * limit.gain) / limit.relative
            noise = min(limit.noise / load[3], SLIP.ratio_sigma * mu)
            out.highest = out.ratio + noise / limit.relative
    first = 0.0
    second = 0.0
    count = 0
    for k in range(m):
        if not loaded[k]:
            memory[k].mean[:] = np.nan
            memory[k].anchor[:] = np.nan
        kept = memory[k].kept_up
        if not math.isnan(kept):
            count += 1
            first, second = max(first, kept), max(second, min(first, kept))
    return news, first if count == 1 else second, gain


@entry
def highest_heap(turns: Any, error: int) -> tuple[float, int]:
    """Returns the mean number of the highest heap's bins, and its turns; 0 of them where there is no heap among the
    turns (n,) in bins from number `FIRST` on. `error`: the standard deviation of ratios in bins."""
    n = len(turns)
    band = FRICTION.band + 2 * error
    heaps = np.zeros(n, np.int64)
    for at in range(n):
        heaps[at] = turns[at : at + band].sum()
    for at in range(n - 1, -1, -1):
        near = heaps[max(at - FRICTION.max_below, 0) : at + 1].max()
        if turns[at] and heaps[at] >= max(FRICTION.min_turns, FRICTION.min_share * near):
            first = at
            for k in range(at, max(at - FRICTION.top - error, 0) - 1, -1):
                if heaps[k] > heaps[first]:
                    first = k
            moment = 0
            for k in range(first, min(first + band, n)):
                moment += turns[k] * k
            return FIRST + moment / heaps[first], heaps[first]
    return 0.0, 0
