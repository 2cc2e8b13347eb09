"""The surface behind a noisy scan, and the tests by which a cloud or a mesh is recognised as one."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, diags_array

from handsight.checks import Array
from handsight.objects.geometry import Roughness
from handsight.objects.scans.noise import NOISE, Noise, Points, estimated_noise, spacing_of
from handsight.objects.scans.patches import ScannedSurface, fitted
from handsight.objects.scans.roughness import roughness_of
from handsight.objects.surface import Triangles


class ScanOptions(NamedTuple):
    """`ScanOptions` say when points, or the vertices of a mesh, are a noisy scan."""

    max_points: int = 20_000  # more add little about an object that fits into a hand
    min_points: int = 200  # with fewer, noise and shape cannot be separated
    clean: float = 5e-4  # noise below which points with normals are used as they are [diameters]
    min_vertices: int = 1000  # a mesh with fewer was drawn, not scanned
    flat_angle: float = 1e-3  # angle below which two triangles are in one plane [rad]
    flat_share: float = 0.1
    """A mesh with more than this share of its edges between triangles in one plane was drawn: noise bends all edges."""
    outlying: float = 5.0  # standard deviations of noise beyond which a vertex is an outlier
    own_noise: float = 0.7  # least share of a scan's noise that neighbouring vertices do not have in common
    gaussian_quarter: float = 0.3186  # standard deviations within which a quarter of a Gaussian's draws are


SCAN = ScanOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A `Scan` is the surface behind noisy points, and the error of that surface."""

    noise: Noise
    surface: ScannedSurface
    roughness: Roughness


def scanned(points: Array, normals: Array | None, diameter: float) -> Scan | None:
    """Returns the surface behind points (n, 3) [m] with unit outward normals (n, 3) or None.

    Returns None for points that are used as they are: they have normals and hardly any noise, or are too few to measure
    their noise.
    """
    if len(points) < SCAN.min_points:
        return None
    order = np.random.default_rng(5).permutation(len(points))[: SCAN.max_points]
    places = points[order]
    unknown = np.full_like(places, np.nan)
    given = Points(places, unknown if normals is None else normals[order], spacing_of(places), diameter)
    given, noise = estimated_noise(given)
    if normals is not None and (noise.is_shape or noise.sigma < SCAN.clean * diameter):
        return None
    surface = fitted(given, noise)
    return Scan(noise, surface, roughness_of(surface, given, noise))


def smoothed(mesh: Triangles, diameter: float) -> tuple[Triangles, Roughness | None]:
    """Returns a mesh with its vertices moved onto the surface behind their noise, and the error of that surface. A mesh
    that is no noisy scan is returned as it is, with None."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    if len(used) < SCAN.min_vertices:
        return mesh, None
    i, j = mesh.shared
    face_normals = mesh.doubled_normals / np.maximum(2 * mesh.areas, 1e-300)[:, None]
    differences = np.linalg.norm(face_normals[i // 3] - face_normals[j // 3], axis=1)
    if not len(differences) or (differences < SCAN.flat_angle).mean() > SCAN.flat_share:
        return mesh, None
    vertices, faces = mesh.vertices[used], faces.reshape(mesh.faces.shape)
    normals = np.zeros_like(vertices)  # means of the triangles' normals, weighted by area
    for k in range(3):
        np.add.at(normals, faces[:, k], mesh.doubled_normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # The noise that vertices do not share with their neighbours, from second differences to these, where the surface is
    # smoothest. Detail as fine as the triangles leaves the same residuals of quadrics as noise does, but it is smooth
    # from vertex to vertex.
    start, end, count = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1), len(vertices)
    both = np.r_[start, end], np.r_[end, start]
    adjacent = coo_array((np.ones(2 * len(start)), both), (count, count)).tocsr()
    adjacent.data[:] = 1.0
    difference = diags_array(np.ones(count)) - diags_array(1 / adjacent.sum(axis=1)) @ adjacent
    twice = (difference @ difference).tocsr()
    residual = np.abs(((twice @ vertices) * normals).sum(axis=1)) / np.sqrt(twice.multiply(twice).sum(axis=1))
    own = float(np.quantile(residual, NOISE.smoothest) / SCAN.gaussian_quarter)
    scan = scanned(vertices, normals, diameter) if own > SCAN.own_noise * SCAN.clean * diameter else None
    if scan is None or own < SCAN.own_noise * scan.noise.sigma:
        return mesh, None
    there = scan.surface.blended(vertices, scan.surface.tree.query(vertices)[1])
    way = there[:, 1:] / np.linalg.norm(there[:, 1:], axis=1, keepdims=True)
    off = there[:, :1]
    # A vertex farther from the surface is no noise: it is at a corner that no quadric reaches, and stays where it is.
    vertices = np.where(np.abs(off) < SCAN.outlying * scan.noise.sigma, vertices - off * way, vertices)
    return Triangles(vertices, faces), scan.roughness
