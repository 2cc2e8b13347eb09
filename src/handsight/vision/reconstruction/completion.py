"""Guesses of what no view of an object has shown: by a symmetry that contradicts no view, and down to the table.

Each point of the model says whether it was measured or guessed.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, label, map_coordinates
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from handsight import se3
from handsight.checks import Array, Mask
from handsight.hand.surface import sample_by_area
from handsight.objects import about
from handsight.vision.reconstruction.volume import SurfacePoints, Volume, thinned


class CompletionOptions(NamedTuple):
    """`CompletionOptions` say how an object is completed by its symmetry and down to the table."""

    judged_points: int = 400  # points by which a symmetry is judged
    turns: int = 24  # steps of a full turn, by which a body of revolution is judged and completed
    mirror_directions: int = 200  # directions of mirrors that are tried
    mirror_spacing: float = 2.0  # between mirrors of one direction [cells]
    unknown_cost: float = 0.5
    """Of a point that a symmetry takes to an unknown place; on the surface it costs 0, off it or in free space 1."""
    max_offset: float = 2.0  # a point that a symmetry takes to a known place is wrong beyond this [cells]
    max_wrong: float = 0.1  # share of these points that may be wrong
    min_known: float = 0.25  # share of all points that must come to known places
    max_cosine: float = 0.2  # between the normals of two mirrors that are taken for perpendicular
    table_margin: float = 2.5  # points nearer to the table than this may be the table's [cells]
    base_height: float = 3.0  # of the part above that whose outline is taken for the base's [cells]
    closed_gap: int = 4  # gaps in the base's outline up to twice so wide are closed [cells]
    open_share: float = 0.6  # an outline that fills less than this of its hull is open
    part_gap: int = 2  # half the gap that there may be between parts of one object [cells]
    sigma_measured: float = 5e-4
    """Common error of the measured points [m]: mostly the camera's constant one, which no number of views lowers."""
    sigma_guessed: float = 1.5e-3  # common error of the guessed points [m]
    guess_distance: float = 1.5  # from any measured point, beyond which a guess is added [cells]
    hull_distance: float = 4.0  # from any measured point, beyond which the hull was not observed [cells]
    hull_facing: float = 3.0  # two opposite normals are half so far from each other [cells]


COMPLETION = CompletionOptions()


@dataclass(frozen=True, eq=False)
class ReconstructedModel:
    """A `ReconstructedModel` is an object's surface as points, measured and guessed."""

    points: Array  # (n, 3) [m]
    normals: Array  # (n, 3) unit, outward
    measured: Mask  # (n,) whether views showed the point; else it is guessed
    guesses: tuple[str, ...]  # what was guessed, in a few words each

    @property
    def sigmas(self) -> Array:
        """(n,) standard deviation of the error that a point shares with its neighbours [m]."""
        return np.where(self.measured, COMPLETION.sigma_measured, COMPLETION.sigma_guessed)


def one_object(surface: SurfacePoints, volume: Volume, table: bool) -> SurfacePoints:
    """Returns the largest connected part of a surface, without the table at z = 0 if there is a `table`."""
    points, normals = surface
    if table:
        above = points[:, 2] > COMPLETION.table_margin * volume.grid.cell
        points, normals = points[above], normals[above]
    return next(parts_of(SurfacePoints(points, normals), volume), SurfacePoints(points, normals))


def parts_of(surface: SurfacePoints, volume: Volume) -> Iterator[SurfacePoints]:
    """Yields the connected parts of a surface, the largest first."""
    occupied = np.zeros(volume.grid.shape, dtype=bool)
    place = tuple(volume.places(surface.points).T)
    occupied[place] = True
    # Few views show edges: faces may have gaps between them.
    joined = binary_dilation(occupied, np.ones((3, 3, 3)), iterations=COMPLETION.part_gap)
    parts = label(joined)[0][place]
    sizes = np.bincount(parts)
    for part in np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes)]:
        yield SurfacePoints(surface.points[parts == part], surface.normals[parts == part])


def share_observed(surface: SurfacePoints, volume: Volume) -> float:
    """Returns at most which share of an object's closed surface is measured: the rest of its convex hull, where it is
    not free space, was not observed. More than that may be hidden behind it."""
    points, normals, cell = *surface, volume.grid.cell
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # all in one plane, whose other side was not observed
        return 0.5
    count = int(4 * hull.area / cell**2)
    which, places, _ = sample_by_area(list(points[hull.simplices][:, None]), count, 0)
    places, facing = thinned(places / cell, hull.equations[which, :3])
    tree = cKDTree(np.hstack([points / cell, COMPLETION.hull_facing * normals]))
    open_ = tree.query(np.hstack([places, COMPLETION.hull_facing * facing]))[0] > COMPLETION.hull_distance
    open_ &= ~volume.among(volume.clear(), places * cell)
    return len(points) / float(len(points) + open_.sum())


