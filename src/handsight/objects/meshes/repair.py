"""A mesh as it should be, from a mesh as it came, and what had to be done to it in words."""

import numpy as np

from handsight.checks import Array, Indices
from handsight.errors import InvalidObject
from handsight.objects.meshes.box_tree import BoxTree, box_tree
from handsight.objects.meshes.topology import consistent, pieces
from handsight.objects.meshes.winding import Winding
from handsight.objects.surface import Triangles, check_extent, distinct

_FLAT = 1e-12
"""A triangle whose height is below this part of its longest side has no area."""
SIDE_SAMPLES = 400
INSIDE_OUT = -0.55
"""A patch sees -0.5 in front of it, an inside-out solid -1."""
SMALL_PIECE = 0.01


def repaired(mesh: Triangles) -> tuple[Triangles, BoxTree, tuple[str, ...]]:
    """A mesh with finite, merged vertices and consistent triangles that face outwards, a tree over it, and remarks.

    Raises InvalidObject where no surface is left.
    """
    remarks: list[str] = []
    points, triangles = _referenced(mesh.vertices, mesh.faces, remarks)
    points, triangles = _merged(points, triangles)
    triangles = _distinct(points, triangles, remarks)
    triangles, turned, orientable = consistent(triangles)
    if turned:
        remarks.append(f"{turned} of {len(triangles)} triangles were turned to agree with their neighbours")
    if not orientable:
        remarks.append(
            "the surface has one side only somewhere: its triangles cannot all agree on what is outside"
        )
    tree = box_tree(points[triangles].mean(axis=1))
    return _facing_out(Triangles(points, triangles), tree, remarks), tree, tuple(remarks)


def _referenced(points: Array, triangles: Indices, remarks: list[str]) -> tuple[Array, Indices]:
    """Only vertices that triangles use; those must be finite."""
    used = np.unique(triangles)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    if not finite[used].all():
        bad = int(used[~finite[used]][0])
        raise InvalidObject(f"vertices[{bad}]: expected 3 finite numbers, got {points[bad].tolist()}")
    if not finite.all():
        remarks.append(f"{int((~finite).sum())} unused vertices that are not finite were dropped")
    new = np.zeros(len(points), dtype=np.int64)
    new[used] = np.arange(len(used))
    return points[used], new[triangles]


def _merged(points: Array, triangles: Indices) -> tuple[Array, Indices]:
    """Equal vertices as one: STL, and OBJ with texture, repeat them for every triangle."""
    first, which = distinct(points, check_extent(points, "vertices"))
    return points[first], which[triangles]


def _distinct(points: Array, triangles: Indices, remarks: list[str]) -> Indices:
    """Triangles with an area, each once."""
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    longest2 = (sides * sides).sum(axis=2).max(axis=1)
    flat = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= _FLAT * longest2
    if flat.all():
        raise InvalidObject(f"faces: expected triangles with an area, got {len(flat)} without")
    if flat.any():
        remarks.append(f"{int(flat.sum())} triangles without area were dropped")
    triangles = triangles[~flat]
    first = np.unique(_named(np.sort(triangles, axis=1), len(points)), return_index=True)[1]
    if len(first) < len(triangles):
        remarks.append(f"{len(triangles) - len(first)} repeated triangles were dropped")
    return triangles[np.sort(first)]


def _named(triangles: Indices, count: int) -> Indices:
    """(m,) a number for each triangle of `count` vertices, the same for the same corners."""
    pair = np.unique(triangles[:, 0] * count + triangles[:, 1], return_inverse=True)[1].reshape(-1)
    return np.asarray(pair * count + triangles[:, 2])


def _facing_out(mesh: Triangles, tree: BoxTree, remarks: list[str]) -> Triangles:
    """The mesh with every piece that was inside out turned."""
    piece = pieces(mesh.faces)
    count = int(piece.max()) + 1
    area = np.bincount(piece, mesh.areas)
    points, normals, face = side_samples(mesh)
    front = Winding.of_mesh(mesh, tree).at(points + _step(mesh) * normals)
    inverted = np.zeros(count, dtype=bool)
    for k in np.unique(piece[face]):
        inverted[k] = np.median(front[piece[face] == k]) < INSIDE_OUT
    if inverted.any():
        what = "the surface was" if count == 1 else f"{int(inverted.sum())} of {count} separate pieces were"
        remarks.append(f"{what} inside out and turned")
    small = area < SMALL_PIECE * area.sum()
    if count > 1 and small.any():
        share = 100 * area[small].sum() / area.sum()
        remarks.append(f"{int(small.sum())} small separate pieces ({share:.2g} % of the area) were left in")
    flip = inverted[piece]
    return Triangles(mesh.vertices, np.where(flip[:, None], mesh.faces[:, [0, 2, 1]], mesh.faces))


def side_samples(mesh: Triangles) -> tuple[Array, Array, Indices]:
    """Surface points (n, 3) [m], the normals (n, 3) and indices (n,) of their triangles."""
    return mesh.draw_on_faces(SIDE_SAMPLES, np.random.default_rng(3))


def _step(mesh: Triangles) -> float:
    """How far in front of the surface its winding number is taken [m]: less than any wall is thick."""
    return 1e-4 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
