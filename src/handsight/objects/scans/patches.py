"""The surface behind noisy points: a blend of quadrics, each fitted in a window as large as the shape allows.

The noise of the points is estimated from the residuals of quadrics in windows of many sizes.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from handsight import se3
from handsight._compiled.threads import in_parts
from handsight.checks import Array, Indices
from handsight.objects.kernels import quadrics as kernel
from handsight.objects.kernels.quadrics import PATCH, blended, neighbours
from handsight.objects.scans.normals import enough_neighbours, outwards, planes
from handsight.objects.surface import unit

Patches = NDArray[np.void]  # (m,) quadrics about points, PATCH records


NOISE_THINNED = 300  # points in a window, to about which it is thinned: more add little
NOISE_NEIGHBOURS = 8  # nearest points from which the spacing is measured
NOISE_RATIO = 1.4  # radius of each window by that of the one before
NOISE_SMOOTHEST = 0.25  # share of the surface that shows the noise: the smoothest
NOISE_NOISE_POWER = 0.6  # residuals that grow with less than this power of the window are noise
NOISE_CHANCE = 0.9  # residuals of the smoothest quarter of windows are by chance this share of the noise
NOISE_MIN_WIDTH = 4  # radius of the smallest window, in standard deviations of the noise


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Noisy points of a surface in a random order, with their normals if these are known."""

    places: Array  # (n, 3) [m]
    normals: Array  # (n, 3) unit, outward; NaN where unknown
    spacing: float  # distance between neighbours [m]
    diameter: float  # diameter of the object [m]


@dataclass(frozen=True, slots=True)
class Noise:
    """Error of a scan's points along the normal of the surface."""

    sigma: float  # one standard deviation [m]
    together: float = 1.0  # number of neighbouring points that share one error; 1 where each has its own
    is_shape: bool = False  # whether `sigma` comes from the object's shape: the noise is smaller


def estimated_noise(points: Points) -> tuple[Points, Noise]:
    """Returns the points with their spacing measured along the surface, and their noise.

    Points whose noise is larger than their spacing seem sparser than they are, and small windows show no surface. In
    that case spacing and noise are measured again, in windows wide enough for the noise.
    """
    noise = noise_of(points, 0.0)
    if NOISE_MIN_WIDTH * noise.sigma > points.spacing:
        points = replace(points, spacing=spacing_of(points.places, NOISE_MIN_WIDTH * noise.sigma))
        noise = noise_of(points, noise.sigma)
    return points, noise


def noise_of(points: Points, thickness: float) -> Noise:
    """Returns the noise of points with errors of about `thickness` [m], from the residuals of quadrics in windows.

    White noise leaves the same residual in windows of any width. A residual that grows with the square of the width or
    faster is shape; one that levels off only in wide windows is noise that neighbours share, as in depth images that
    were fused into one surface.
    """
    # The smallest window has a radius of 3.2 spacings.
    least = max(3.2 * points.spacing, NOISE_MIN_WIDTH * thickness)
    # The largest has one of a third of the diameter.
    windows = widths(least, max(0.32 * points.diameter, 1.01 * NOISE_RATIO * least), NOISE_RATIO)
    centres = points.places[:1000]
    count = enough_neighbours(thickness, points.spacing, 30)
    patches = flat_patches(centres, planes(points.places, centres, count))
    every_point: dict[str, Any] = {"variance": 1.0, "together": 1.0, "bend": np.inf, "free": True}
    # Two windows are enough to recognise white noise; the others are computed where it is not.
    for count in sorted({2, len(windows)}):
        spread = np.sqrt(widened(points, patches.copy(), windows[:count], **every_point)[:, :, -1])
        few = np.flatnonzero(np.isfinite(spread).mean(axis=0) < 0.5)
        spread = spread[:, : few[0] if len(few) else count]
        if spread.shape[1] < 2:
            return Noise(float(np.nan_to_num(np.nanmedian(spread))) if spread.size else 0.0, is_shape=True)
        quiet = np.nanquantile(spread, NOISE_SMOOTHEST, axis=0)
        # The power of the window's width with which residuals grow, from each window to the next.
        floor = 1e-9 * points.diameter
        growth = np.diff(np.log(quiet + floor)) / np.diff(np.log(windows[: len(quiet)]))
        if growth[0] < NOISE_NOISE_POWER:
            return Noise(min(float(np.nanmedian(spread[:, 0])), float(quiet[0]) / NOISE_CHANCE))
    # Residuals that grow with more than the power 1.5 are shape.
    flat = np.flatnonzero(growth < NOISE_NOISE_POWER)
    steep = np.flatnonzero(growth > 1.5)
    if not len(flat) or (len(steep) and steep[0] < flat[0]):
        return Noise(float(quiet[0]), is_shape=True)
    level = int(flat[0])
    calm = patches[spread[:, level] <= quiet[level]]
    widened(points, calm, windows[: level + 1], **every_point)
    # Pairs of neighbours show whether noise is shared.
    pairs = cKDTree(points.places).query_pairs(1.5 * points.spacing, output_type="ndarray")
    sums = np.zeros(4)
    together = 1.0
    neighbours(points.places, pairs, calm, float(windows[level]), sums)
    products, squares, distances, number = sums
    correlation = products / max(squares, 1e-300)
    # Points that share one error: those on the area that is the integral, over a plane, of the correlation exp(-d²/2L²)
    # of the errors of two points at the distance d.
    # Below, noise is not shared.
    if correlation > 0.15:
        length2 = (distances / number) ** 2 / max(-2 * np.log(correlation), 1e-9)
        # At most 25 points share one noise.
        together = float(min(1 + 2 * np.pi * length2 / points.spacing**2, 25))
    return Noise(float(quiet[level]) / NOISE_CHANCE, together)


