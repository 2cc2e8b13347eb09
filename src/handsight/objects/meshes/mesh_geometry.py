"""The geometry of a triangle mesh: whether it is closed, and its two distance fields."""

from functools import partial

import numpy as np

from handsight.checks import Array, Indices, Mask
from handsight.objects.fields import Grid, grid_fields, grids
from handsight.objects.geometry import Geometry, geometry_of, roughened
from handsight.objects.meshes.box_tree import ClosestPoints, ClosestPointSearch, Winding, box_tree
from handsight.objects.meshes.repair import repaired, side_samples
from handsight.objects.pieces import components
from handsight.objects.scans.scan import smoothed
from handsight.objects.surface import MAX_HOLE, Triangles, diameter, unit


def mesh_geometry(mesh: Triangles) -> Geometry:
    """Returns the geometry of a mesh, which is repaired first; raises InvalidObject where no surface is left."""
    mesh, tree, remarks = repaired(mesh)
    size = diameter(mesh.vertices)
    mesh, roughness = smoothed(mesh, size)
    coarse, fine, coarser = grids(mesh.vertices, size)
    tree = tree if roughness is None else box_tree(mesh.corners.mean(axis=1))
    search = ClosestPointSearch(mesh, tree)
    winding = Winding.of_mesh(mesh, tree)
    rim = rim_of(mesh, winding, fine.cell)
    holes = holes_of(mesh, rim)
    closed = bool(holes[1].max(initial=0.0) <= MAX_HOLE * size) and _winds(mesh, winding, size)
    if closed:
        signed = partial(signed_by_winding, winding, holes)
    else:
        signed = partial(signed_by_normal, _pseudonormals(mesh, rim))

    def exact(index: Indices, within: float) -> tuple[Indices, Array]:
        closest, near = search.closest(fine.nodes_at(index), within)
        return index[near], signed(index[near], fine, closest)

    nodes = coarse.nodes()
    values = signed(np.arange(len(nodes)), coarse, search.closest(nodes)[0])
    fields = grid_fields(coarse, values, fine, exact, sheet=not closed)
    geometry = geometry_of(mesh, *fields, diameter=size, closed=closed, remarks=(*remarks, *coarser))
    return geometry if roughness is None else roughened(geometry, roughness)


def _winds(mesh: Triangles, winding: Winding, size: float) -> bool:
    """Returns whether the winding numbers beside nearly all samples of a mesh are those of a closed surface."""
    points, normals, _ = side_samples(mesh)
    step = 1e-4 * size * normals
    behind = winding.at(points - step)
    front = winding.at(points + step)
    # Where pieces overlap, the winding number is 2 and the surface within is no boundary: that is closed too.
    good = (behind > 0.6) & ((front < 0.4) | (front > 0.9))
    return bool(good.mean() >= 0.95)


def rim_of(mesh: Triangles, winding: Winding, cell: float) -> Mask:
    """Returns (e,) which edges of a mesh are on its rim: those with one triangle, except at slits.

    `cell` [m]: the cell of the fine grid. Around a point of a rim the winding number takes all values between two
    integers, a quarter of them on each quarter of a turn. Around a slit, where edges lie on each other without sharing
    vertices (a vertex of one within the other, or each its own), it is an integer.
    """
    edges = mesh.edges
    rim = np.asarray(edges.counts == 1)
    if not rim.any():
        return rim
    start, end = mesh.vertices[edges.vertices[rim]].swapaxes(0, 1)
    along = end - start
    pieces = np.ceil(np.linalg.norm(along, axis=1) / cell).astype(np.int64)
    edge = np.repeat(np.arange(len(start)), pieces)
    part = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5
    middles = start[edge] + (part / pieces[edge])[:, None] * along[edge]
    # Four places around each piece, between the directions along its triangle and across it.
    of_edge = np.empty(len(rim), dtype=np.int64)
    of_edge[edges.of_face] = np.arange(len(mesh.faces))[:, None]
    across = mesh.doubled_normals[of_edge[rim]]
    normal = unit(across)
    lateral = unit(np.cross(across, along))
    turns = np.stack([normal + lateral, normal - lateral, lateral - normal, -normal - lateral], axis=1)
    # At a tenth of a cell from an edge winding numbers show a rim; slits up to half as wide make none.
    around = middles[:, None] + 0.1 * cell / np.sqrt(2) * turns[edge]
    number = winding.at(around.reshape(-1, 3)).reshape(-1, 4)
    # Of four places around a rim, one has a number that is at least 0.375 from an integer.
    open_piece = np.abs(number - np.round(number)).max(axis=1) > 0.25
    rim[rim] = np.bincount(edge, open_piece, minlength=len(start)) > 0
    return rim


