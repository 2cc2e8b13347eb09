"""The surface behind noisy points: a blend of quadrics, each fitted in a window as large as the shape allows."""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.mesh.patches import blended
from handsight._kernels.runtime.threads import in_parts
from handsight.checks import Array, Indices
from handsight.objects.scans.noise import Noise, Patches, Points, flat_patches, spacing_of, widened, widths
from handsight.objects.scans.normals import enough_neighbours, outwards, planes


class PatchOptions(NamedTuple):
    """`PatchOptions` say how quadrics are fitted to a scan in windows whose size the data choose (Lepski 1991)."""

    patches: int = 4000  # largest number of quadrics
    first: float = 3.0  # radius of the smallest window [spacings]
    ratio: float = 1.35  # radius of each window by that of the one before
    last: float = 0.3  # radius of the largest window [diameters]
    max_widened: float = 9.0
    """The smallest window grows with the number of points that share one error, up to this number."""
    min_width: float = 3.0  # radius of the smallest window, in standard deviations of the noise
    min_lever: float = 5.0
    """Radius of the smallest window by the geometric mean of noise and spacing; its normal is then known to a tenth."""
    shape_error: float = 2e-4  # residual that the shape may add to the noise in a quadric [diameters]
    sigma_curvature: float = 8.0  # standard deviation of curvatures before any measurement [1/diameters]
    min_sigma: float = 1e-4  # least noise that is assumed for a scan [diameters]
    rough_windows: int = 3  # sizes of windows that are enough to separate the faces of an object
    min_noise: float = 0.5  # noise below which patches are exact enough for `outwards(turning)` [spacings]
    parallel: int = 4096  # nodes from which on another thread is worth its start
    blended: int = 24  # nearest patches that are averaged at a place
    similar: float = 0.05
    """A patch's weight is the inverse of the variance of its normal plus this share of the median variance."""
    min_trust: float = 0.02  # least weight of a patch, and the inverse of the largest weight


PATCH_FIT = PatchOptions()


@dataclass(frozen=True, slots=True, eq=False)
class ScannedSurface:
    """A `ScannedSurface` is a surface of many quadric patches, each blended into its neighbours."""

    patches: Patches
    tree: cKDTree
    """The tree over the patches' points (m, 3)."""
    around: Indices
    """(m, k) indices of the patches nearest to each patch, itself first."""
    spacing: float
    """Distance between neighbouring patches [m]."""

    @property
    def variances(self) -> Array:
        """(m, 3) variances of each patch: of the distance [m²], the normal per axis [rad²], the curvature [1/m²]."""
        v = self.patches["covariance"].diagonal(axis1=1, axis2=2)
        return np.stack([v[:, 0], (v[:, 1] + v[:, 2]) / 2, (v[:, 3] + v[:, 5]) / 2], axis=1)

    def blended(self, nodes: Array, nearest: Indices) -> Array:
        """Returns (n, 4): signed distances [m] of nodes (n, 3) near the surface, and vectors outwards of any length.
        `nearest` (n,): index of the patch nearest to each node."""
        out = np.empty((len(nodes), 4))
        kernel = partial(blended, self.patches, self.spacing, self.around)
        in_parts(kernel, (nearest, nodes, out), PATCH_FIT.parallel)
        return out

    def heights(self, nodes: Array, nearest: Indices) -> Array:
        """Returns signed distances (n,) [m] of nodes (n, 3) near the surface; `nearest` (n,) as `blended` takes it."""
        return np.asarray(self.blended(nodes, nearest)[:, 0])

    def converged(self) -> tuple[Array, Array]:
        """Returns the patches' points moved onto the blended surface (m, 3) [m], with unit outward normals (m, 3)."""
        points = self.patches["point"]
        there = self.blended(points, np.arange(len(points)))
        normals = there[:, 1:] / np.linalg.norm(there[:, 1:], axis=1, keepdims=True)
        return points - there[:, :1] * normals, normals


def fitted(points: Points, noise: Noise) -> ScannedSurface:
    """Returns the surface behind noisy points; unknown normals are estimated first."""
    noise = replace(noise, sigma=max(noise.sigma, PATCH_FIT.min_sigma * points.diameter))
    if np.isfinite(points.normals).all():
        patches = _fits(points, points.normals[: PATCH_FIT.patches], noise)
    else:
        centres = points.places[: PATCH_FIT.patches]
        tree = cKDTree(centres)
        count = enough_neighbours(noise.sigma, points.spacing)
        normals = outwards(centres, planes(points.places, centres, count), tree)
        nearest = tree.query(points.places)[1]
        # Quadrics separate faces better than planes do, so signs are decided once more with the quadrics' normals.
        patches = _fits(replace(points, normals=normals[nearest]), normals, noise, PATCH_FIT.rough_windows)
        normals = patches["normal"].copy()
        if noise.sigma < PATCH_FIT.min_noise * points.spacing:
            normals = outwards(patches["point"], normals, cKDTree(patches["point"]), turning=True)
        patches = _fits(replace(points, normals=normals[nearest]), normals, noise)
    variance = patches["covariance"][:, 1, 1] + patches["covariance"][:, 2, 2]
    typical = np.median(variance)
    trust = (1 + PATCH_FIT.similar) * typical / (variance + PATCH_FIT.similar * typical)
    patches["trust"] = np.clip(trust, PATCH_FIT.min_trust, 1 / PATCH_FIT.min_trust)
    tree = cKDTree(patches["point"])
    around = tree.query(patches["point"], k=min(PATCH_FIT.blended, len(patches)))[1]
    return ScannedSurface(patches, tree, around, spacing_of(patches["point"]))


def _fits(points: Points, normals: Array, noise: Noise, most: int | None = None) -> Patches:
    """Returns patches about the first m points, whose normals (m, 3) are given, fitted in at most `most` windows."""
    patches = flat_patches(points.places[: len(normals)], normals)
    shared = min(noise.together, PATCH_FIT.max_widened)
    least = max(
        PATCH_FIT.first * points.spacing * np.sqrt(shared),
        PATCH_FIT.min_width * noise.sigma,
        PATCH_FIT.min_lever * np.sqrt(noise.sigma * points.spacing),
    )
    level = {
        "variance": noise.sigma**2,
        "together": noise.together,
        "tolerance": (PATCH_FIT.shape_error * points.diameter) ** 2,
        "bend": PATCH_FIT.sigma_curvature / points.diameter,
    }
    windows = widths(least, max(PATCH_FIT.last * points.diameter, least), PATCH_FIT.ratio)
    widened(points, patches, windows[:most], **level)
    alone = patches["fits"] == 0
    unknown = np.repeat([noise.sigma**2 * noise.together, 1.0, level["bend"] ** 2], (1, 2, 3))
    patches["covariance"][alone] = np.diag(unknown)
    return patches