def spacing_of(places: Array, least: float = 0.0) -> float:
    """Returns the typical distance [m] of points (n, 3), which are in a random order, from their neighbours.

    It is measured on so few of the points that these are at least `least` [m] apart, because the distances between
    points that are closer than the noise is thick are not along the surface.
    """
    share = 1.0
    while True:
        some = places[: max(int(share * len(places)), 4 * NOISE_NEIGHBOURS)]
        # The spacing is measured at 2000 points.
        reach = cKDTree(some).query(some[:2000], k=NOISE_NEIGHBOURS + 1)[0][:, -1]
        # A disc holds its neighbours and half the one on its rim.
        spacing = float(np.sqrt(np.median(np.pi * reach**2) / (NOISE_NEIGHBOURS + 0.5)))
        if spacing >= least or len(some) < 8 * NOISE_NEIGHBOURS:
            return spacing * float(np.sqrt(len(some) / len(places)))
        share /= 2


def flat_patches(places: Array, normals: Array) -> Patches:
    """Returns a flat patch at each place (m, 3) [m], with the normal (m, 3) there."""
    patches = np.zeros(len(places), dtype=PATCH)
    patches["point"] = places
    patches["normal"] = normals
    patches["along"][:, 0] = se3.perpendicular(normals)
    patches["along"][:, 1] = np.cross(normals, patches["along"][:, 0])
    return patches


def widths(least: float, most: float, ratio: float) -> Array:
    """Returns radii of windows from `least` to `most` [m], each `ratio` times the one before."""
    count = int(np.log(max(most / least, 1.0)) / np.log(ratio)) + 1
    # There are at most twenty, the largest ones.
    return np.asarray(least * ratio ** np.arange(max(count - 20, 0), count))


def widened(points: Points, patches: Patches, windows: Array, **level: Any) -> Array:
    """Returns the values of each fit (m, k, WINDOW_VALUES) of patches in one window after another.

    `patches` (m,) are changed in place. `windows` (k,): radii [m]. `level`: fields of the record LEVEL, as `variance`.
    """
    fitted = np.full((len(patches), len(windows), kernel.WINDOW_VALUES), np.nan)
    for place, window in enumerate(windows):
        given = np.zeros(1, dtype=kernel.LEVEL)
        for name, value in {**level, "window": window, "place": place}.items():
            given[name] = value
        # As many of the points as a window needs, in the order of cells that are as wide as the window's radius.
        share = NOISE_THINNED / (np.pi * (window / points.spacing) ** 2)
        count = max(int(min(share, 1.0) * len(points.places)), min(len(points.places), NOISE_THINNED))
        places = points.places[:count]
        low = np.minimum(places.min(axis=0), patches["point"].min(axis=0))
        high = np.maximum(places.max(axis=0), patches["point"].max(axis=0))
        # There is a margin of empty cells all around, so that no row of cells runs into the next.
        given["origin"] = low - 2 * window
        given["shape"] = np.ceil((high - low) / window) + 5
        cell = ((places - given["origin"]) / window).astype(np.int64)
        keys = np.ravel_multi_index(tuple(cell.T), tuple(given["shape"][0]))
        order = np.argsort(keys, kind="stable")
        cloud = np.hstack([places, points.normals[:count]])[order]
        # Fewer patches are not worth another thread's start.
        in_parts(partial(kernel.widen, cloud, keys[order], given), (patches, fitted), 64)
    return fitted


