"""The surface behind a noisy scan, the tests by which a cloud or a mesh is recognised as one, and the surface's error.

The error is a function of place: from the scan's noise, from its holes, or declared by its file. It is variances (m, 4)
as in `FieldError`: of the distance, of the normal, and of slope and curvature, from which follows the spurious
information that noise adds about a flat direction.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.spatial import cKDTree

from handsight._kernels.posterior.spurious_information import CHI2_95
from handsight.checks import Array
from handsight.objects.geometry import Geometry, Roughness, with_error
from handsight.objects.scans.patches import (
    NOISE,
    Noise,
    Points,
    ScannedSurface,
    estimated_noise,
    fitted,
    spacing_of,
)
from handsight.objects.surface import Triangles


class RoughnessOptions(NamedTuple):
    """`RoughnessOptions` say how the error of a scanned model is computed."""

    shared: float = 0.25
    """A patch's variances are weighted by its weight in the surface to this power. With the power 1 their mean would be
    the average error of the surface; but a patch whose windows ended early by chance still bends the surface nearby.
    """
    chance: float = 4.0  # standard deviations by which residuals may exceed the noise by chance
    effective: float = 5 / 9  # share of a window's points that count, by the window's weights
    fitted: int = 6  # points that the parameters of a quadric use up
    per_patch: int = 30  # each patch is compared with as many points as this many patches have on average,
    min_points: int = 30  # with at least so many
    max_points: int = 150  # and with at most so many
    covered_gap: float = 1.5  # distance to the nearest point up to which the scanner saw a place [spacings]
    open_gap: float = 2.5  # distance to the nearest point beyond which it did not [spacings]
    clear: float = 0.2  # distance of the winding number from 0 and from 1 up to which no surface can pass
    open: float = 0.4  # distance of the winding number from 0 and from 1 beyond which a surface may pass
    declared_length: float = 0.05
    """Correlation length of declared errors [m]: fused depth images, and guessed surfaces, have errors in common over
    centimetres, by the camera's constant error, which the points themselves do not show."""
    declared_points: int = 8  # nearest points whose declared errors are averaged


ROUGHNESS = RoughnessOptions()


def roughness_of(surface: ScannedSurface, points: Points, noise: Noise) -> Roughness:
    """Returns the variances of distance, normal, slope and curvature that a contact meets at each patch.

    The scatter of the points gives the random error of the fits. Where the mean of many residuals is larger than chance
    explains, a window was too large for the shape, and that mean is added.
    """
    height, normal, bend = surface.variances.T
    patches, n = surface.patches, len(points.places)
    share = ROUGHNESS.per_patch * n / len(patches)
    compared = min(int(np.clip(share, ROUGHNESS.min_points, ROUGHNESS.max_points)), n)
    near = cKDTree(points.places).query(patches["point"], k=compared)[1].reshape(-1, compared)
    offset = points.places[near] - patches["point"][:, None]
    residual = surface.heights(points.places, surface.tree.query(points.places)[1])[near]
    # Points of another face or of the far side say nothing about this one.
    known = np.abs(residual) < 5 * np.sqrt(noise.sigma**2 + height[:, None])
    # The squared mean [m²] and slope [rad²] of the residuals around each patch, less their noise.
    variance, others = noise.sigma**2 * noise.together, np.maximum(known.sum(axis=1), 1)
    mean = np.where(known, residual, 0.0).sum(axis=1) / others
    by_height, by_slope = np.maximum(mean**2 - variance / others, 0.0), np.zeros(len(patches))
    for k in range(2):
        u = np.where(known, np.einsum("mki,mi->mk", offset, patches["along"][:, k]), 0.0)
        square = np.maximum((u * u).sum(axis=1), 1e-300)
        by_slope += ((u * residual).sum(axis=1) / square) ** 2 / 2 - variance / square / 2
    # Residuals beyond the noise are detail of the object that is as fine as the spacing of the points.
    count = np.minimum(np.pi * (patches["window"] / points.spacing) ** 2, NOISE.thinned)
    many = count * ROUGHNESS.effective - ROUGHNESS.fitted
    chance = 1 + ROUGHNESS.chance * np.sqrt(2 * noise.together / np.maximum(many, 1.0))
    detail = np.maximum(patches["spread"] - (0.0 if noise.is_shape else noise.sigma**2 * chance), 0.0)
    slope = normal + np.maximum(by_slope, 0.0)
    # Such detail is missing in the surface's normals, but adds no bumps and no spurious information.
    missing = 2 * detail / points.spacing**2
    values = height + by_height + detail, slope + missing, CHI2_95 * slope, CHI2_95 * bend
    variances = np.stack(values, axis=1)
    return Roughness(patches["point"], variances, patches["trust"] ** ROUGHNESS.shared)


