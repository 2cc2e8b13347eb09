"""The connected sets of a grid's nodes."""

from typing import Any

import numpy as np

from handsight._kernels.runtime.compilation import entry, inner


@inner
def _root(parent: Any, i: int) -> int:
    """Returns the first node of i's set, and halves the path to it (union-find)."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@entry
def linked(index: Any, shape: Any, distance: Any, free: Any, limit: float) -> Any:
    """Returns (n,) the number of each node's set; sets are numbered from 0 in the order of their first nodes.

    `index` (n): the nodes' places in a grid of `shape` (3), ascending. Neighbours are in one set where both are `free`
    (n) and their values of `distance` (n) add up to more than `limit`.
    """
    nx, ny, nz = shape
    n = len(index)
    place = np.full(nx * ny * nz, -1, np.int64)
    parent = np.empty(n, np.int64)
    for i in range(n):
        at = index[i]
        place[at], parent[i] = i, i
        if not free[i]:
            continue
        for axis in range(3):
            step = 1 if axis == 2 else nz if axis == 1 else ny * nz
            turn = at // step % (nz if axis == 2 else ny if axis == 1 else nx)
            before = place[at - step] if turn > 0 else -1
            if before >= 0 and free[before] and distance[i] + distance[before] > limit:
                a, b = _root(parent, i), _root(parent, before)
                # The lower one remains the root, so that the root of a set is its first node.
                parent[max(a, b)] = min(a, b)
    label, count = np.empty(n, np.int64), 0
    for i in range(n):
        if parent[i] == i:
            label[i], count = count, count + 1
        else:
            label[i] = label[_root(parent, i)]
    return label
