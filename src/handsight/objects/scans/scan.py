"""Which clouds are scans, and the surface behind one."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, diags_array

from handsight.checks import Array, Indices
from handsight.objects.geometry import Roughness
from handsight.objects.scans.noise import NOISE, measured_noise
from handsight.objects.scans.patches import ScannedSurface, fitted
from handsight.objects.scans.roughness import roughness_of
from handsight.objects.scans.windows import Noise, Points, spacing_of
from handsight.objects.surface import Triangles, edges_of


class ScanOptions(NamedTuple):
    """`ScanOptions` say when points are a scan, and which."""

    max_points: int = 20_000  # more say little more about an object that fits into a hand
    min_points: int = 200  # fewer do not tell noise from shape
    clean: float = 5e-4  # points with normals whose noise is below this are taken for surface [diameters]
    min_vertices: int = 1000  # meshes of fewer were drawn, not scanned
    flat_angle: float = 1e-3  # triangles that meet at less than this angle lie in one plane [rad]
    flat_share: float = 0.1
    """Where they do so at more than this share of the edges, the mesh was drawn: noise leaves none."""
    outlying: float = 5.0  # deviations of noise beyond which a point is an outlier
    own_noise: float = 0.7  # vertices of a scan have at least this part of its noise each of its own
    gaussian_quarter: float = 0.3186  # of a standard deviation: a quarter of a Gaussian's draws are smaller


SCAN = ScanOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A `Scan` is what noisy points say of an object's surface."""

    noise: Noise
    surface: ScannedSurface
    roughness: Roughness


def scanned(points: Array, normals: Array | None, diameter: float) -> Scan | None:
    """Returns the surface behind points (n, 3) [m] with unit outward normals (n, 3) or none; None where the points
    are surface.

    They are where they have normals and no noise to speak of; so are too few to tell.
    """
    if len(points) < SCAN.min_points:
        return None
    order = np.random.default_rng(5).permutation(len(points))[: SCAN.max_points]
    places = points[order]
    unknown = np.full_like(places, np.nan)
    given = Points(places, unknown if normals is None else normals[order], spacing_of(places), diameter)
    given, noise = measured_noise(given)
    if normals is not None and (noise.is_shape or noise.sigma < SCAN.clean * diameter):
        return None
    surface = fitted(given, noise)
    return Scan(noise, surface, roughness_of(surface, given, noise))


def smoothed(mesh: Triangles, diameter: float) -> tuple[Triangles, Roughness | None]:
    """Returns a mesh with noisy vertices, moved to the surface behind them, and how far that is off; any other as it
    is."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    if len(used) < SCAN.min_vertices or _flat_share(mesh) > SCAN.flat_share:
        return mesh, None
    vertices, faces = mesh.vertices[used], faces.reshape(mesh.faces.shape)
    normals = _vertex_normals(Triangles(vertices, faces))
    own = _own_noise(vertices, faces, normals)
    scan = scanned(vertices, normals, diameter) if own > SCAN.own_noise * SCAN.clean * diameter else None
    if scan is None or own < SCAN.own_noise * scan.noise.sigma:
        return mesh, None
    there = scan.surface.blended(vertices, scan.surface.tree.query(vertices)[1])
    way = there[:, 1:] / np.linalg.norm(there[:, 1:], axis=1, keepdims=True)
    off = there[:, :1]
    # What is further off is no noise: a corner that no quadric reaches stays where it is.
    vertices = np.where(np.abs(off) < SCAN.outlying * scan.noise.sigma, vertices - off * way, vertices)
    return Triangles(vertices, faces), scan.roughness


def _flat_share(mesh: Triangles) -> float:
    """Returns the share of edges at which two triangles lie in one plane."""
    _, of_face, count = edges_of(mesh.faces)
    order = np.argsort(of_face.reshape(-1), kind="stable") // 3
    first = (np.cumsum(count) - count)[count == 2]
    normals = mesh.doubled_normals / np.maximum(2 * mesh.areas, 1e-300)[:, None]
    differences = np.linalg.norm(normals[order[first]] - normals[order[first + 1]], axis=1)
    return float((differences < SCAN.flat_angle).mean()) if len(differences) else 1.0


def _vertex_normals(mesh: Triangles) -> Array:
    """Returns (k, 3) unit normals at the vertices, by area."""
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], mesh.doubled_normals)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _own_noise(vertices: Array, faces: Indices, normals: Array) -> float:
    """Returns the noise [m] that each vertex has of its own, on the quietest part, from second differences to its
    neighbours.

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
    return float(np.quantile(off / scale, NOISE.smoothest) / SCAN.gaussian_quarter)
