"""Which part of a fused surface is the object: what stands on the table, or what the fingers hold."""

import contextlib
from collections.abc import Iterator

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, label
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.hand.surface import sample_by_area
from handsight.vision.reconstruction.volume import SurfacePoints, Volume, thinned

SIGMA = 5e-4
"""Common error of the points of a surface [m]: mostly the camera's constant one, which no number of views lowers."""
SIGMA_FOOT = 1.5e-3
"""Common error of the points of the foot, which no view shows [m]."""
BASE_HEIGHT = 3.0
"""Height above the table's margin of what is taken for the outline of the foot [cells]."""
CLOSED_GAP = 4
"""Gaps in the foot's outline up to twice so wide are closed [cells]."""
OPEN_SHARE = 0.6
"""An outline that fills less than this of its hull is open."""
TABLE_MARGIN = 2.5
"""Points nearer to the table than this may be the table's [cells]."""
PART_GAP = 2
"""Half the gap that there may be between parts of one object, as few views show edges [cells]."""
HULL_DISTANCE = 4.0
"""From any measured point, beyond which the convex hull was not observed [cells]."""
HULL_FACING = 3.0
"""Two opposite normals are half so far from each other [cells]."""
MAX_GAP = 0.035
"""From a fingertip's centre to what it holds: tip, hole, errors of joints [m]."""
SLACK = 0.015
"""What is held is nearer to the grip's middle than the fingertips, but for this [m]."""
MAX_CUT = 0.01
"""Share of the surface's points that may be at the edge of what is fused."""


def above_table(volume: Volume) -> SurfacePoints:
    """Returns the largest connected part of a surface above the table at z = 0."""
    points, normals = volume.surface()
    above = points[:, 2] > TABLE_MARGIN * volume.grid.cell
    surface = SurfacePoints(points[above], normals[above])
    return next(parts_of(surface, volume), surface)


def foot(surface: SurfacePoints, cell: float) -> SurfacePoints:
    """Returns what carries an object: walls from its lowest points straight down to the table at z = 0, and a base.

    No view shows the last cells above the table. Without them a correction takes contacts there for wrong.
    """
    points, normals = surface
    low = points[:, 2] < (TABLE_MARGIN + BASE_HEIGHT) * cell
    upright = np.abs(normals[:, 2]) < 0.5
    lowest = low & upright if (low & upright).any() else low  # without upright sides it narrows to its foot
    ring = points[lowest, :2]
    outward = normals[lowest] * [1, 1, 0]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    heights = cell * np.arange(0.5, TABLE_MARGIN)
    wall = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in heights])
    walls, ways = thinned(wall / cell, np.tile(outward, (len(heights), 1)))
    # The base is inside the ring of lowest points; inside its hull, if the ring is open.
    corner = ring.min(axis=0) - (CLOSED_GAP + 1) * cell
    at = np.rint((ring - corner) / cell).astype(int)
    image = np.zeros(tuple(at.max(axis=0) + CLOSED_GAP + 2), dtype=bool)
    image[tuple(at.T)] = True
    closed = binary_closing(image, np.ones((3, 3)), iterations=CLOSED_GAP)
    filled = np.argwhere(binary_fill_holes(closed))
    nodes = np.argwhere(np.ones_like(image))
    with contextlib.suppress(QhullError):  # all on one line
        hull = nodes[Delaunay(at).find_simplex(nodes) >= 0]
        if len(filled) < OPEN_SHARE * len(hull):
            filled = hull
    inside = corner + cell * filled
    base = np.column_stack([inside, np.zeros(len(inside))])
    down = np.tile([0.0, 0, -1], (len(base), 1))
    return SurfacePoints(np.concatenate([walls * cell, base]), np.concatenate([ways, down]))


def in_fingers(volume: Volume, tips_object: Array) -> SurfacePoints:
    """Returns the largest part of a surface that fingertips (k, 3) [m] hold; raises InvalidInput."""
    middle = tips_object.mean(axis=0)
    opening = np.linalg.norm(tips_object - middle, axis=1).max() + SLACK
    low, high = volume.bounds_object + 2 * volume.grid.cell * np.array([[1], [-1]])
    came = f"none in {volume.views} views"
    for number, part in enumerate(parts_of(volume.surface(), volume)):
        points = part.points
        gap = np.linalg.norm(points[:, None] - tips_object, axis=2).min()
        off = np.linalg.norm(points - middle, axis=1).min()
        cut = ((points < low) | (points > high)).any(axis=1).mean()
        if gap <= MAX_GAP and off <= opening and cut <= MAX_CUT:
            return part
        if number == 0:
            size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(points, axis=0))
            near = f"{1e3 * gap:.0f} mm from the nearest fingertip, {1e3 * off:.0f} mm from the grip's middle"
            edge = ", cut by the edge of what is fused" if cut > MAX_CUT else ""
            came = f"a surface of {size} mm that they do not hold: {near}{edge} (background?)"
    raise InvalidInput(f"recording: expected an object between the fingers, got {came}")


def parts_of(surface: SurfacePoints, volume: Volume) -> Iterator[SurfacePoints]:
    """Yields the connected parts of a surface, the largest first."""
    occupied = np.zeros(volume.grid.shape, dtype=bool)
    place = tuple(volume.places(surface.points).T)
    occupied[place] = True
    joined = binary_dilation(occupied, np.ones((3, 3, 3)), iterations=PART_GAP)
    parts = label(joined)[0][place]
    sizes = np.bincount(parts)
    for part in np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes)]:
        yield SurfacePoints(surface.points[parts == part], surface.normals[parts == part])


def share_observed(surface: SurfacePoints, volume: Volume) -> float:
    """Returns at most which share of an object's closed surface is measured: the rest of its convex hull, where it is
    not free space, was not observed. More than that may be hidden behind it."""
    points, normals = surface
    cell = volume.grid.cell
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # all in one plane, whose other side was not observed
        return 0.5
    count = int(4 * hull.area / cell**2)
    which, places, _ = sample_by_area(list(points[hull.simplices][:, None]), count, 0)
    places, facing = thinned(places / cell, hull.equations[which, :3])
    tree = cKDTree(np.hstack([points / cell, HULL_FACING * normals]))
    distances, _ = tree.query(np.hstack([places, HULL_FACING * facing]))
    clear = volume.among(volume.clear(), places * cell)
    unobserved = (distances > HULL_DISTANCE) & ~clear
    return len(points) / float(len(points) + unobserved.sum())
