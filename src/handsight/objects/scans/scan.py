"""The surface behind a noisy scan, the tests by which a cloud or a mesh is recognised as one, and the surface's error.

The error is a function of place: from the scan's noise, from its holes, or declared by its file. It is variances (m, 4)
as in `FieldError`: of the distance, of the normal, and of slope and curvature, from which follows the spurious
information that noise adds about a flat direction.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.spatial import cKDTree

from handsight.checks import Array
from handsight.objects.geometry import Geometry, Roughness, with_error
from handsight.objects.kernels.scan_error import CHI2_95
from handsight.objects.scans.patches import (
    NOISE_SMOOTHEST,
    NOISE_THINNED,
    Noise,
    Points,
    ScannedSurface,
    estimated_noise,
    fitted,
    spacing_of,
)
from handsight.objects.surface import Triangles, unit

COVERED_GAP = 1.5  # distance to the nearest point up to which the scanner saw a place [spacings]
CLEAR = 0.2  # distance of the winding number from 0 and from 1 up to which no surface can pass
DECLARED_LENGTH = 0.05
"""Correlation length of declared errors [m]: fused depth images, and guessed surfaces, have errors in common over
centimetres, by the camera's constant error, which the points themselves do not show."""


def roughness_of(surface: ScannedSurface, points: Points, noise: Noise) -> Roughness:
    """Returns the variances of distance, normal, slope and curvature that a contact meets at each patch.

    The scatter of the points gives the random error of the fits. Where the mean of many residuals is larger than chance
    explains, a window was too large for the shape, and that mean is added.
    """
    height, normal, bend = surface.variances.T
    patches = surface.patches
    n = len(points.places)
    # Each patch is compared with as many points as thirty patches have on average, within limits.
    share = 30 * n / len(patches)
    compared = min(int(np.clip(share, 30, 150)), n)
    near = cKDTree(points.places).query(patches["point"], k=compared)[1].reshape(-1, compared)
    offset = points.places[near] - patches["point"][:, None]
    residual = surface.heights(points.places, surface.tree.query(points.places)[1])[near]
    # Points of another face or of the far side say nothing about this one.
    known = np.abs(residual) < 5 * np.sqrt(noise.sigma**2 + height[:, None])
    # The squared mean [m²] and slope [rad²] of the residuals around each patch, less their noise.
    variance = noise.sigma**2 * noise.together
    others = np.maximum(known.sum(axis=1), 1)
    mean = np.where(known, residual, 0.0).sum(axis=1) / others
    by_height = np.maximum(mean**2 - variance / others, 0.0)
    by_slope = np.zeros(len(patches))
    for k in range(2):
        u = np.where(known, np.einsum("mki,mi->mk", offset, patches["along"][:, k]), 0.0)
        square = np.maximum((u * u).sum(axis=1), 1e-300)
        by_slope += ((u * residual).sum(axis=1) / square) ** 2 / 2 - variance / square / 2
    # Residuals beyond the noise are detail of the object that is as fine as the spacing of the points.
    count = np.minimum(np.pi * (patches["window"] / points.spacing) ** 2, NOISE_THINNED)
    # By the window's weights, 5/9 of its points count, and the parameters of a quadric use up 6.
    many = count * (5 / 9) - 6
    # Residuals may exceed the noise by four standard deviations, by chance.
    chance = 1 + 4 * np.sqrt(2 * noise.together / np.maximum(many, 1.0))
    detail = np.maximum(patches["spread"] - (0.0 if noise.is_shape else noise.sigma**2 * chance), 0.0)
    slope = normal + np.maximum(by_slope, 0.0)
    # Such detail is missing in the surface's normals, but adds no bumps and no spurious information.
    missing = 2 * detail / points.spacing**2
    values = height + by_height + detail, slope + missing, CHI2_95 * slope, CHI2_95 * bend
    variances = np.stack(values, axis=1)
    # With the weight itself their mean would be the average error of the surface; but a patch whose windows ended early
    # by chance still bends the surface nearby.
    return Roughness(patches["point"], variances, patches["trust"] ** 0.25)


def unseen_variances(gap: Array, winding: Array, spacing: float) -> Array:
    """Returns variances (n, 4) at places where a scan has no points; they are zero where it has points near by.

    `gap` (n,): distance to the nearest point [m]; `winding` (n,): winding number of the points around the place;
    `spacing` [m] of the points. Where the winding number is near 1 or 0, the place is inside the points or outside
    them, and no surface passes. In between there is a hole, and a surface may pass as far from the place as the nearest
    point is, in any direction.
    """
    # Beyond 0.4 from 0 and from 1 a surface may pass.
    is_open = (np.minimum(winding, 1 - winding) - CLEAR) / (0.4 - CLEAR)
    # Beyond 2.5 spacings the scanner did not see the place.
    is_far = (gap / spacing - COVERED_GAP) / (2.5 - COVERED_GAP)
    share = np.clip(is_open, 0.0, 1.0) * np.clip(is_far, 0.0, 1.0)
    constant = np.tile([1.0, CHI2_95, CHI2_95 / spacing**2], (len(gap), 1))
    return np.asarray(share[:, None] * np.column_stack([gap**2, constant]))


