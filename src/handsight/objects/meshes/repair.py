"""A mesh as it should be, from a mesh as it came, and what had to be done to it in words."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidObject
from handsight.objects.meshes.box_tree import BoxTree, Winding, box_tree
from handsight.objects.surface import Triangles, check_extent, distinct, edges_of


class RepairOptions(NamedTuple):
    """`RepairOptions` are what is repaired in a mesh."""

    flat: float = 1e-12  # a triangle whose height is below this part of its longest side has no area
    side_samples: int = 400  # places at which a mesh is asked which side is outside
    inside_out: float = -0.55  # a patch sees a winding number of -0.5 in front of it, an inside-out solid -1
    small_piece: float = 0.01  # part of the area below which a loose piece is left out
    same_corner: float = 1e-4
    """Corners of edges with one triangle that are closer than this part of the extent are one: files round."""


REPAIR = RepairOptions()


def repaired(mesh: Triangles) -> tuple[Triangles, BoxTree, tuple[str, ...]]:
    """Returns a mesh with finite, merged vertices and consistent triangles that face outwards, a tree over it, and
    remarks.

    Raises InvalidObject where no surface is left.
    """
    remarks: list[str] = []
    points, triangles = _referenced(mesh.vertices, mesh.faces, remarks)
    # STL, and OBJ with texture, repeat vertices for every triangle.
    first, which = distinct(points, check_extent(points, "vertices"))
    points, triangles = points[first], which[triangles]
    triangles = _distinct(points, triangles, remarks)
    edges = edges_of(triangles)
    if (edges[2] == 1).any():
        points, triangles = _joined(points, triangles, edges[0][edges[2] == 1])
        edges = edges_of(triangles)
    triangles, turned, orientable = _consistent(triangles, edges)
    if turned:
        remarks.append(f"{turned} of {len(triangles)} triangles were turned to agree with their neighbours")
    if not orientable:
        remarks.append(
            "the surface has one side only somewhere: its triangles cannot all agree on what is outside"
        )
    tree = box_tree(points[triangles].mean(axis=1))
    return _facing_out(Triangles(points, triangles), tree, remarks), tree, tuple(remarks)


def _referenced(points: Array, triangles: Indices, remarks: list[str]) -> tuple[Array, Indices]:
    """Returns only vertices that triangles use; those must be finite."""
    used, which = np.unique(triangles, return_inverse=True)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    if not finite[used].all():
        bad = int(used[~finite[used]][0])
        raise InvalidObject(f"vertices[{bad}]: expected 3 finite numbers, got {points[bad].tolist()}")
    if not finite.all():
        remarks.append(f"{int((~finite).sum())} unused vertices that are not finite were dropped")
    return points[used], which.reshape(-1, 3)


def _distinct(points: Array, triangles: Indices, remarks: list[str]) -> Indices:
    """Returns triangles with an area, each once."""
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    longest2 = (sides * sides).sum(axis=2).max(axis=1)
    flat = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= REPAIR.flat * longest2
    if flat.all():
        raise InvalidObject(f"faces: expected triangles with an area, got {len(flat)} without")
    if flat.any():
        remarks.append(f"{int(flat.sum())} triangles without area were dropped")
    triangles = triangles[~flat]
    first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]
    if len(first) < len(triangles):
        remarks.append(f"{len(triangles) - len(first)} repeated triangles were dropped")
    return triangles[np.sort(first)]


def _joined(points: Array, triangles: Indices, boundary: Indices) -> tuple[Array, Indices]:
    """Returns points and triangles where corners (b, 2) of edges with one triangle that are nearly the same are the
    same."""
    used = np.unique(boundary)
    extent = float(np.ptp(points, axis=0).max())
    near = cKDTree(points[used]).query_pairs(REPAIR.same_corner * extent, output_type="ndarray")
    if not len(near):
        return points, triangles
    label = components(near[:, 0], near[:, 1], len(used))
    which = np.arange(len(points))
    which[used] = used[np.unique(label, return_index=True)[1][label]]
    triangles = which[triangles]
    # What lay between two such corners is a line now.
    triangles = triangles[(triangles != np.roll(triangles, -1, axis=1)).all(axis=1)]
    triangles = _distinct(points, triangles, [])
    return _referenced(points, triangles, [])


def _consistent(faces: Indices, edges: tuple[Indices, ...]) -> tuple[Indices, int, bool]:
    """Returns triangles turned so that neighbours agree, how many were turned, and whether all could agree."""
    _, of_face, count = edges
    order = np.argsort(of_face, axis=None, kind="stable")
    # Of each edge of just two triangles, its places in these; they agree where they run through it oppositely.
    first = (np.cumsum(count) - count)[count == 2]
    i, j = order[first], order[first + 1]
    forward = (faces < np.roll(faces, -1, axis=1)).reshape(-1)
    agree = forward[i] != forward[j]
    if agree.all():
        return faces, 0, True
    flip, orientable = agreeing(i // 3, j // 3, agree, len(faces))
    return _turned_over(faces, flip), int(flip.sum()), orientable


def _facing_out(mesh: Triangles, tree: BoxTree, remarks: list[str]) -> Triangles:
    """Returns the mesh with every piece that was inside out turned."""
    piece = _pieces(mesh.faces)
    count = int(piece.max()) + 1
    points, normals, face = side_samples(mesh)
    step = 1e-4 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))  # less than any wall is thick
    front = Winding.of_mesh(mesh, tree).at(points + step * normals)
    inverted = np.zeros(count, dtype=bool)
    for k in np.unique(piece[face]):
        inverted[k] = np.median(front[piece[face] == k]) < REPAIR.inside_out
    if inverted.any():
        what = "the surface was" if count == 1 else f"{int(inverted.sum())} of {count} separate pieces were"
        remarks.append(f"{what} inside out and turned")
    share = np.bincount(piece, mesh.areas) / mesh.area
    small = share < REPAIR.small_piece
    if small.any():
        percent = f"{100 * share[small].sum():.2g} %"
        remarks.append(f"{int(small.sum())} small separate pieces ({percent} of the area) were left in")
    return Triangles(mesh.vertices, _turned_over(mesh.faces, inverted[piece]))


def _pieces(faces: Indices) -> Indices:
    """Returns (m,) the connected piece of each triangle, through shared vertices."""
    label = components(faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1), int(faces.max()) + 1)
    return np.unique(label[faces[:, 0]], return_inverse=True)[1].reshape(-1)


def _turned_over(faces: Indices, flip: Mask) -> Indices:
    """Returns triangles (m, 3), those in `flip` (m,) seen from the other side."""
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def side_samples(mesh: Triangles) -> tuple[Array, Array, Indices]:
    """Returns surface points (n, 3) [m], the normals (n, 3) and indices (n,) of their triangles."""
    return mesh.draw_on_faces(REPAIR.side_samples, np.random.default_rng(3))


def agreeing(i: Indices, j: Indices, agree: Mask, size: int) -> tuple[Mask, bool]:
    """Returns which (size,) of things to turn, so that linked ones, i (l,) and j (l,), agree, and whether all could.

    `agree` (l,): whether they do as they are. Each thing stands twice in a graph, as it is and turned; those that
    agree are linked side to side, others crosswise. What is connected to a thing "as it is" is how its neighbours
    must stand.
    """
    row = np.concatenate([i, i + size])
    column = np.concatenate([np.where(agree, j, j + size), np.where(agree, j + size, j)])
    label = components(row, column, 2 * size)
    as_is, turned = label[:size], label[size:]
    # The two halves of a piece carry two labels; the more common one "as it is" wins.
    votes = np.bincount(as_is, minlength=label.max() + 1)
    flip = (votes[turned] > votes[as_is]) | ((votes[turned] == votes[as_is]) & (turned < as_is))
    return flip, bool((as_is != turned).all())


def components(row: Indices, column: Indices, size: int) -> Indices:
    """Returns (size,) the connected component of each node of a graph with links from `row` (l,) to `column` (l,)."""
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