def closed(
    surface: SurfacePoints, volume: Volume, table: bool, *, symmetries: bool = True
) -> ReconstructedModel:
    """Returns an object's surface with guesses where no view showed it; `table`: it stands at z = 0, with z up.

    symmetries: whether its symmetries are guessed, which can be off by centimetres.
    """
    points, normals, guesses = surface.points, surface.normals, list[str]()
    count = len(points)
    for description, maps in _symmetries(surface, volume, table) if symmetries else ():
        # The points under the symmetry, one a cell, where they come to unknown places.
        places = se3.apply(maps, points).reshape(-1, 3)
        facing = np.concatenate([normals @ T[:3, :3].T for T in maps])
        (low, high), cell = volume.bounds_object, volume.grid.cell
        new = ~volume.among(volume.known(1) | volume.clear(), places)
        new &= ((places > low) & (places < high)).all(axis=1)
        new &= cKDTree(points).query(places)[0] > COMPLETION.guess_distance * cell
        if table:
            new &= places[:, 2] > COMPLETION.table_margin * cell
        cells, ways = thinned(places[new] / cell, facing[new]) if new.any() else (places[new], facing[new])
        if len(cells) > 0.01 * count:
            points, normals = np.concatenate([points, cells * cell]), np.concatenate([normals, ways])
            guesses.append(description)
    if table and count:
        lowest = _base(SurfacePoints(points, normals), volume.grid.cell)
        points, normals = np.concatenate([points, lowest.points]), np.concatenate([normals, lowest.normals])
        guesses.append("its foot, straight down to the table")
    return ReconstructedModel(points, normals, np.arange(len(points)) < count, tuple(guesses))


def _symmetries(surface: SurfacePoints, volume: Volume, table: bool) -> list[tuple[str, Array]]:
    """Returns the object's symmetries: a name, and maps (k, 4, 4) of the object onto itself, for each."""
    if len(surface.points) < COMPLETION.judged_points:
        return []
    some = np.random.default_rng(0).permutation(len(surface.points))[: COMPLETION.judged_points]
    judge = MapJudge(volume, surface.points[some])
    # Turns about the line that the surface's normals come nearest to meeting: a line of direction d and moment m meets
    # that of a normal n at p where d·(p × n) + m·n = 0 (Pottmann 1999).
    middle = surface.points.mean(axis=0)
    p, n = surface.points - middle, surface.normals
    moments = np.cross(p, n)
    nn, nd, dd = n.T @ n, n.T @ moments, moments.T @ moments
    lever = np.linalg.solve(nn + 1e-9 * np.trace(nn) * np.eye(3), nd)
    d = np.linalg.eigh(dd - nd.T @ lever)[1][:, 0]
    angles = 2 * np.pi / COMPLETION.turns * np.arange(1, COMPLETION.turns)
    axis = about(middle - np.cross(d, lever @ d), angles[:, None] * d)
    if judge.allows(axis):
        return [("a body of revolution", axis)]
    found = list[tuple[str, Array]]()
    for mirror in judge.mirrors(surface, table):
        first = found[0][1][0] if found else None
        # Two mirrors: the second upright on the first.
        if first is None or abs(np.trace(first[:3, :3] @ mirror[:3, :3]) + 1) < 4 * COMPLETION.max_cosine**2:
            found.append(("a mirror image", mirror[None]))
        if len(found) == 2:
            break
    return found


