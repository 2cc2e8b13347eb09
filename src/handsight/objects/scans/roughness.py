"""How far a scanned surface is off the object it was scanned from, place by place."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.posterior.spurious_information import LEND
from handsight.checks import Array
from handsight.objects.geometry import Roughness
from handsight.objects.scans.patches import ScannedSurface
from handsight.objects.scans.windows import WINDOWS, Noise, Points


class RoughnessOptions(NamedTuple):
    """`RoughnessOptions` say how far a scan's surface is off, place by place."""

    shared: float = 0.25
    """The power of its weight in the surface that a patch's variances count by. By the first they would be what the
    surface is off by on the average; but a patch that ended early by chance still bends it, where it is.
    """
    chance: float = 4.0  # deviations by which residuals may exceed the noise
    effective: float = 5 / 9  # points of a window that count, for its weights
    fitted: int = 6  # and how many of them a quadric takes
    per_patch: int = 30  # each place is compared with this many points for a patch
    min_points: int = 30  # and with so many at least
    max_points: int = 150  # and at most


ROUGHNESS = RoughnessOptions()


def roughness_of(surface: ScannedSurface, points: Points, noise: Noise) -> Roughness:
    """Returns the variances of distance, normal, slope and curvature at each patch, as a contact meets them.

    What the points scatter tells how far the fits are off by chance; what many points near by are off by on the
    average, more than chance explains, tells where a window was too wide for the shape.
    """
    height, normal, bend = surface.variances.T
    by_height, by_slope = _oversmoothed(surface, points, noise)
    slope, detail = normal + by_slope, _unresolved(surface, points, noise)
    # Detail that the surface has not is missing in its normals; it has no bumps from it to lend.
    missing = 2 * detail / points.spacing**2
    variances = np.stack([height + by_height + detail, slope + missing, LEND * slope, LEND * bend], axis=1)
    return Roughness(surface.patches["point"], variances, surface.patches["trust"] ** ROUGHNESS.shared)


def _oversmoothed(surface: ScannedSurface, points: Points, noise: Noise) -> tuple[Array, Array]:
    """Returns (m,) squared mean [m²] and slope [rad²] of the points' residuals around each patch, less their noise."""
    count = int(
        np.clip(
            ROUGHNESS.per_patch * len(points.places) / len(surface.patches),
            ROUGHNESS.min_points,
            ROUGHNESS.max_points,
        )
    )
    count = min(count, len(points.places))
    centres = surface.patches["point"]
    near = cKDTree(points.places).query(centres, k=count)[1].reshape(-1, count)
    offset = points.places[near] - centres[:, None]
    residual = surface.heights(points.places, surface.tree.query(points.places)[1])[near]
    variance = noise.sigma**2 * noise.together
    # Points of another face or of the far side tell nothing of this one.
    known = np.abs(residual) < 5 * np.sqrt(noise.sigma**2 + surface.variances[:, :1])
    many = np.maximum(known.sum(axis=1), 1)
    mean = np.where(known, residual, 0.0).sum(axis=1) / many
    slopes = np.zeros(len(near))
    for along in (surface.patches["along"][:, 0], surface.patches["along"][:, 1]):
        u = np.where(known, np.einsum("mki,mi->mk", offset, along), 0.0)
        square = np.maximum((u * u).sum(axis=1), 1e-300)
        slopes += ((u * residual).sum(axis=1) / square) ** 2 / 2 - variance / square / 2
    return np.maximum(mean**2 - variance / many, 0.0), np.maximum(slopes, 0.0)


def _unresolved(surface: ScannedSurface, points: Points, noise: Noise) -> Array:
    """Returns (m,) squared height [m²] of what each patch leaves of the points, beyond their noise: detail as fine as
    these are apart, which from one to the next is off independently."""
    patches = surface.patches
    many = (
        np.minimum(np.pi * (patches["window"] / points.spacing) ** 2, WINDOWS.thinned) * ROUGHNESS.effective
        - ROUGHNESS.fitted
    )
    chance = 1 + ROUGHNESS.chance * np.sqrt(2 * noise.together / np.maximum(many, 1.0))
    known = 0.0 if noise.is_shape else noise.sigma**2 * chance
    return np.asarray(np.maximum(patches["spread"] - known, 0.0))
