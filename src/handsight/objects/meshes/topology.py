"""How a mesh's triangles hang together: edges, pieces, holes, sides."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from handsight.checks import Array, Indices, Mask
from handsight.objects.surface import Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """A mesh's edges."""

    pairs: Indices
    """(e, 2) vertex indices, the smaller first."""
    of_face: Indices
    """(m, 3) the edge from corner 0 to 1, 1 to 2, 2 to 0."""
    count: Indices
    """(e,) triangles at the edge."""


def edges_of(faces: Indices) -> Edges:
    """The edges of triangles (m, 3)."""
    ordered = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    size = int(faces.max()) + 1
    _, first, which, count = np.unique(
        ordered[:, 0] * size + ordered[:, 1], return_index=True, return_inverse=True, return_counts=True
    )
    return Edges(ordered[first], which.reshape(-1, 3), count)


def _components(row: Indices, column: Indices, size: int) -> Indices:
    """(size,) the connected component of each node of a graph with links from `row` (l,) to `column` (l,)."""
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def agreeing(i: Indices, j: Indices, agree: Mask, size: int) -> tuple[Mask, bool]:
    """Which (size,) of things to turn, so that linked ones, i (l,) and j (l,), agree, and whether all could.

    `agree` (l,): whether they do as they are. Each thing stands twice in a graph, as it is and turned; those that
    agree are linked side to side, others crosswise. What is connected to a thing "as it is" is how its neighbours
    must stand.
    """
    row = np.concatenate([i, i + size])
    column = np.concatenate([np.where(agree, j, j + size), np.where(agree, j + size, j)])
    label = _components(row, column, 2 * size)
    as_is, turned = label[:size], label[size:]
    # The two halves of a piece carry two labels; the more common one "as it is" wins.
    votes = np.bincount(as_is, minlength=label.max() + 1)
    flip = (votes[turned] > votes[as_is]) | ((votes[turned] == votes[as_is]) & (turned < as_is))
    return flip, bool((as_is != turned).all())


def consistent(faces: Indices) -> tuple[Indices, int, bool]:
    """Triangles turned so that neighbours agree, how many were turned, and whether all could agree."""
    edges = edges_of(faces)
    order = np.argsort(edges.of_face, axis=None, kind="stable")
    # Of each edge of just two triangles, its places in these; they agree where they run through it oppositely.
    first = (np.cumsum(edges.count) - edges.count)[edges.count == 2]
    i, j = order[first], order[first + 1]
    forward = (faces < np.roll(faces, -1, axis=1)).reshape(-1)
    agree = forward[i] != forward[j]
    if agree.all():
        return faces, 0, True
    flip, orientable = agreeing(i // 3, j // 3, agree, len(faces))
    return turned_over(faces, flip), int(flip.sum()), orientable


def turned_over(faces: Indices, flip: Mask) -> Indices:
    """Triangles (m, 3), those in `flip` (m,) seen from the other side."""
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def pieces(faces: Indices) -> Indices:
    """(m,) the connected piece of each triangle, through shared vertices."""
    label = _components(faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1), int(faces.max()) + 1)
    return np.unique(label[faces[:, 0]], return_inverse=True)[1].reshape(-1)


@dataclass(frozen=True, slots=True, eq=False)
class Holes:
    """Where a surface ends."""

    middles: Array
    """(h, 3) of each connected run of boundary edges [m]."""
    extents: Array
    """(h,) the diagonal of its bounding box [m]."""
    segments: Array
    """(b, 2, 3) every boundary edge [m]."""


def holes_of(mesh: Triangles) -> Holes:
    """The boundary of a mesh: edges with one triangle, in connected runs."""
    edges = edges_of(mesh.faces)
    pairs = edges.pairs[edges.count == 1]
    segments = mesh.vertices[pairs]
    if not len(pairs):
        return Holes(np.empty((0, 3)), np.empty(0), segments)
    used, local = np.unique(pairs, return_inverse=True)
    start, end = local.reshape(-1, 2).T
    label = _components(start, end, len(used))
    low = np.full((label.max() + 1, 3), np.inf)
    high = -low
    np.minimum.at(low, label, mesh.vertices[used])
    np.maximum.at(high, label, mesh.vertices[used])
    return Holes((low + high) / 2, np.linalg.norm(high - low, axis=1), segments)


def pseudonormals(mesh: Triangles) -> Array:
    """(m, 7, 3): each triangle's normals inside, on its edges 01, 12, 20 and at its corners, not normalised.

    Angle-weighted, so that their sign tells the side of the nearest point wherever it lies (Baerentzen and
    Aanaes 2005).
    """
    faces = mesh.faces
    normal = mesh.doubled_normals / (2 * np.maximum(mesh.areas, 1e-300))[:, None]
    edges, corners = edges_of(faces), mesh.corners
    at_edge, at_vertex = np.zeros((len(edges.pairs), 3)), np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        np.add.at(at_edge, edges.of_face[:, k], normal)
        u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))
        np.add.at(at_vertex, faces[:, k], angle[:, None] * normal)
    return np.concatenate([normal[:, None], at_edge[edges.of_face], at_vertex[faces]], axis=1)
