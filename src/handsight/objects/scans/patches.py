"""The surface behind noisy points: a blend of quadrics, each fitted in a window as large as the shape allows.

The noise of the points is estimated from the residuals of quadrics in windows of many sizes.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from handsight import se3
from handsight._kernels.mesh import quadrics as kernel
from handsight._kernels.mesh.quadrics import PATCH, blended, neighbours
from handsight._kernels.runtime.threads import in_parts
from handsight.checks import Array, Indices
from handsight.objects.scans.normals import enough_neighbours, outwards, planes

Patches = NDArray[np.void]  # (m,) quadrics about points, PATCH records


class NoiseOptions(NamedTuple):
    """`NoiseOptions` say how a scan's noise is separated from its shape, by windows of growing size."""

    thinned: int = 300  # points in a window, to about which it is thinned: more add little
    neighbours: int = 8  # nearest points from which the spacing is measured
    sampled: int = 2000  # points at which the spacing is measured
    max_windows: int = 20  # sizes of windows
    serial: int = 64  # patches up to which another thread is not worth its start
    centres: int = 1000  # windows of each size
    first: float = 3.2  # radius of the smallest window [spacings]
    ratio: float = 1.4  # radius of each window by that of the one before
    last: float = 0.32  # radius of the largest window [diameters]
    smoothest: float = 0.25  # share of the surface that shows the noise: the smoothest
    noise_power: float = 0.6  # residuals that grow with less than this power of the window are noise
    shape_power: float = 1.5  # residuals that grow with more than this power are shape
    chance: float = 0.9  # residuals of the smoothest quarter of windows are by chance this share of the noise
    start_points: int = 30  # points of the first plane in a window
    min_width: float = 4.0  # radius of the smallest window, in standard deviations of the noise
    near: float = 1.5  # distance of pairs of points that show whether noise is shared [spacings]
    independent: float = 0.15  # correlation below which noise is not shared
    max_together: float = 25.0  # largest number of points that share one noise


NOISE = NoiseOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """`Points` are noisy points of a surface in a random order, with their normals if these are known."""

    places: Array  # (n, 3) [m]
    normals: Array  # (n, 3) unit, outward; NaN where unknown
    spacing: float  # distance between neighbours [m]
    diameter: float  # diameter of the object [m]


@dataclass(frozen=True, slots=True)
class Noise:
    """A `Noise` is the error of a scan's points along the normal of the surface."""

    sigma: float  # one standard deviation [m]
    together: float = 1.0  # number of neighbouring points that share one error; 1 where each has its own
    is_shape: bool = False  # whether `sigma` comes from the object's shape: the noise is smaller


def estimated_noise(points: Points) -> tuple[Points, Noise]:
    """Returns the points with their spacing measured along the surface, and their noise.

    Points whose noise is larger than their spacing seem sparser than they are, and small windows show no surface. In
    that case spacing and noise are measured again, in windows wide enough for the noise.
    """
    noise = noise_of(points, 0.0)
    if NOISE.min_width * noise.sigma > points.spacing:
        points = replace(points, spacing=spacing_of(points.places, NOISE.min_width * noise.sigma))
        noise = noise_of(points, noise.sigma)
    return points, noise