def unseen_variances(gap: Array, winding: Array, spacing: float) -> Array:
    """Returns variances (n, 4) at places where a scan has no points; they are zero where it has points near by.

    `gap` (n,): distance to the nearest point [m]; `winding` (n,): winding number of the points around the place;
    `spacing` [m] of the points. Where the winding number is near 1 or 0, the place is inside the points or outside
    them, and no surface passes. In between there is a hole, and a surface may pass as far from the place as the nearest
    point is, in any direction.
    """
    is_open = (np.minimum(winding, 1 - winding) - ROUGHNESS.clear) / (ROUGHNESS.open - ROUGHNESS.clear)
    is_far = (gap / spacing - ROUGHNESS.covered_gap) / (ROUGHNESS.open_gap - ROUGHNESS.covered_gap)
    share = np.clip(is_open, 0.0, 1.0) * np.clip(is_far, 0.0, 1.0)
    constant = np.tile([1.0, CHI2_95, CHI2_95 / spacing**2], (len(gap), 1))
    return np.asarray(share[:, None] * np.column_stack([gap**2, constant]))


def with_declared_noise(geometry: Geometry, points: Array, sigmas: Array) -> Geometry:
    """Returns the geometry with its errors increased by standard deviations (n,) [m] declared for points (n, 3) [m].

    With the correlation exp(-d²/2L²) the standard deviation of a slope is σ/L, that of a curvature √3 σ/L².
    """
    tree, variances = cKDTree(points), sigmas**2

    def at(nodes: Array) -> Array:
        s2 = variances[tree.query(nodes, k=min(ROUGHNESS.declared_points, len(points)))[1]].mean(axis=1)
        slope, bend = s2 / ROUGHNESS.declared_length**2, 3 * s2 / ROUGHNESS.declared_length**4
        return np.stack([s2, slope, CHI2_95 * slope, CHI2_95 * bend], axis=1)

    return with_error(geometry, at)


CLEAN = 5e-4  # noise below which points with normals are used as they are [diameters]
OWN_NOISE = 0.7  # least share of a scan's noise that neighbouring vertices do not have in common


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
    face_normals = mesh.doubled_normals / np.maximum(2 * mesh.areas, 1e-300)[:, None]
    differences = np.linalg.norm(face_normals[i // 3] - face_normals[j // 3], axis=1)
    # Noise bends all edges; a mesh with many between triangles in one plane was drawn.
    if not len(differences) or (differences < 1e-3).mean() > 0.1:
        return mesh, None
    vertices, faces = mesh.vertices[used], faces.reshape(mesh.faces.shape)
    normals = np.zeros_like(vertices)  # means of the triangles' normals, weighted by area
    for k in range(3):
        np.add.at(normals, faces[:, k], mesh.doubled_normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # The noise that vertices do not share with their neighbours, from second differences to these, where the surface is
    # smoothest. Detail as fine as the triangles leaves such residuals of quadrics too, but is smooth between vertices.
    start, end, count = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1), len(vertices)
    both = np.r_[start, end], np.r_[end, start]
    adjacent = coo_array((np.ones(2 * len(start)), both), (count, count)).tocsr()
    adjacent.data[:] = 1.0
    difference = diags_array(np.ones(count)) - diags_array(1 / adjacent.sum(axis=1)) @ adjacent
    twice = (difference @ difference).tocsr()
    residual = np.abs(((twice @ vertices) * normals).sum(axis=1)) / np.sqrt(twice.multiply(twice).sum(axis=1))
    # A quarter of a Gaussian's draws are within that many standard deviations.
    own = float(np.quantile(residual, NOISE.smoothest) / 0.3186)
    scan = scanned(vertices, normals, diameter) if own > OWN_NOISE * CLEAN * diameter else None
    if scan is None or own < OWN_NOISE * scan.noise.sigma:
        return mesh, None
    there = scan.surface.blended(vertices, scan.surface.tree.query(vertices)[1])
    way = there[:, 1:] / np.linalg.norm(there[:, 1:], axis=1, keepdims=True)
    off = there[:, :1]
    # A vertex farther from the surface is no noise: it is at a corner that no quadric reaches, and stays where it is.
    vertices = np.where(np.abs(off) < 5.0 * scan.noise.sigma, vertices - off * way, vertices)
    return Triangles(vertices, faces), scan.roughness
