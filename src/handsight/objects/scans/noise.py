"""What a cloud's points are off by, read from the cloud itself."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.mesh.patches import neighbours
from handsight.checks import Array
from handsight.objects.scans.normals import enough_neighbours, planes
from handsight.objects.scans.windows import Noise, Patches, Points, spacing_of, started, widened, widths

CENTRES = 1000
FIRST, RATIO, LAST = 3.2, 1.4, 0.32
"""Windows: the least [spacings], how much wider each is, and the widest [diameters]."""
QUIET = 0.25
"""The smoothest part of the surface tells the noise."""
WHITE, SHAPED = 0.6, 1.5
"""Residuals that grow by less than the first power of the window are noise, and by more than the second of shape."""
LOW = 0.9
"""The smoothest quarter of windows is by chance smoother than the noise is."""
START = 30
"""Points through which a first plane is laid."""
THICK = 4.0
"""Deviations that a window must be wide."""
NEIGHBOURS = 1.5
"""Points closer than this [spacings] tell whether noise is shared."""
INDEPENDENT = 0.15
"""A correlation below this is none."""
MOST_TOGETHER = 25.0
ANYTHING: dict[str, Any] = {"variance": 1.0, "together": 1.0, "bend": np.inf, "free": True}
"""Windows in which every point counts."""


def measured_noise(points: Points) -> tuple[Points, Noise]:
    """The noise of points, and these with the spacing that they have along the surface.

    Points that are off by more than they are apart seem sparser than they are, and small windows see no surface: both
    are then looked at again, as coarsely as the noise is thick.
    """
    noise = noise_of(points, 0.0)
    if THICK * noise.sigma > points.spacing:
        points = replace(points, spacing=spacing_of(points.places, THICK * noise.sigma))
        noise = noise_of(points, noise.sigma)
    return points, noise


def noise_of(points: Points, thickness: float) -> Noise:
    """The noise of points that are off by about `thickness` [m]: residuals of quadrics in windows of several widths.

    White noise leaves the same residual in every window. What grows with the square of the window or faster is shape;
    what levels off only in wide ones is noise that neighbours share, as in depth images fused into one surface.
    """
    least = max(FIRST * points.spacing, THICK * thickness)
    windows = widths(least, max(LAST * points.diameter, 1.01 * RATIO * least), RATIO)
    centres = points.places[:CENTRES]
    patches = started(centres, planes(points, centres, enough_neighbours(thickness, points.spacing, START)))
    # Two windows tell white noise; more are looked at where it is not.
    for count in sorted({2, len(windows)}):
        spread = np.sqrt(widened(points, patches.copy(), windows[:count], **ANYTHING)[:, :, -1])
        few = np.flatnonzero(np.isfinite(spread).mean(axis=0) < 0.5)
        spread = spread[:, : few[0] if len(few) else count]
        if spread.shape[1] < 2:
            return Noise(float(np.nan_to_num(np.nanmedian(spread))) if spread.size else 0.0, is_shape=True)
        quiet = np.nanquantile(spread, QUIET, axis=0)
        growth = _growth(quiet, windows, points.diameter)
        if growth[0] < WHITE:
            return Noise(min(float(np.nanmedian(spread[:, 0])), float(quiet[0]) / LOW))
    flat, steep = (np.flatnonzero(which) for which in (growth < WHITE, growth > SHAPED))
    if not len(flat) or (len(steep) and steep[0] < flat[0]):
        return Noise(float(quiet[0]), is_shape=True)
    level = int(flat[0])
    calm = patches[spread[:, level] <= quiet[level]]
    widened(points, calm, windows[: level + 1], **ANYTHING)
    return Noise(float(quiet[level]) / LOW, _together(points, calm, float(windows[level])))


def _growth(quiet: Array, windows: Array, diameter: float) -> Array:
    """The power of the window's width that residuals grow with, from each to the next."""
    floor = 1e-9 * diameter
    return np.asarray(np.diff(np.log(quiet + floor)) / np.diff(np.log(windows[: len(quiet)])))


def _together(points: Points, patches: Patches, window: float) -> float:
    """How many points share one noise, from the residuals of neighbours about patches in windows of that radius [m].

    With noise that is correlated as a Gaussian of the distance d, exp(-d²/2L²), it is that over a plane.
    """
    pairs = cKDTree(points.places).query_pairs(NEIGHBOURS * points.spacing, output_type="ndarray")
    sums = np.zeros(4)
    neighbours(points.places, pairs, patches, window, sums)
    products, squares, distances, count = sums
    correlation = products / max(squares, 1e-300)
    if not correlation > INDEPENDENT:
        return 1.0
    length2 = (distances / count) ** 2 / max(-2 * np.log(correlation), 1e-9)
    return float(min(1 + 2 * np.pi * length2 / points.spacing**2, MOST_TOGETHER))
