"""The noise of a scan, read from its points: what quadrics leave of them in windows that widen."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from handsight._kernels.mesh import quadrics as kernel
from handsight._kernels.mesh.patches import PATCH, neighbours
from handsight._kernels.runtime.threads import in_parts
from handsight.checks import Array
from handsight.objects.scans.normals import enough_neighbours, planes

Patches = NDArray[np.void]
"""(m,) quadrics about points, PATCH records."""


class NoiseOptions(NamedTuple):
    """`NoiseOptions` say how a scan's noise is separated from its shape, by windows of growing size."""

    thinned: int = 300  # points to about which a window is thinned: more add little
    neighbours: int = 8  # points by which the spacing is measured
    sampled: int = 2000  # points at which it is
    max_windows: int = 20  # sizes of windows
    serial: int = 64  # patches that are not enough for another thread
    centres: int = 1000  # windows' centres
    first: float = 3.2  # the least window [spacings]
    ratio: float = 1.4  # how much wider each is than the one before
    last: float = 0.32  # the widest [diameters]
    smoothest: float = 0.25  # share of the surface that shows the noise: its smoothest
    noise_power: float = 0.6  # residuals that grow by less than this power of the window are noise
    shape_power: float = 1.5  # residuals that grow by more are of shape
    chance: float = 0.9  # the smoothest quarter of windows is by chance this much smoother than the noise is
    start_points: int = 30  # points through which a first plane is laid
    min_width: float = 4.0  # of a window, in deviations of the noise
    near: float = 1.5  # points closer than this show whether noise is shared [spacings]
    independent: float = 0.15  # a correlation below this is none
    max_together: float = 25.0  # points that share one noise


NOISE = NoiseOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """`Points` are noisy points of a surface in a random order, with their normals where these are known."""

    places: Array
    """(n, 3) [m]."""
    normals: Array
    """(n, 3) unit, outward; NaN where they are not known."""
    spacing: float
    """Between neighbours [m]."""
    diameter: float
    """Of the object [m]."""


@dataclass(frozen=True, slots=True)
class Noise:
    """A `Noise` is the error of a scan's points along the surface's normal."""

    sigma: float
    """One standard deviation [m]."""
    together: float = 1.0
    """How many neighbouring points share it: 1 where each has its own."""
    is_shape: bool = False
    """Whether `sigma` is what the object's shape leaves, in which case the noise is smaller."""


def measured_noise(points: Points) -> tuple[Points, Noise]:
    """Returns the points with the spacing that they have along the surface, and their noise.

    Points whose noise is larger than their spacing seem sparser than they are, and in small windows there is no
    surface. Both are then measured again, in windows wide enough for the noise.
    """
    noise = noise_of(points, 0.0)
    if NOISE.min_width * noise.sigma > points.spacing:
        points = replace(points, spacing=spacing_of(points.places, NOISE.min_width * noise.sigma))
        noise = noise_of(points, noise.sigma)
    return points, noise


def noise_of(points: Points, thickness: float) -> Noise:
    """Returns the noise of points that are off by about `thickness` [m], from the residuals of quadrics in windows.

    White noise leaves the same residual in a window of any width. A residual that grows with the square of the width or
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
    return Noise(float(quiet[level]) / NOISE.chance, _sharing_points(points, calm, float(windows[level])))


def _sharing_points(points: Points, patches: Patches, window: float) -> float:
    """Returns how many points share one noise, from residuals about patches in windows of that radius [m].

    That number is the integral of the noise's correlation over a plane, exp(-d²/2L²) of the distance d.
    """
    pairs = cKDTree(points.places).query_pairs(NOISE.near * points.spacing, output_type="ndarray")
    sums = np.zeros(4)
    neighbours(points.places, pairs, patches, window, sums)
    products, squares, distances, count = sums
    correlation = products / max(squares, 1e-300)
    if not correlation > NOISE.independent:
        return 1.0
    length2 = (distances / count) ** 2 / max(-2 * np.log(correlation), 1e-9)
    return float(min(1 + 2 * np.pi * length2 / points.spacing**2, NOISE.max_together))


def spacing_of(places: Array, least: float = 0.0) -> float:
    """Returns about how far points (n, 3) in a random order are from their neighbours [m], along their surface.

    It is measured on so few of the points that these are at least `least` [m] apart, because the distances of points
    that are closer than their noise is thick are not along the surface.
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
    least = np.abs(normals).argmin(axis=1)
    a = np.cross(normals, np.eye(3)[least])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    patches["along"][:, 0], patches["along"][:, 1] = a, np.cross(normals, a)
    return patches


def widths(least: float, most: float, ratio: float) -> Array:
    """Returns radii of windows [m] from the least to the most, each by `ratio` larger than the one before."""
    count = int(np.log(max(most / least, 1.0)) / np.log(ratio)) + 1
    return np.asarray(least * ratio ** np.arange(max(count - NOISE.max_windows, 0), count))


def widened(points: Points, patches: Patches, windows: Array, **level: Any) -> Array:
    """Fits the patches in place in one window (k,) [m] after another; returns the values of each fit
    (m, k, WINDOW_VALUES).

    `level`: fields of the kernel's LEVEL record, such as the `variance` of the noise.
    """
    fitted = np.full((len(patches), len(windows), kernel.WINDOW_VALUES), np.nan)
    for place, window in enumerate(windows):
        given = np.zeros(1, dtype=kernel.LEVEL)
        for name, value in {**level, "window": window, "place": place}.items():
            given[name] = value
        # As many of the points as a window needs, in the order of cells as wide as it.
        share = NOISE.thinned / (np.pi * (window / points.spacing) ** 2)
        count = max(int(min(share, 1.0) * len(points.places)), min(len(points.places), NOISE.thinned))
        places = points.places[:count]
        low = np.minimum(places.min(axis=0), patches["point"].min(axis=0))
        high = np.maximum(places.max(axis=0), patches["point"].max(axis=0))
        # A ring of empty cells around: no row of them runs into the next.
        given["origin"], given["shape"] = low - 2 * window, np.ceil((high - low) / window) + 5
        cell = ((places - given["origin"]) / window).astype(np.int64)
        keys = np.ravel_multi_index(tuple(cell.T), tuple(given["shape"][0]))
        order = np.argsort(keys, kind="stable")
        cloud = np.hstack([places, points.normals[:count]])[order]
        in_parts(partial(kernel.widen, cloud, keys[order], given), (patches, fitted), NOISE.serial)
    return fitted
