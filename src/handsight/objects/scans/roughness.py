"""The error of a scanned model as a function of place: from the scan's noise, from its holes, or declared by its file.

Each function returns variances (m, 4) as in `FieldError`: of the distance, of the normal, and of slope and curvature,
from which follows the spurious information that noise adds about a flat direction.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.posterior.spurious_information import CHI2_95
from handsight.checks import Array
from handsight.objects.geometry import Geometry, Roughness, with_error
from handsight.objects.scans.noise import NOISE, Noise, Points
from handsight.objects.scans.patches import ScannedSurface


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
