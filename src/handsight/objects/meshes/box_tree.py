"""A complete binary tree of boxes around things in space, each level's boxes one after another.

The children of box k are 2k + 1 and 2k + 2. Each box's things are halved across its longest side, so the last row's
boxes, the leaves, differ by one thing at most.
"""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array, Indices

LEAF = 16
"""Things in a leaf, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxTree:
    """Things in an order in which neighbours follow each other, cut into leaves."""

    order: Indices
    """(n,) index of each thing."""
    starts: Indices
    """(leaves + 1,) where each leaf begins, and the end; a power of two of leaves."""

    def merged(self, most: int) -> Indices:
        """Where leaves begin, and the end, neighbours taken together until there are at most so many."""
        starts = self.starts
        while len(starts) > most + 1:
            starts = starts[::2]
        return starts

    def boxes(self, low: Array, high: Array) -> Array:
        """(2 leaves - 1, 6) every box's least and greatest corner, the whole first.

        `low`, `high` (n, 3): of the things, in the tree's order; no leaf may be empty.
        """
        first = self.starts[:-1]
        level = np.hstack([np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)])
        levels = [level]
        while len(level) > 1:
            pair = level.reshape(-1, 2, 6)
            level = np.hstack([pair[:, :, :3].min(axis=1), pair[:, :, 3:].max(axis=1)])
            levels.append(level)
        return np.concatenate(levels[::-1])


def box_tree(centers: Array, most: int = LEAF) -> BoxTree:
    """Things at `centers` (n, 3) halved again and again until no leaf has more than `most`."""
    n = len(centers)
    order = np.arange(n)
    starts = np.array([0, n])
    while np.diff(starts).max() > most:
        x = centers[order]
        low, high = np.minimum.reduceat(x, starts[:-1]), np.maximum.reduceat(x, starts[:-1])
        leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        axis, span = (high - low).argmax(axis=1), (high - low).max(axis=1)
        along = x[np.arange(n), axis[leaf]] - low[np.arange(len(low)), axis][leaf]
        # The leaf before the point, place within it behind: one sort for all leaves.
        key = leaf + 0.999 * along / np.where(span > 0, span, 1.0)[leaf]
        order = order[np.argsort(key)]
        middles = (starts[:-1] + starts[1:]) // 2
        starts = np.append(np.stack([starts[:-1], middles], axis=1).reshape(-1), n)
    return BoxTree(order, starts)
