"""Which clouds are scans, and the surface behind one."""

from dataclasses import dataclass

import numpy as np

from handsight.checks import Array
from handsight.objects.geometry import Roughness
from handsight.objects.scans.noise import measured_noise
from handsight.objects.scans.patches import ScannedSurface, fitted
from handsight.objects.scans.roughness import roughness_of
from handsight.objects.scans.windows import Noise, Points, spacing_of

MOST_POINTS = 20_000
"""More say little more about an object that fits into a hand."""
LEAST_POINTS = 200
"""Fewer do not tell noise from shape."""
CLEAN = 5e-4
"""Points with normals whose noise is below this [diameters] are taken for surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What noisy points say of an object's surface."""

    noise: Noise
    surface: ScannedSurface
    roughness: Roughness


def scanned(points: Array, normals: Array | None, diameter: float) -> Scan | None:
    """The surface behind points (n, 3) [m] with unit outward normals (n, 3) or none; None where the points are surface.

    They are where they have normals and no noise to speak of; so are too few to tell.
    """
    if len(points) < LEAST_POINTS:
        return None
    order = np.random.default_rng(5).permutation(len(points))[:MOST_POINTS]
    places = points[order]
    unknown = np.full_like(places, np.nan)
    given = Points(places, unknown if normals is None else normals[order], spacing_of(places), diameter)
    given, noise = measured_noise(given)
    if normals is not None and (noise.is_shape or noise.sigma < CLEAN * diameter):
        return None
    surface = fitted(given, noise)
    return Scan(noise, surface, roughness_of(surface, given, noise))
