"""A choice of points that is spread evenly over many points."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner

WIDE = 6
"""Numbers of each point: its position, and its normal times a length."""


@inner
def _gaps2(columns: Any, p: Any, k: int, out: Any) -> None:
    """Writes to `out` (n) the squared distances of the columns (6, n) from the k-th row of p."""
    x = p[k, 0]
    y = p[k, 1]
    z = p[k, 2]
    u = p[k, 3]
    v = p[k, 4]
    w = p[k, 5]
    for j in range(columns.shape[1]):
        a, b, c = columns[0, j] - x, columns[1, j] - y, columns[2, j] - z
        d, e, f = columns[3, j] - u, columns[4, j] - v, columns[5, j] - w
        out[j] = a * a + b * b + c * c + d * d + e * e + f * f


@entry
def spread_out(features: Any, n: int, steps: int) -> Any:
    """Returns (n, 6) points spread evenly over the features (m, 6): farthest points, moved by Lloyd's `steps`.

    The first is the farthest from the mean.
    """
    chosen = np.empty((n, WIDE))
    columns = features.T.copy()
    middle = np.zeros((1, WIDE))
    gap = np.empty(len(features))
    now = np.empty(len(features))
    own = np.empty(n)
    for i in range(len(features)):
        for k in range(WIDE):
            middle[0, k] += features[i, k] / len(features)
    _gaps2(columns, middle, 0, gap)
    for j in range(n):
        farthest = np.argmax(gap)
        for k in range(WIDE):  # assigning a row takes two seconds to compile, for its error message
            chosen[j, k] = features[farthest, k]
        _gaps2(columns, chosen, j, now)
        for i in range(len(features)):
            # The gaps from the mean only served to choose the first point.
            gap[i] = now[i] if j == 0 else min(gap[i], now[i])
    for _ in range(steps):
        columns = chosen.T.copy()
        sums = np.zeros((n, WIDE))
        count = np.zeros(n)
        for i in range(len(features)):
            _gaps2(columns, features, i, own)
            owner = np.argmin(own)
            count[owner] += 1
            for k in range(WIDE):
                sums[owner, k] += features[i, k]
        for j in range(n):
            # A point to which no feature is nearest stays where it is.
            if count[j] > 0:
                for k in range(WIDE):
                    chosen[j, k] = sums[j, k] / count[j]
    return chosen


@entry
def snapped(features: Any, middles: Any) -> Any:
    """Returns (n,) for each of `middles` (n, 6) the nearest feature (m, 6) that no earlier one took."""
    columns = features.T.copy()
    gap = np.empty(len(features))
    index = np.empty(len(middles), np.int64)
    for j in range(len(middles)):
        _gaps2(columns, middles, j, gap)
        index[j] = np.argmin(gap)
        columns[0, index[j]] = np.inf
    return index