def with_declared_noise(geometry: Geometry, points: Array, sigmas: Array) -> Geometry:
    """Returns the geometry with its errors increased by standard deviations (n,) [m] declared for points (n, 3) [m].

    With the correlation exp(-d²/2L²) the standard deviation of a slope is σ/L, that of a curvature √3 σ/L².
    """
    tree = cKDTree(points)
    variances = sigmas**2

    def at(nodes: Array) -> Array:
        # The declared errors of the eight nearest points are averaged.
        s2 = variances[tree.query(nodes, k=min(8, len(points)))[1]].mean(axis=1)
        slope = s2 / DECLARED_LENGTH**2
        bend = 3 * s2 / DECLARED_LENGTH**4
        return np.stack([s2, slope, CHI2_95 * slope, CHI2_95 * bend], axis=1)

    return with_error(geometry, at)


CLEAN = 5e-4  # noise below which points with normals are used as they are [diameters]
OWN_NOISE = 0.7  # least share of a scan's noise that neighbouring vertices do not have in common


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Surface behind noisy points, and the error of that surface."""

    noise: Noise
    surface: ScannedSurface
    roughness: Roughness


def scanned(points: Array, normals: Array | None, diameter: float) -> Scan | None:
    """Returns the surface behind points (n, 3) [m] with unit outward normals (n, 3) or None.

    Returns None for points that are used as they are: they have normals and hardly any noise, or are too few to measure
    their noise.
    """
    if len(points) < 200:  # too few to separate noise from shape
        return None
    # More add little about an object that fits into a hand.
    order = np.random.default_rng(5).permutation(len(points))[:20_000]
    places = points[order]
    unknown = np.full_like(places, np.nan)
    given = Points(places, unknown if normals is None else normals[order], spacing_of(places), diameter)
    given, noise = estimated_noise(given)
    if normals is not None and (noise.is_shape or noise.sigma < CLEAN * diameter):
        return None
    surface = fitted(given, noise)
    return Scan(noise, surface, roughness_of(surface, given, noise))


def smoothed(mesh: Triangles, diameter: float) -> tuple[Triangles, Roughness | None]:
    """Returns a mesh with its vertices moved onto the surface behind their noise, and the error of that surface. A mesh
    that is no noisy scan is returned as it is, with None."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    if len(used) < 1000:  # it was drawn, not scanned
        return mesh, None
    i, j = mesh.shared
    differences = np.linalg.norm(mesh.normals[i // 3] - mesh.normals[j // 3], axis=1)
    # Noise bends all edges; a mesh with many between triangles in one plane was drawn.
    if not len(differences) or (differences < 1e-3).mean() > 0.1:
        return mesh, None
    vertices = mesh.vertices[used]
    faces = faces.reshape(mesh.faces.shape)
    normals = np.zeros_like(vertices)  # means of the triangles' normals, weighted by area
    for k in range(3):
        np.add.at(normals, faces[:, k], mesh.doubled_normals)
    normals = unit(normals)
    # The noise that vertices do not share with their neighbours, from second differences to these, where the surface is
    # smoothest. Detail as fine as the triangles leaves such residuals of quadrics too, but is smooth between vertices.
    start = faces.reshape(-1)
    end = np.roll(faces, -1, axis=1).reshape(-1)
    count = len(vertices)
    both = np.r_[start, end], np.r_[end, start]
    adjacent = coo_array((np.ones(2 * len(start)), both), (count, count)).tocsr()
    adjacent.data[:] = 1.0
    difference = diags_array(np.ones(count)) - diags_array(1 / adjacent.sum(axis=1)) @ adjacent
    twice = (difference @ difference).tocsr()
    residual = np.abs(((twice @ vertices) * normals).sum(axis=1)) / np.sqrt(twice.multiply(twice).sum(axis=1))
    # A quarter of a Gaussian's draws are within that many standard deviations.
    own = float(np.quantile(residual, NOISE_SMOOTHEST) / 0.3186)
    scan = scanned(vertices, normals, diameter) if own > OWN_NOISE * CLEAN * diameter else None
    if scan is None or own < OWN_NOISE * scan.noise.sigma:
        return mesh, None
    there = scan.surface.blended(vertices, scan.surface.tree.query(vertices)[1])
    way = unit(there[:, 1:])
    off = there[:, :1]
    # A vertex farther from the surface is no noise: it is at a corner that no quadric reaches, and stays where it is.
    vertices = np.where(np.abs(off) < 5.0 * scan.noise.sigma, vertices - off * way, vertices)
    return Triangles(vertices, faces), scan.roughness
