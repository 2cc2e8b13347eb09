"""Connected pieces of a graph of triangles or points, and the sides of linked ones made to agree."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from handsight.checks import Indices, Mask


def agreeing(i: Indices, j: Indices, agree: Mask, size: int) -> tuple[Mask, bool]:
    """Returns which of `size` triangles or normals to turn over so that linked ones agree, and whether all can agree.

    Items i (l,) and j (l,) are linked; `agree` (l,): whether they agree as they are. Each item is two nodes of a graph:
    the item as it is, and turned over. Items that agree are linked node to like node, others crosswise, so that the
    nodes connected to an item "as it is" show which other items must be turned.
    """
    row = np.concatenate([i, i + size])
    column = np.concatenate([np.where(agree, j, j + size), np.where(agree, j + size, j)])
    label = components(row, column, 2 * size)
    as_is = label[:size]
    turned = label[size:]
    # The two components of a piece have two labels; of these the one with more nodes "as it is" wins.
    votes = np.bincount(as_is, minlength=label.max() + 1)
    flip = (votes[turned] > votes[as_is]) | ((votes[turned] == votes[as_is]) & (turned < as_is))
    return flip, bool((as_is != turned).all())


def components(row: Indices, column: Indices, size: int) -> Indices:
    """Returns (size,) the connected component of each node of a graph with links from `row` (l,) to `column` (l,)."""
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
