"""A complete binary tree of boxes around things in space, each level's boxes one after another.

The children of box k are 2k + 1 and 2k + 2. Each box's things are halved across its longest side, so the last row's
boxes differ by one thing at most.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array

PART = 16
"""Things in a part, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """Things in an order in which neighbours follow each other, cut into parts."""

    order: NDArray[np.int64]
    """(n,) index of each thing."""
    starts: NDArray[np.int64]
    """(parts + 1,) where each part begins, and the end; a power of two of parts."""


def halves(centers: Array, most: int = PART) -> Halves:
    """Things at `centers` (n, 3) halved again and again until no part has more than `most`."""
    n = len(centers)
    order = np.arange(n)
    starts = np.array([0, n])
    while np.diff(starts).max() > most:
        x = centers[order]
        low, high = np.minimum.reduceat(x, starts[:-1]), np.maximum.reduceat(x, starts[:-1])
        part = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        axis, span = (high - low).argmax(axis=1), (high - low).max(axis=1)
        along = x[np.arange(n), axis[part]] - low[np.arange(len(low)), axis][part]
        # The part before the point, place within it behind: one sort for all parts.
        key = part + 0.999 * along / np.where(span > 0, span, 1.0)[part]
        order = order[np.argsort(key)]
        middles = (starts[:-1] + starts[1:]) // 2
        starts = np.append(np.stack([starts[:-1], middles], axis=1).reshape(-1), n)
    return Halves(order, starts)


def merged(starts: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Where parts begin, and the end, with neighbours taken together until there are at most so many parts."""
    while len(starts) > most + 1:
        starts = starts[::2]
    return starts


def boxes(low: Array, high: Array, starts: NDArray[np.int64]) -> Array:
    """(2 parts - 1, 6) every box's least and greatest corner, the whole first.

    `low`, `high` (n, 3): of the things, in the order of the parts; no part may be empty.
    """
    level = np.hstack([np.minimum.reduceat(low, starts[:-1]), np.maximum.reduceat(high, starts[:-1])])
    levels = [level]
    while len(level) > 1:
        pair = level.reshape(-1, 2, 6)
        level = np.hstack([pair[:, :, :3].min(axis=1), pair[:, :, 3:].max(axis=1)])
        levels.append(level)
    return np.concatenate(levels[::-1])