def holes_of(mesh: Triangles, rim: Mask) -> tuple[Array, Array]:
    """Returns the middles (h, 3) and the diagonals (h,) [m] of a mesh's holes: of the bounding boxes of connected runs
    of its rim's edges; `rim` (e,): which edges these are."""
    pairs = mesh.edges.vertices[rim]
    if not len(pairs):
        return np.empty((0, 3)), np.empty(0)
    used, local = np.unique(pairs, return_inverse=True)
    start, end = local.reshape(-1, 2).T
    label = components(start, end, len(used))
    low = np.full((label.max() + 1, 3), np.inf)
    high = -low
    points = mesh.vertices[used]
    np.minimum.at(low, label, points)
    np.maximum.at(high, label, points)
    return (low + high) / 2, np.linalg.norm(high - low, axis=1)


def signed_by_winding(
    winding: Winding, holes: tuple[Array, Array], index: Indices, grid: Grid, closest: ClosestPoints
) -> Array:
    """Returns signed distances (n,) [m] of nodes of a grid from a closed mesh: negative where its winding number is
    above one half.

    `index` (n,) of the nodes; `closest`: their closest points. Two neighbouring nodes whose distances add up to more
    than the step between them have no surface between them, so they share a sign, and of each connected set the winding
    number of the node farthest from the surface is enough. Near holes, where inside and outside are connected, that of
    every node is computed.
    """
    points = grid.nodes_at(index)
    free = np.ones(len(points), dtype=bool)
    for middle, extent in zip(*holes, strict=True):
        free &= ((points - middle) ** 2).sum(axis=1) > (extent / 2 + grid.cell) ** 2
    # Straight across a face the distances add up to one step, to rounding.
    label = linked(index, grid.shape, closest.distance, free, 1.5 * grid.cell)
    farthest_first = np.argsort(-closest.distance)
    first = np.unique(label[farthest_first], return_index=True)[1]
    inside = winding.inside(points[farthest_first[first]])
    return np.where(inside[label], -closest.distance, closest.distance)


def linked(index: Indices, shape: tuple[int, ...], distance: Array, free: Mask, limit: float) -> Indices:
    """Returns (n,) the number of the connected set of each node; `index` (n,): the nodes' places in a grid of `shape`.

    Neighbours are in one set where both are `free` (n,) and their values of `distance` (n,) add up to over `limit`.
    """
    place = np.full(shape, -1)
    place.reshape(-1)[index] = np.arange(len(index))
    pairs = []
    for axis, n in enumerate(shape):
        pair = np.stack([place.take(range(n - 1), axis).ravel(), place.take(range(1, n), axis).ravel()])
        pair = pair[:, (pair >= 0).all(axis=0)]
        apart = distance[pair].sum(axis=0) > limit
        pairs.append(pair[:, free[pair].all(axis=0) & apart])
    row, column = np.hstack(pairs)
    return components(row, column, len(index))


def signed_by_normal(normals: Array, index: Indices, grid: Grid, closest: ClosestPoints) -> Array:
    """Returns signed distances (n,) [m] of nodes of a grid from an open mesh: negative behind it, not behind its rim.

    `normals` (m, 7, 3): `_pseudonormals`. `index` (n,) of the nodes; `closest`: their closest points.
    """
    # One zero: the closest point is on the edge opposite that corner (12 for corner 0). Two: it is the third corner.
    zero = closest.weights == 0
    edge = np.array([2, 3, 1])[zero.argmax(axis=1)]
    corner = 4 + (~zero).argmax(axis=1)
    feature = np.choose(zero.sum(axis=1), [np.zeros_like(edge), edge, corner])
    normal = normals[closest.face, feature]
    behind = ((grid.nodes_at(index) - closest.points) * normal).sum(axis=1) < 0
    return np.where(behind, -closest.distance, closest.distance)


def _pseudonormals(mesh: Triangles, rim: Mask) -> Array:
    """Returns (m, 7, 3): each triangle's normals inside, on its edges 01, 12, 20 and at its corners, not normalised.

    They are weighted by angles, so that they show the side wherever the closest point is (Baerentzen and Aanaes 2005);
    on the rim, edges in `rim` (e,), they are zero.
    """
    faces = mesh.faces
    normal = mesh.normals
    corners = mesh.corners
    edges, of_face, _ = mesh.edges
    at_edge = np.zeros((len(edges), 3))
    at_vertex = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        np.add.at(at_edge, of_face[:, k], normal)
        u = corners[:, k - 2] - corners[:, k]
        v = corners[:, k - 1] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))
        np.add.at(at_vertex, faces[:, k], angle[:, None] * normal)
    at_edge[rim] = 0.0
    at_vertex[edges[rim]] = 0.0
    return np.concatenate([normal[:, None], at_edge[of_face], at_vertex[faces]], axis=1)