def noise_of(points: Points, thickness: float) -> Noise:
    """Returns the noise of points with errors of about `thickness` [m], from the residuals of quadrics in windows.

    White noise leaves the same residual in windows of any width. A residual that grows with the square of the width or
    faster is shape; one that levels off only in wide windows is noise that neighbours share, as in depth images that
    were fused into one surface.
    """
    least = max(NOISE.first * points.spacing, NOISE.min_width * thickness)
    windows = widths(least, max(NOISE.last * points.diameter, 1.01 * NOISE.ratio * least), NOISE.ratio)
    centres = points.places[: NOISE.centres]
    count = enough_neighbours(thickness, points.spacing, NOISE.start_points)
    patches = flat_patches(centres, planes(points.places, centres, count))
    every_point: dict[str, Any] = {"variance": 1.0, "together": 1.0, "bend": np.inf, "free": True}
    # Two windows are enough to recognise white noise; the others are computed where it is not.
    for count in sorted({2, len(windows)}):
        spread = np.sqrt(widened(points, patches.copy(), windows[:count], **every_point)[:, :, -1])
        few = np.flatnonzero(np.isfinite(spread).mean(axis=0) < 0.5)
        spread = spread[:, : few[0] if len(few) else count]
        if spread.shape[1] < 2:
            return Noise(float(np.nan_to_num(np.nanmedian(spread))) if spread.size else 0.0, is_shape=True)
        quiet = np.nanquantile(spread, NOISE.smoothest, axis=0)
        # The power of the window's width with which residuals grow, from each window to the next.
        floor = 1e-9 * points.diameter
        growth = np.diff(np.log(quiet + floor)) / np.diff(np.log(windows[: len(quiet)]))
        if growth[0] < NOISE.noise_power:
            return Noise(min(float(np.nanmedian(spread[:, 0])), float(quiet[0]) / NOISE.chance))
    flat, steep = np.flatnonzero(growth < NOISE.noise_power), np.flatnonzero(growth > NOISE.shape_power)
    if not len(flat) or (len(steep) and steep[0] < flat[0]):
        return Noise(float(quiet[0]), is_shape=True)
    level = int(flat[0])
    calm = patches[spread[:, level] <= quiet[level]]
    widened(points, calm, windows[: level + 1], **every_point)
    pairs = cKDTree(points.places).query_pairs(NOISE.near * points.spacing, output_type="ndarray")
    sums, together = np.zeros(4), 1.0
    neighbours(points.places, pairs, calm, float(windows[level]), sums)
    products, squares, distances, number = sums
    correlation = products / max(squares, 1e-300)
    # Points that share one error: those on the area that is the integral, over a plane, of the correlation exp(-d²/2L²)
    # of the errors of two points at the distance d.
    if correlation > NOISE.independent:
        length2 = (distances / number) ** 2 / max(-2 * np.log(correlation), 1e-9)
        together = float(min(1 + 2 * np.pi * length2 / points.spacing**2, NOISE.max_together))
    return Noise(float(quiet[level]) / NOISE.chance, together)


def spacing_of(places: Array, least: float = 0.0) -> float:
    """Returns the typical distance [m] of points (n, 3), which are in a random order, from their neighbours.

    It is measured on so few of the points that these are at least `least` [m] apart, because the distances between
    points that are closer than the noise is thick are not along the surface.
    """
    share = 1.0
    while True:
        some = places[: max(int(share * len(places)), 4 * NOISE.neighbours)]
        reach = cKDTree(some).query(some[: NOISE.sampled], k=NOISE.neighbours + 1)[0][:, -1]
        # A disc holds its neighbours and half the one on its rim.
        spacing = float(np.sqrt(np.median(np.pi * reach**2) / (NOISE.neighbours + 0.5)))
        if spacing >= least or len(some) < 8 * NOISE.neighbours:
            return spacing * float(np.sqrt(len(some) / len(places)))
        share /= 2


def flat_patches(places: Array, normals: Array) -> Patches:
    """Returns a flat patch at each place (m, 3) [m], with the normal (m, 3) there."""
    patches = np.zeros(len(places), dtype=PATCH)
    patches["point"], patches["normal"] = places, normals
    patches["along"][:, 0] = se3.perpendicular(normals)
    patches["along"][:, 1] = np.cross(normals, patches["along"][:, 0])
    return patches


def widths(least: float, most: float, ratio: float) -> Array:
    """Returns radii of windows from `least` to `most` [m], each `ratio` times the one before."""
    count = int(np.log(max(most / least, 1.0)) / np.log(ratio)) + 1
    return np.asarray(least * ratio ** np.arange(max(count - NOISE.max_windows, 0), count))


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
        share = NOISE.thinned / (np.pi * (window / points.spacing) ** 2)
        count = max(int(min(share, 1.0) * len(points.places)), min(len(points.places), NOISE.thinned))
        places = points.places[:count]
        low = np.minimum(places.min(axis=0), patches["point"].min(axis=0))
        high = np.maximum(places.max(axis=0), patches["point"].max(axis=0))
        # There is a margin of empty cells all around, so that no row of cells runs into the next.
        given["origin"], given["shape"] = low - 2 * window, np.ceil((high - low) / window) + 5
        cell = ((places - given["origin"]) / window).astype(np.int64)
        keys = np.ravel_multi_index(tuple(cell.T), tuple(given["shape"][0]))
        order = np.argsort(keys, kind="stable")
        cloud = np.hstack([places, points.normals[:count]])[order]
        in_parts(partial(kernel.widen, cloud, keys[order], given), (patches, fitted), NOISE.serial)
    return fitted


class PatchOptions(NamedTuple):
    """`PatchOptions` say how quadrics are fitted to a scan in windows whose size the data choose (Lepski 1991)."""

    patches: int = 4000  # largest number of quadrics
    first: float = 3.0  # radius of the smallest window [spacings]
    ratio: float = 1.35  # radius of each window by that of the one before
    last: float = 0.3  # radius of the largest window [diameters]
    max_widened: float = 9.0  # most by which the smallest window grows with the points that share one error
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
