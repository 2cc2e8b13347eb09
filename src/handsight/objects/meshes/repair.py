"""A mesh as it should be, from a mesh as it came, and what had to be done to it in words."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.objects.geometry import check_extent
from handsight.objects.meshes.box_tree import Halves, halves
from handsight.objects.meshes.topology import consistent, pieces
from handsight.objects.meshes.triangles import Faces, Triangles
from handsight.objects.meshes.winding import Winding

_SAME_POINT = 1e-9
"""Vertices closer than this part of the extent are one."""
_FLAT = 1e-12
"""A triangle whose height is below this part of its longest side has no area."""
SIDE_SAMPLES = 400
INSIDE_OUT = -0.55
"""A patch sees -0.5 in front of it, an inside-out solid -1."""
SMALL_PIECE = 0.01


def repaired(vertices: ArrayLike, faces: ArrayLike) -> tuple[Triangles, Halves, tuple[str, ...]]:
    """A mesh with finite, merged vertices and consistent triangles that face outwards, its parts, and the remarks.

    `vertices` (k, 3) [m], `faces` (m, 3) indices. Raises InvalidObject where no surface is left.
    """
    points, triangles = _arrays(vertices, faces)
    remarks: list[str] = []
    points, triangles = _referenced(points, triangles, remarks)
    points, triangles = _merged(points, triangles)
    triangles = _distinct(points, triangles, remarks)
    triangles, turned, orientable = consistent(triangles)
    if turned:
        remarks.append(f"{turned} of {len(triangles)} triangles were turned to agree with their neighbours")
    if not orientable:
        remarks.append(
            "the surface has one side only somewhere: its triangles cannot all agree on what is outside"
        )
    parts = halves(points[triangles].mean(axis=1))
    mesh = _facing_out(Triangles(points, triangles), parts, remarks)
    return mesh, parts, tuple(remarks)


def _arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, Faces]:
    """Both as arrays of the right shape and type."""
    try:
        points, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    except (TypeError, ValueError):
        raise InvalidObject("mesh: expected numbers for vertices (k, 3) and faces (m, 3)") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InvalidObject(f"vertices: expected shape (k, 3) with k ≥ 3, got {points.shape}")
    if triangles.size == 0:
        raise InvalidObject("faces: expected at least one triangle, got none")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InvalidObject(
            f"faces: expected whole numbers of shape (m, 3), got {triangles.dtype} {triangles.shape}"
        )
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InvalidObject(
            f"faces: expected indices 0 to {len(points) - 1}, got {triangles.min()} to {triangles.max()}"
        )
    return points, triangles.astype(np.int64)


def _referenced(points: Array, triangles: Faces, remarks: list[str]) -> tuple[Array, Faces]:
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


def _merged(points: Array, triangles: Faces) -> tuple[Array, Faces]:
    """Equal vertices as one: STL, and OBJ with texture, repeat them for every triangle."""
    extent = check_extent(points, "vertices")
    keys = np.round((points - points.min(axis=0)) / (_SAME_POINT * extent)).astype(np.int64)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    # In the order they came, so that a mesh without doubles stays as it is.
    rank = np.argsort(np.argsort(first))
    return points[np.sort(first)], rank[which.reshape(-1)][triangles]


def _distinct(points: Array, triangles: Faces, remarks: list[str]) -> Faces:
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


def _named(triangles: Faces, count: int) -> NDArray[np.int64]:
    """(m,) a number for each triangle of `count` vertices, the same for the same corners."""
    pair = np.unique(triangles[:, 0] * count + triangles[:, 1], return_inverse=True)[1].reshape(-1)
    return np.asarray(pair * count + triangles[:, 2])


def _facing_out(mesh: Triangles, parts: Halves, remarks: list[str]) -> Triangles:
    """The mesh with every piece that was inside out turned."""
    piece = pieces(mesh.faces)
    count = int(piece.max()) + 1
    area = np.bincount(piece, mesh.areas)
    points, normals, face = side_samples(mesh)
    front = Winding.of_mesh(mesh, parts).at(points + _step(mesh) * normals)
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


def side_samples(mesh: Triangles) -> tuple[Array, Array, Faces]:
    """Surface points (n, 3) [m], the normals (n, 3) and indices (n,) of their triangles."""
    points, face = mesh.draw_on_faces(SIDE_SAMPLES, np.random.default_rng(3))
    normals = mesh.doubled_normals[face]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), face


def _step(mesh: Triangles) -> float:
    """How far in front of the surface its winding number is taken [m]: less than any wall is thick."""
    return 1e-4 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
