"""What is measured on a triangle mesh: its two distance fields, and which side of it is inside."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handsight.checks import Array, Indices, Mask
from handsight.objects.fields import Grid, grids, sharpened
from handsight.objects.geometry import Geometry, measured, roughened
from handsight.objects.meshes.box_tree import ClosestPoints, ClosestPointSearch, Winding, box_tree
from handsight.objects.meshes.repair import components, repaired, side_samples
from handsight.objects.scans.scan import smoothed
from handsight.objects.surface import SURFACE, Triangles, diameter


class MeshOptions(NamedTuple):
    """`MeshOptions` say when a mesh is closed, and on which side of it a node is."""

    closed_share: float = 0.95  # of the edges that have two triangles, for a mesh to count as closed
    slit: float = 0.1
    """How near to its rim a hole is looked for [fine cells], and how far winding numbers there are from integers: at
    least 0.375 at one of four places around a rim. Slits up to about half as wide are none.
    """
    max_open_share: float = 0.25  # of the nodes near a rim that may be open
    votes: int = 16  # nodes of each connected set whose winding numbers are taken


MESH = MeshOptions()

LINK_MARGINS = (1.001, 1.5, np.inf)
"""Nodes are linked when their distances add up to this many steps; the last links none."""


def mesh_geometry(mesh: Triangles) -> Geometry:
    """Returns what is to be known of a mesh as it came: repaired, then measured; raises InvalidObject where nothing
    is left."""
    mesh, tree, remarks = repaired(mesh)
    size = diameter(mesh.vertices)
    mesh, roughness = smoothed(mesh, size)
    tree = tree if roughness is None else box_tree(mesh.corners.mean(axis=1))
    coarse, fine, coarser = grids(mesh.vertices, size)
    search, winding = ClosestPointSearch(mesh, tree), Winding.of_mesh(mesh, tree)
    rim = rim_of(mesh, winding, fine.cell)
    holes = holes_of(mesh, rim)
    closed = _is_closed(mesh, winding, holes, size)
    side = ByWinding(winding, holes) if closed else ByNormal(mesh, rim)

    def exact(index: Indices, within: float) -> tuple[Indices, Array]:
        closest, near = search.closest(fine.nodes_at(index), within)
        return index[near], side.signed(index[near], fine, closest)

    nodes = coarse.nodes()
    values = side.signed(np.arange(len(nodes)), coarse, search.closest(nodes)[0])
    sharp = sharpened(coarse, values, fine, exact, sheet=not closed)
    smooth, sharp_field = coarse.field(values, sheet=not closed), fine.field(sharp, sheet=not closed)
    remarks = (*remarks, *coarser)
    geometry = measured(mesh, smooth, sharp_field, diameter=size, closed=closed, remarks=remarks)
    return geometry if roughness is None else roughened(geometry, roughness)


def rim_of(mesh: Triangles, winding: Winding, cell: float) -> Mask:
    """Returns (e,) which edges of a mesh are its rim: those with one triangle, but for slits.

    `cell` [m]: the spacing of the finest thing that is to be told. Around a point of a rim the winding number runs
    through all that is between two whole numbers, a quarter of it on each quarter of a turn; around a slit, where edges
    lie on each other without sharing their vertices (a vertex of one within the other, or each its own), it is whole.
    """
    pairs, _, count = mesh.edges
    rim = np.asarray(count == 1)
    if not rim.any():
        return rim
    start, end = mesh.vertices[pairs[rim]].swapaxes(0, 1)
    along = end - start
    pieces = np.ceil(np.linalg.norm(along, axis=1) / cell).astype(np.int64)
    edge = np.repeat(np.arange(len(start)), pieces)
    part = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5
    middles = start[edge] + (part / pieces[edge])[:, None] * along[edge]
    # Around each piece, neither along its triangle nor across it.
    of_edge = np.empty(len(pairs), dtype=np.int64)
    of_edge[mesh.edges[1]] = np.arange(len(mesh.faces))[:, None]
    normal = mesh.doubled_normals[of_edge[rim]]
    lateral = np.cross(normal, along)
    normal, lateral = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (normal, lateral))
    turns = np.stack([normal + lateral, normal - lateral, -normal + lateral, -normal - lateral], axis=1)
    around = middles[:, None] + MESH.slit * cell / np.sqrt(2) * turns[edge]
    number = winding.at(around.reshape(-1, 3)).reshape(-1, 4)
    open_piece = np.abs(number - np.round(number)).max(axis=1) > MESH.max_open_share
    rim[rim] = np.bincount(edge, open_piece, minlength=len(start)) > 0
    return rim


@dataclass(frozen=True, slots=True, eq=False)
class Holes:
    """A `Holes` says where a surface ends."""

    middles: Array
    """(h, 3) of each connected run of boundary edges [m]."""
    extents: Array
    """(h,) the diagonal of its bounding box [m]."""


def holes_of(mesh: Triangles, rim: Mask | None = None) -> Holes:
    """Returns the holes of a mesh: its rim in connected runs. `rim` (e,): which edges; None: those with one
    triangle."""
    edges, _, count = mesh.edges
    pairs = edges[count == 1 if rim is None else rim]
    if not len(pairs):
        return Holes(np.empty((0, 3)), np.empty(0))
    used, local = np.unique(pairs, return_inverse=True)
    start, end = local.reshape(-1, 2).T
    label = components(start, end, len(used))
    low = np.full((label.max() + 1, 3), np.inf)
    high = -low
    np.minimum.at(low, label, mesh.vertices[used])
    np.maximum.at(high, label, mesh.vertices[used])
    return Holes((low + high) / 2, np.linalg.norm(high - low, axis=1))


def _is_closed(mesh: Triangles, winding: Winding, holes: Holes, diameter: float) -> bool:
    """Returns whether the surface has an inside: it winds once around what is behind it, and its holes are small."""
    if holes.extents.max(initial=0.0) > SURFACE.max_hole * diameter:
        return False
    points, normals, _ = side_samples(mesh)
    step = 1e-4 * diameter
    behind, front = winding.at(points - step * normals), winding.at(points + step * normals)
    # Where pieces overlap the count goes to 2 and the surface is no boundary: that is closed too.
    good = (behind > 0.6) & ((front < 0.4) | (front > 0.9))
    return bool(good.mean() >= MESH.closed_share)


@dataclass(frozen=True, slots=True, eq=False)
class ByWinding:
    """`ByWinding` tells sides so: inside is where the surface winds around a point more than half a time.

    Two neighbouring nodes whose distances add up to more than the step between them have no surface between
    them, so they share a sign: one winding number for each connected set is enough. Near holes, where
    inside and outside are connected, every node has its own.
    """

    winding: Winding
    holes: Holes

    def signed(self, index: Indices, grid: Grid, closest: ClosestPoints) -> Array:
        """Returns signed distances (n,) [m] of these nodes of a grid, given their closest points."""
        from handsight._kernels.mesh.connected_nodes import linked  # numba's import is long

        points = grid.nodes_at(index)
        free = np.ones(len(points), dtype=bool)
        for middle, extent in zip(self.holes.middles, self.holes.extents, strict=True):
            free &= ((points - middle) ** 2).sum(axis=1) > (extent / 2 + grid.cell) ** 2
        inside = np.zeros(len(points), dtype=bool)
        todo = np.arange(len(points))
        for margin in LINK_MARGINS:
            limit = margin * grid.cell  # right across a face it is the step, give or take the rounding
            label = linked(index[todo], grid.shape, closest.distance[todo], free[todo], limit)
            votes, agreed = self._votes(label, points[todo])
            inside[todo] = votes[label]
            todo = todo[~agreed[label]]
            if not len(todo):
                break
        return np.asarray(np.where(inside, -closest.distance, closest.distance))

    def _votes(self, label: Indices, points: Array) -> tuple[Mask, Mask]:
        """Returns whether each set is inside, and whether its voters agree.

        They do not where a distance that is a little too large has linked the two sides.
        """
        order = np.argsort(label, kind="stable")
        size = np.bincount(label)
        start = np.cumsum(size) - size
        spread = np.random.default_rng(4).random((len(size), MESH.votes))
        voters = order[start[:, None] + (spread * size[:, None]).astype(np.int64)]
        asked, which = np.unique(voters, return_inverse=True)
        inside = self.winding.inside(points[asked])[which].reshape(voters.shape)
        return inside[:, 0], np.asarray(inside.all(axis=1) | ~inside.any(axis=1))


class ByNormal:
    """`ByNormal` tells sides so: behind an open surface is where its normal at the nearest point looks away; nothing
    is behind a rim."""

    def __init__(self, mesh: Triangles, rim: Mask) -> None:
        """`rim` (e,): which of the mesh's edges are its rim."""
        self._normals = _pseudonormals(mesh, rim)

    def signed(self, index: Indices, grid: Grid, closest: ClosestPoints) -> Array:
        """Returns signed distances (n,) [m] of these nodes of a grid, given their closest points."""
        zero = closest.weights == 0
        count = zero.sum(axis=1)
        # Opposite corner 0 is edge 12, and so on; with two zeros it is the third corner.
        edge = np.array([2, 3, 1])[zero.argmax(axis=1)]
        corner = 4 + (~zero).argmax(axis=1)
        feature = np.where(count == 0, 0, np.where(count == 1, edge, corner))
        normal = self._normals[closest.face, feature]
        behind = ((grid.nodes_at(index) - closest.points) * normal).sum(axis=1) < 0
        return np.asarray(np.where(behind, -closest.distance, closest.distance))


def _pseudonormals(mesh: Triangles, rim: Mask) -> Array:
    """Returns (m, 7, 3): each triangle's normals inside, on its edges 01, 12, 20 and at its corners, not normalised.

    Angle-weighted, so that their sign tells the side of the nearest point wherever it lies (Baerentzen and
    Aanaes 2005); zero on the rim, edges in `rim` (e,).
    """
    faces = mesh.faces
    normal = mesh.doubled_normals / (2 * np.maximum(mesh.areas, 1e-300))[:, None]
    (edges, of_face, _), corners = mesh.edges, mesh.corners
    at_edge, at_vertex = np.zeros((len(edges), 3)), np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        np.add.at(at_edge, of_face[:, k], normal)
        u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))
        np.add.at(at_vertex, faces[:, k], angle[:, None] * normal)
    at_edge[rim], at_vertex[edges[rim]] = 0.0, 0.0
    return np.concatenate([normal[:, None], at_edge[of_face], at_vertex[faces]], axis=1)
