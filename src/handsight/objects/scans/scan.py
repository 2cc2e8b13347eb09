"""Which clouds are scans, and the surface behind one."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, diags_array

from handsight.checks import Array, Indices
from handsight.objects.geometry import Roughness
from handsight.objects.scans.noise import QUIET, measured_noise
from handsight.objects.scans.patches import ScannedSurface, fitted
from handsight.objects.scans.roughness import roughness_of
from handsight.objects.scans.windows import Noise, Points, spacing_of
from handsight.objects.surface import Triangles, edges_of

MOST_POINTS = 20_000
"""More say little more about an object that fits into a hand."""
LEAST_POINTS = 200
"""Fewer do not tell noise from shape."""
CLEAN = 5e-4
"""Points with normals whose noise is below this [diameters] are taken for surface."""
LEAST_VERTICES = 1000
"""Meshes of fewer were drawn, not scanned."""
FLAT, DRAWN = 1e-3, 0.1
"""Triangles that meet at less than this angle [rad] lie in one plane; where they do so at more than this share of the
edges, the mesh was drawn: noise leaves none."""
FAR = 5.0
"""Deviations of noise."""
OWN = 0.7
"""Vertices of a scan have at least this part of its noise each of its own."""
QUARTER_OF_GAUSSIAN = 0.3186
"""Of a standard deviation: a quarter of a Gaussian's draws are smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What noisy points say of an object's surface."""

    noise: Noise
    surface: ScannedSurface
    roughness: Roughness


def scanned(points: Array, normals: Array | None, diameter: float) -> Scan | None:
    """The surface behind points (n, 3) [m] with unit outward normals (n, 3) or none; None where the points are surface.

    They are where they have normals and no noise to speak of; so are too few to tell.
    """
    if len(points) < LEAST_POINTS:
        return None
    order = np.random.default_rng(5).permutation(len(points))[:MOST_POINTS]
    places = points[order]
    unknown = np.full_like(places, np.nan)
    given = Points(places, unknown if normals is None else normals[order], spacing_of(places), diameter)
    given, noise = measured_noise(given)
    if normals is not None and (noise.is_shape or noise.sigma < CLEAN * diameter):
        return None
    surface = fitted(given, noise)
    return Scan(noise, surface, roughness_of(surface, given, noise))


def smoothed(mesh: Triangles, diameter: float) -> tuple[Triangles, Roughness | None]:
    """A mesh with noisy vertices, moved to the surface behind them, and how far that is off; any other as it is."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    if len(used) < LEAST_VERTICES or _flat_share(mesh) > DRAWN:
        return mesh, None
    vertices, faces = mesh.vertices[used], faces.reshape(mesh.faces.shape)
    normals = _vertex_normals(Triangles(vertices, faces))
    own = _own_noise(vertices, faces, normals)
    scan = scanned(vertices, normals, diameter) if own > OWN * CLEAN * diameter else None
    if scan is None or own < OWN * scan.noise.sigma:
        return mesh, None
    there = scan.surface.blended(vertices, scan.surface.tree.query(vertices)[1])
    way = there[:, 1:] / np.linalg.norm(there[:, 1:], axis=1, keepdims=True)
    off = there[:, :1]
    # What is further off is no noise: a corner that no quadric reaches stays where it is.
    vertices = np.where(np.abs(off) < FAR * scan.noise.sigma, vertices - off * way, vertices)
    return Triangles(vertices, faces), scan.roughness


def _flat_share(mesh: Triangles) -> float:
    """The share of edges at which two triangles lie in one plane."""
    _, of_face, count = edges_of(mesh.faces)
    order = np.argsort(of_face.reshape(-1), kind="stable") // 3
    first = (np.cumsum(count) - count)[count == 2]
    normals = mesh.doubled_normals / np.maximum(2 * mesh.areas, 1e-300)[:, None]
    differences = np.linalg.norm(normals[order[first]] - normals[order[first + 1]], axis=1)
    return float((differences < FLAT).mean()) if len(differences) else 1.0


def _vertex_normals(mesh: Triangles) -> Array:
    """(k, 3) unit normals at the vertices, by area."""
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], mesh.doubled_normals)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _own_noise(vertices: Array, faces: Indices, normals: Array) -> float:
    """The noise [m] that each vertex has of its own, on the quietest part, from second differences to its neighbours.

    Detail as fine as the triangles leaves residuals like noise; from vertex to vertex it is smooth.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = len(vertices)
    linked = coo_array(
        (np.ones(2 * len(start)), (np.r_[start, end], np.r_[end, start])), (count, count)
    ).tocsr()
    linked.data[:] = 1.0
    mean = diags_array(1 / linked.sum(axis=1)) @ linked
    difference = diags_array(np.ones(count)) - mean
    twice = (difference @ difference).tocsr()
    off = np.abs(((twice @ vertices) * normals).sum(axis=1))
    scale = np.sqrt(twice.multiply(twice).sum(axis=1))
    return float(np.quantile(off / scale, QUIET) / QUARTER_OF_GAUSSIAN)
