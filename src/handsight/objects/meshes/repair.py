"""Repair of a mesh: merges vertices, makes triangles agree and turns them outwards, with a remark on each repair."""

import numpy as np
from scipy.spatial import cKDTree

from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidObject
from handsight.objects.meshes.box_tree import BoxTree, Winding, box_tree
from handsight.objects.pieces import agreeing, components
from handsight.objects.surface import Triangles, check_extent, distinct


def repaired(mesh: Triangles) -> tuple[Triangles, BoxTree, tuple[str, ...]]:
    """Returns the mesh with merged vertices and consistent triangles that face outwards, a tree over it, and remarks.

    Raises InvalidObject where no surface is left, or where a vertex of a triangle is not finite.
    """
    remarks: list[str] = []
    points, triangles = _referenced(mesh.vertices, mesh.faces, remarks)
    # STL, and OBJ with texture, repeat vertices for every triangle.
    first, which = distinct(points, check_extent(points, "vertices"))
    points = points[first]
    triangles = which[triangles]
    triangles = _distinct(points, triangles, remarks)
    edges = Triangles(points, triangles).edges
    if (edges.counts == 1).any():
        used = np.unique(edges.vertices[edges.counts == 1])
        extent = float(np.ptp(points, axis=0).max())
        # Ends of edges with one triangle that are so near are one, because files round.
        near = cKDTree(points[used]).query_pairs(1e-4 * extent, output_type="ndarray")
        if len(near):
            label = components(near[:, 0], near[:, 1], len(used))
            _, first = np.unique(label, return_index=True)
            which = np.arange(len(points))
            which[used] = used[first[label]]
            triangles = which[triangles]
            # A triangle between two such corners has become a line.
            triangles = triangles[(triangles != np.roll(triangles, -1, axis=1)).all(axis=1)]
            points, triangles = _referenced(points, _distinct(points, triangles, []), [])
    # Neighbours agree if they run along their common edge in opposite directions.
    i, j = Triangles(points, triangles).shared
    forward = (triangles < np.roll(triangles, -1, axis=1)).reshape(-1)
    agree = forward[i] != forward[j]
    if not agree.all():
        flip, orientable = agreeing(i // 3, j // 3, agree, len(triangles))
        triangles = _turned_over(triangles, flip)
        if turned := int(flip.sum()):
            remarks.append(
                f"{turned} of {len(triangles)} triangles were turned to agree with their neighbours"
            )
        if not orientable:
            remarks.append(
                "the surface has one side only somewhere: its triangles cannot all agree on what is outside"
            )
    tree = box_tree(points[triangles].mean(axis=1))
    return _facing_out(Triangles(points, triangles), tree, remarks), tree, tuple(remarks)


def _referenced(points: Array, triangles: Indices, remarks: list[str]) -> tuple[Array, Indices]:
    """Returns the vertices that triangles use, and the triangles by their indices; raises InvalidObject for NaN."""
    used, which = np.unique(triangles, return_inverse=True)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    if not finite[used].all():
        bad = int(used[~finite[used]][0])
        raise InvalidObject(f"vertices[{bad}]: expected 3 finite numbers, got {points[bad].tolist()}")
    if not finite.all():
        remarks.append(f"{int((~finite).sum())} unused vertices that are not finite were dropped")
    return points[used], which.reshape(-1, 3)


def _distinct(points: Array, triangles: Indices, remarks: list[str]) -> Indices:
    """Returns the triangles with an area, each once; raises InvalidObject where none has an area."""
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    longest2 = (sides * sides).sum(axis=2).max(axis=1)
    # Of those without an area, the height is that share of the longest side.
    flat = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= 1e-12 * longest2
    if flat.all():
        raise InvalidObject(f"faces: expected triangles with an area, got {len(flat)} without")
    if flat.any():
        remarks.append(f"{int(flat.sum())} triangles without area were dropped")
    triangles = triangles[~flat]
    first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]
    if len(first) < len(triangles):
        remarks.append(f"{len(triangles) - len(first)} repeated triangles were dropped")
    return triangles[np.sort(first)]


def _facing_out(mesh: Triangles, tree: BoxTree, remarks: list[str]) -> Triangles:
    """Returns the mesh with every piece that was inside out turned; a piece is connected through shared vertices."""
    faces = mesh.faces
    label = components(faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1), int(faces.max()) + 1)
    piece = np.unique(label[faces[:, 0]], return_inverse=True)[1].reshape(-1)
    count = int(piece.max()) + 1
    points, normals, face = side_samples(mesh)
    step = 1e-4 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))  # less than any wall is thick
    front = Winding.of_mesh(mesh, tree).at(points + step * normals)
    # A patch has a winding number of -0.5 in front of it, a turned solid of -1.
    inverted = np.zeros(count, dtype=bool)
    of_sample = piece[face]
    for k in np.unique(of_sample):
        inverted[k] = np.median(front[of_sample == k]) < -0.55
    if inverted.any():
        what = "the surface was" if count == 1 else f"{int(inverted.sum())} of {count} separate pieces were"
        remarks.append(f"{what} inside out and turned")
    share = np.bincount(piece, mesh.areas) / mesh.area
    small = share < 0.01  # of the area; such pieces are remarked
    if small.any():
        percent = f"{100 * share[small].sum():.2g} %"
        remarks.append(f"{int(small.sum())} small separate pieces ({percent} of the area) were left in")
    return Triangles(mesh.vertices, _turned_over(mesh.faces, inverted[piece]))


def _turned_over(faces: Indices, flip: Mask) -> Indices:
    """Returns triangles (m, 3), those in `flip` (m,) with their corners in the opposite order."""
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def side_samples(mesh: Triangles) -> tuple[Array, Array, Indices]:
    """Returns random surface points (n, 3) [m], with the normals (n, 3) and indices (n,) of their triangles."""
    return mesh.draw_on_faces(400, np.random.default_rng(3))