class MapJudge:
    """A `MapJudge` says how well maps of an object onto itself agree with what the views show."""

    def __init__(self, volume: Volume, points: Array) -> None:
        self._volume, self._points = volume, points
        distances = volume.distances(1)
        known, off = np.isfinite(distances), np.abs(np.nan_to_num(distances)) / volume.bound
        cost = np.where(known, np.minimum(off, 1.0), COMPLETION.unknown_cost)
        self._cost = np.where(volume.clear(), 1.0, cost)
        self._known = known | volume.clear()

    def _at(self, values: Array, maps: Array, outside: float) -> Array:
        """Returns (k, n) the grid's values (nx, ny, nz) at the places that maps (k, 4, 4) take the points to."""
        grid = self._volume.grid
        at = np.moveaxis((se3.apply(maps, self._points) - grid.origin) / grid.cell, -1, 0)
        return np.asarray(map_coordinates(values, at, order=1, mode="constant", cval=outside))

    def cost(self, maps: Array) -> Array:
        """Returns (k,) the mean cost of the points of each map, 0 to 1."""
        return np.asarray(self._at(self._cost, maps, COMPLETION.unknown_cost).mean(axis=-1))

    def allows(self, maps: Array) -> bool:
        """Returns whether maps (k, 4, 4) take enough points to known places, and few of these to wrong ones."""
        known = self._at(self._known.astype(np.float32), maps, 0.0) > 0.9
        most = COMPLETION.max_offset * self._volume.grid.cell
        wrong = self._at(self._cost, maps, 0.0) * self._volume.bound > most
        few = (wrong & known).sum() < COMPLETION.max_wrong * known.sum()
        return bool(known.mean() > COMPLETION.min_known and few)

    def mirrors(self, surface: SurfacePoints, table: bool) -> list[Array]:
        """Returns the mirrors (4, 4) that are allowed, the best first; with a table only upright ones."""
        if table:
            angle = np.linspace(0, np.pi, COMPLETION.mirror_directions // 4, endpoint=False)
            sides = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        else:
            sides = se3.directions(2 * COMPLETION.mirror_directions)[: COMPLETION.mirror_directions]
        found = list[tuple[float, Array]]()
        for side in sides:
            along = surface.points @ side
            reach, middle = np.ptp(along) / 4, (along.min() + along.max()) / 2
            spacing = COMPLETION.mirror_spacing * self._volume.grid.cell
            offsets = np.arange(middle - reach, middle + reach, spacing)
            costs = self.cost(np.stack([_mirror(np.append(side, d)) for d in offsets]))
            found.append((float(costs.min()), np.append(side, offsets[costs.argmin()])))
        found.sort(key=lambda each: each[0])
        good = [self._refined(plane, table) for _, plane in found[: COMPLETION.mirror_directions // 10]]
        return [mirror for mirror in good if self.allows(mirror[None])]

    def _refined(self, plane: Array, table: bool) -> Array:
        """Returns the mirror (4, 4) near a plane (4,) that fits best."""
        steps = np.diag([0.1, 0.1, 0.1, 0.01])[[0, 1, 3] if table else [0, 1, 2, 3]]

        def cost(x: Array) -> float:
            return float(self.cost(_mirror(plane + x @ steps)[None])[0])

        best = minimize(cost, np.zeros(len(steps)), method="Nelder-Mead")
        return _mirror(plane + best.x @ steps)


def _mirror(plane: Array) -> Array:
    """Returns the reflection (4, 4) at a plane (4,): its normal of any length, and its distance along it [m]."""
    n = plane[:3] / np.linalg.norm(plane[:3])
    T = np.eye(4)
    T[:3, :3] -= 2 * np.outer(n, n)
    T[:3, 3] = 2 * plane[3] * n
    return T


def _base(surface: SurfacePoints, cell: float) -> SurfacePoints:
    """Returns a surface from the lowest points straight down to the table, and its base there."""
    points, normals = surface
    low = points[:, 2] < (COMPLETION.table_margin + COMPLETION.base_height) * cell
    upright = np.abs(normals[:, 2]) < 0.5
    lowest = low & upright if (low & upright).any() else low  # without upright sides it narrows to its foot
    ring, outward = points[lowest, :2], normals[lowest] * [1, 1, 0]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    heights = cell * np.arange(0.5, COMPLETION.table_margin)
    wall = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in heights])
    walls, ways = thinned(wall / cell, np.tile(outward, (len(heights), 1)))
    # The base is inside the ring of lowest points; inside its hull, if the ring is open.
    corner = ring.min(axis=0) - (COMPLETION.closed_gap + 1) * cell
    at = np.rint((ring - corner) / cell).astype(int)
    image = np.zeros(tuple(at.max(axis=0) + COMPLETION.closed_gap + 2), dtype=bool)
    image[tuple(at.T)] = True
    solid = binary_fill_holes(binary_closing(image, np.ones((3, 3)), iterations=COMPLETION.closed_gap))
    filled, nodes = np.argwhere(solid), np.argwhere(np.ones_like(image))
    with contextlib.suppress(QhullError):  # all on one line
        hull = nodes[Delaunay(at).find_simplex(nodes) >= 0]
        filled = hull if len(filled) < COMPLETION.open_share * len(hull) else filled
    inside = corner + cell * filled
    base = np.column_stack([inside, np.zeros(len(inside))])
    down = np.tile([0.0, 0, -1], (len(base), 1))
    return SurfacePoints(np.concatenate([walls * cell, base]), np.concatenate([ways, down]))
