"""What a cloud's points are off by, read from the cloud itself."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight._kernels.mesh.patches import neighbours
from handsight.checks import Array
from handsight.objects.scans.normals import enough_neighbours, planes
from handsight.objects.scans.windows import Noise, Patches, Points, spacing_of, started, widened, widths


class NoiseOptions(NamedTuple):
    """`NoiseOptions` say how a scan's noise is told from its shape, by windows of growing size."""

    centres: int = 1000  # windows' centres
    first: float = 3.2  # the least window [spacings]
    ratio: float = 1.4  # how much wider each is than the one before
    last: float = 0.32  # the widest [diameters]
    smoothest: float = 0.25  # share of the surface that tells the noise: its smoothest
    noise_power: float = 0.6  # residuals that grow by less than this power of the window are noise
    shape_power: float = 1.5  # residuals that grow by more are of shape
    chance: float = 0.9  # the smoothest quarter of windows is by chance this much smoother than the noise is
    start_points: int = 30  # points through which a first plane is laid
    min_width: float = 4.0  # of a window, in deviations of the noise
    near: float = 1.5  # points closer than this tell whether noise is shared [spacings]
    independent: float = 0.15  # a correlation below this is none
    max_together: float = 25.0  # points that share one noise


NOISE = NoiseOptions()

ANYTHING: dict[str, Any] = {"variance": 1.0, "together": 1.0, "bend": np.inf, "free": True}
"""Windows in which every point counts."""


def measured_noise(points: Points) -> tuple[Points, Noise]:
    """Returns the noise of points, and these with the spacing that they have along the surface.

    Points that are off by more than they are apart seem sparser than they are, and small windows see no surface: both
    are then looked at again, as coarsely as the noise is thick.
    """
    noise = noise_of(points, 0.0)
    if NOISE.min_width * noise.sigma > points.spacing:
        points = replace(points, spacing=spacing_of(points.places, NOISE.min_width * noise.sigma))
        noise = noise_of(points, noise.sigma)
    return points, noise


def noise_of(points: Points, thickness: float) -> Noise:
    """Returns the noise of points that are off by about `thickness` [m]: residuals of quadrics in windows of several
    widths.

    White noise leaves the same residual in every window. What grows with the square of the window or faster is shape;
    what levels off only in wide ones is noise that neighbours share, as in depth images fused into one surface.
    """
    least = max(NOISE.first * points.spacing, NOISE.min_width * thickness)
    windows = widths(least, max(NOISE.last * points.diameter, 1.01 * NOISE.ratio * least), NOISE.ratio)
    centres = points.places[: NOISE.centres]
    patches = started(
        centres, planes(points, centres, enough_neighbours(thickness, points.spacing, NOISE.start_points))
    )
    # Two windows tell white noise; more are looked at where it is not.
    for count in sorted({2, len(windows)}):
        spread = np.sqrt(widened(points, patches.copy(), windows[:count], **ANYTHING)[:, :, -1])
        few = np.flatnonzero(np.isfinite(spread).mean(axis=0) < 0.5)
        spread = spread[:, : few[0] if len(few) else count]
        if spread.shape[1] < 2:
            return Noise(float(np.nan_to_num(np.nanmedian(spread))) if spread.size else 0.0, is_shape=True)
        quiet = np.nanquantile(spread, NOISE.smoothest, axis=0)
        growth = _growth(quiet, windows, points.diameter)
        if growth[0] < NOISE.noise_power:
            return Noise(min(float(np.nanmedian(spread[:, 0])), float(quiet[0]) / NOISE.chance))
    flat, steep = (
        np.flatnonzero(which) for which in (growth < NOISE.noise_power, growth > NOISE.shape_power)
    )
    if not len(flat) or (len(steep) and steep[0] < flat[0]):
        return Noise(float(quiet[0]), is_shape=True)
    level = int(flat[0])
    calm = patches[spread[:, level] <= quiet[level]]
    widened(points, calm, windows[: level + 1], **ANYTHING)
    return Noise(float(quiet[level]) / NOISE.chance, _together(points, calm, float(windows[level])))


def _growth(quiet: Array, windows: Array, diameter: float) -> Array:
    """Returns the power of the window's width that residuals grow with, from each to the next."""
    floor = 1e-9 * diameter
    return np.asarray(np.diff(np.log(quiet + floor)) / np.diff(np.log(windows[: len(quiet)])))


def _together(points: Points, patches: Patches, window: float) -> float:
    """Returns how many points share one noise, from the residuals of neighbours about patches in windows of that
    radius [m].

    With noise that is correlated as a Gaussian of the distance d, exp(-d²/2L²), it is that over a plane.
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
