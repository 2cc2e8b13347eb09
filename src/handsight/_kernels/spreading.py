"""Points spread evenly over many. Twin: `handsight.objects._plain.spread_out`."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner

WIDE = 6
"""Numbers for each point: its place and its normal's share."""


@inner
def _gap2(a: Any, i: int, b: Any, j: int) -> float:
    """The squared distance between two rows."""
    total = 0.0
    for k in range(WIDE):
        total += (a[i, k] - b[j, k]) ** 2
    return total


@inner
def _farthest(features: Any, chosen: Any, gap: Any) -> None:
    """Fills `chosen` with rows, each the farthest from those before it; the first from the middle."""
    middle = np.zeros((1, WIDE))
    for i in range(len(features)):
        for k in range(WIDE):
            middle[0, k] += features[i, k] / len(features)
    for i in range(len(features)):
        gap[i] = _gap2(features, i, middle, 0)
    for j in range(len(chosen)):
        best = np.argmax(gap)
        for k in range(WIDE):
            chosen[j, k] = features[best, k]
        for i in range(len(features)):
            # The middle itself was not chosen.
            now = _gap2(features, i, chosen, j)
            gap[i] = now if j == 0 else min(gap[i], now)


@inner
def _owners(features: Any, chosen: Any, owner: Any) -> None:
    """The nearest of the chosen for each feature, of equals the first."""
    n = len(chosen)
    columns = chosen.T.copy()
    gap = np.empty(n)
    for i in range(len(features)):
        f = features[i]
        least = np.inf
        for j in range(n):
            a, b, c = columns[0, j] - f[0], columns[1, j] - f[1], columns[2, j] - f[2]
            d, e, g = columns[3, j] - f[3], columns[4, j] - f[4], columns[5, j] - f[5]
            gap[j] = a * a + b * b + c * c + d * d + e * e + g * g
        for j in range(n):
            if gap[j] < least:
                least, owner[i] = gap[j], j


@entry
def spread_out(features: Any, n: int, steps: int) -> Any:
    """(n, 6) places spread evenly over the features (m, 6): the farthest ones, then Lloyd's steps."""
    chosen = np.empty((n, WIDE))
    _farthest(features, chosen, np.empty(len(features)))
    owner = np.empty(len(features), np.int64)
    for _ in range(steps):
        _owners(features, chosen, owner)
        sums, count = np.zeros((n, WIDE)), np.zeros(n)
        for i in range(len(features)):
            count[owner[i]] += 1
            for k in range(WIDE):
                sums[owner[i], k] += features[i, k]
        for j in range(n):
            # One that stands for nothing stays where it is.
            if count[j] > 0:
                for k in range(WIDE):
                    chosen[j, k] = sums[j, k] / count[j]
    return chosen


def warm() -> None:
    """Compiles every kernel, or loads it."""
    spread_out(np.zeros((1, WIDE)), 1, 1)