FIT_PATCHES = 4000  # largest number of quadrics
FIT_SIMILAR = 0.05
"""A patch's weight is the inverse of the variance of its normal plus this share of the median variance."""
FIT_MIN_TRUST = 0.02  # least weight of a patch, and the inverse of the largest weight


@dataclass(frozen=True, slots=True, eq=False)
class ScannedSurface:
    """Surface of many quadric patches, each blended into its neighbours."""

    patches: Patches
    tree: cKDTree  # the tree over the patches' points (m, 3)
    around: Indices  # (m, k) indices of the patches nearest to each patch, itself first
    spacing: float  # distance between neighbouring patches [m]

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
        # Fewer nodes are not worth another thread's start.
        in_parts(kernel, (nearest, nodes, out), 4096)
        return out

    def heights(self, nodes: Array, nearest: Indices) -> Array:
        """Returns signed distances (n,) [m] of nodes (n, 3) near the surface; `nearest` (n,) as `blended` takes it."""
        return self.blended(nodes, nearest)[:, 0]

    def converged(self) -> tuple[Array, Array]:
        """Returns the patches' points moved onto the blended surface (m, 3) [m], with unit outward normals (m, 3)."""
        points = self.patches["point"]
        there = self.blended(points, np.arange(len(points)))
        normals = unit(there[:, 1:])
        return points - there[:, :1] * normals, normals


def fitted(points: Points, noise: Noise) -> ScannedSurface:
    """Returns the surface behind noisy points; unknown normals are estimated first."""
    # No scan is assumed to be more exact.
    noise = replace(noise, sigma=max(noise.sigma, 1e-4 * points.diameter))
    if np.isfinite(points.normals).all():
        patches = _fits(points, points.normals[:FIT_PATCHES], noise)
    else:
        centres = points.places[:FIT_PATCHES]
        tree = cKDTree(centres)
        count = enough_neighbours(noise.sigma, points.spacing)
        normals = outwards(centres, planes(points.places, centres, count), tree)
        nearest = tree.query(points.places)[1]
        # Quadrics separate faces better than planes do, so signs are decided once more with the quadrics' normals.
        # Three sizes of windows are enough to separate the faces of an object.
        patches = _fits(replace(points, normals=normals[nearest]), normals, noise, 3)
        normals = patches["normal"].copy()
        # Only then are patches exact enough for `turning`.
        if noise.sigma < 0.5 * points.spacing:
            normals = outwards(patches["point"], normals, cKDTree(patches["point"]), turning=True)
        patches = _fits(replace(points, normals=normals[nearest]), normals, noise)
    variance = patches["covariance"][:, 1, 1] + patches["covariance"][:, 2, 2]
    typical = np.median(variance)
    trust = (1 + FIT_SIMILAR) * typical / (variance + FIT_SIMILAR * typical)
    patches["trust"] = np.clip(trust, FIT_MIN_TRUST, 1 / FIT_MIN_TRUST)
    tree = cKDTree(patches["point"])
    # At a place, the 24 nearest patches are averaged.
    around = tree.query(patches["point"], k=min(24, len(patches)))[1]
    return ScannedSurface(patches, tree, around, spacing_of(patches["point"]))


def _fits(points: Points, normals: Array, noise: Noise, most: int | None = None) -> Patches:
    """Returns patches about the first m points, whose normals (m, 3) are given, fitted in at most `most` windows."""
    patches = flat_patches(points.places[: len(normals)], normals)
    # The smallest window grows with the points that share one error, up to three times as wide.
    shared = min(noise.together, 9)
    least = max(
        3 * points.spacing * np.sqrt(shared),
        3 * noise.sigma,
        # Its normal is then known to a tenth.
        5 * np.sqrt(noise.sigma * points.spacing),
    )
    level = {
        "variance": noise.sigma**2,
        "together": noise.together,
        # The residual that the shape may add to the noise in a quadric.
        "tolerance": (2e-4 * points.diameter) ** 2,
        # The standard deviation of curvatures before any measurement.
        "bend": 8 / points.diameter,
    }
    # The largest window has a radius of 0.3 diameters, and each has 1.35 times that of the one before.
    windows = widths(least, max(0.3 * points.diameter, least), 1.35)
    widened(points, patches, windows[:most], **level)
    alone = patches["fits"] == 0
    unknown = np.repeat([noise.sigma**2 * noise.together, 1.0, level["bend"] ** 2], (1, 2, 3))
    patches["covariance"][alone] = np.diag(unknown)
    return patches
