"""What of an object no view has shown, guessed: by a symmetry that contradicts nothing seen, and down to the table.

A guess is never taken for a measurement: each point says which it is.
"""

import contextlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, label, map_coordinates
from scipy.optimize import minimize
from scipy.spatial import Delaunay, QhullError, cKDTree

from handsight import se3
from handsight.checks import Array, Mask
from handsight.vision.reconstruction.volume import SurfacePoints, Volume, thinned


class CompletionOptions(NamedTuple):
    """`CompletionOptions` say how what no view shows of an object is completed by its symmetry."""

    judged_points: int = 400  # points that a symmetry is judged by
    turns: int = 24  # of an entire turn, by which a body of revolution is judged and filled
    mirror_directions: int = 200  # directions of mirrors that are tried
    mirror_spacing: float = 2.0  # how far apart mirrors of one direction are [cells]
    unknown_cost: float = 0.5
    """What a place costs that nothing is known of [bounds]; one that is right costs 0, one that is wrong 1."""
    max_offset: float = 2.0  # points that a symmetry takes to known places are wrong beyond this [cells]
    max_wrong: float = 0.1  # share of them that may be
    min_known: float = 0.25  # share of all points that must come to known places
    max_cosine: float = 0.2  # of the angle between two mirrors that are taken for perpendicular
    table_margin: float = 2.5
    """Height above a table from which the object's surface can be told from it [cells]."""
    base_height: float = 3.0  # and how far its lowest part reaches [cells]
    closed_gap: int = 4  # gaps in a foot's outline up to twice so wide are closed [cells]
    open_share: float = 0.6  # what fills less than this of its hull is open
    part_gap: int = 2  # half of what parts of one object may be apart [cells]
    sigma_measured: float = 5e-4
    """What the measured points may be off by together [m]: mostly the camera's constant error, which no number of
    views takes away.
    """
    sigma_guessed: float = 1.5e-3  # the same of those that were completed [m]
    guess_distance: float = 1.5  # from any measured point, for a guess to be needed [cells]


COMPLETION = CompletionOptions()


@dataclass(frozen=True, eq=False)
class ReconstructedModel:
    """A `ReconstructedModel` is an object's surface as points, and which of them were seen."""

    points: Array
    """(n, 3) [m]."""
    normals: Array
    """(n, 3) unit, outward."""
    measured: Mask
    """(n,) whether views showed it; else it is guessed."""
    guesses: tuple[str, ...]
    """What was guessed, a sentence each."""

    @property
    def sigmas(self) -> Array:
        """(n,) how far the points may be off, together with their neighbours [m]."""
        return np.where(self.measured, COMPLETION.sigma_measured, COMPLETION.sigma_guessed)

    @property
    def share_measured(self) -> float:
        """Of the points."""
        return float(self.measured.mean()) if len(self.measured) else 0.0


def one_object(surface: SurfacePoints, volume: Volume, table: bool) -> SurfacePoints:
    """Returns the largest connected part of a surface, without a table, on which z is 0."""
    points, normals = surface
    if table:
        above = points[:, 2] > COMPLETION.table_margin * volume.grid.cell
        points, normals = points[above], normals[above]
    if not len(points):
        return SurfacePoints(points, normals)
    occupied = np.zeros(volume.grid.shape, dtype=bool)
    place = tuple(volume.places(points).T)
    occupied[place] = True
    # Edges are told by few views: faces may have gaps between them.
    joined = binary_dilation(occupied, np.ones((3, 3, 3)), iterations=COMPLETION.part_gap)
    parts = label(joined)[0][place]
    mine = parts == np.bincount(parts).argmax()
    return SurfacePoints(points[mine], normals[mine])


def closed(surface: SurfacePoints, volume: Volume, table: bool) -> ReconstructedModel:
    """Returns an object's surface with guesses where no view showed it; `table`: it stands where z is 0, z up."""
    points, normals, guesses = surface.points, surface.normals, list[str]()
    count = len(points)
    for description, maps in _symmetries(surface, volume, table):
        new = _filled(SurfacePoints(points, normals), maps, volume, table)
        if len(new.points) > 0.01 * count:
            points, normals = np.concatenate([points, new.points]), np.concatenate([normals, new.normals])
            guesses.append(description)
    if table and count:
        closest = _closest_point(SurfacePoints(points, normals), volume.grid.cell)
        points, normals = np.concatenate([points, closest.points]), np.concatenate([normals, closest.normals])
        guesses.append("its foot, straight down to the table")
    return ReconstructedModel(points, normals, np.arange(len(points)) < count, tuple(guesses))


def _symmetries(surface: SurfacePoints, volume: Volume, table: bool) -> list[tuple[str, Array]]:
    """Returns what may fill gaps: a name, and maps (k, 4, 4) of the object onto itself, mirrors among them."""
    if len(surface.points) < COMPLETION.judged_points:
        return []
    some = np.random.default_rng(0).permutation(len(surface.points))[: COMPLETION.judged_points]
    judge = _Judge(volume, surface.points[some])
    axis = _revolution(surface)
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


class _Judge:
    """A `_Judge` is what is known of the places that points would be taken to."""

    def __init__(self, volume: Volume, points: Array) -> None:
        self._volume, self._points = volume, points
        distances = volume.distances(1)
        known = np.isfinite(distances)
        cost = np.where(
            known, np.minimum(np.abs(np.nan_to_num(distances)) / volume.bound, 1.0), COMPLETION.unknown_cost
        )
        self._cost = np.where(volume.clear(), 1.0, cost)
        self._known = known | volume.clear()

    def _at(self, maps: Array) -> Array:
        """Returns (k, n, 3) places in the grid that maps (k, 4, 4) take the points to [cells]."""
        grid = self._volume.grid
        return np.asarray((se3.apply(maps, self._points) - grid.origin) / grid.cell)

    def cost(self, maps: Array) -> Array:
        """Returns (k,) of each map, 0 to 1."""
        at = np.moveaxis(self._at(maps), -1, 0)
        return np.asarray(
            map_coordinates(self._cost, at, order=1, mode="constant", cval=COMPLETION.unknown_cost).mean(
                axis=-1
            )
        )

    def allows(self, maps: Array) -> bool:
        """Returns whether what maps (k, 4, 4) say fits to what is known, and enough is known."""
        at = np.moveaxis(self._at(maps), -1, 0)
        known_share = map_coordinates(self._known.astype(np.float32), at, order=1) > 0.9
        wrong = (
            map_coordinates(self._cost, at, order=1) * self._volume.bound
            > COMPLETION.max_offset * self._volume.grid.cell
        )
        return bool(
            known_share.mean() > COMPLETION.min_known
            and (wrong & known_share).sum() < COMPLETION.max_wrong * known_share.sum()
        )

    def mirrors(self, surface: SurfacePoints, table: bool) -> list[Array]:
        """Returns mirrors (4, 4) that fit, the best first."""
        if table:
            angle = np.linspace(0, np.pi, COMPLETION.mirror_directions // 4, endpoint=False)
            sides = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        else:
            sides = se3.directions(2 * COMPLETION.mirror_directions)[: COMPLETION.mirror_directions]
        found = list[tuple[float, Array]]()
        for side in sides:
            along = surface.points @ side
            reach, middle = np.ptp(along) / 4, (along.min() + along.max()) / 2
            offsets = np.arange(
                middle - reach, middle + reach, COMPLETION.mirror_spacing * self._volume.grid.cell
            )
            costs = self.cost(np.stack([_mirror(np.append(side, d)) for d in offsets]))
            found.append((float(costs.min()), np.append(side, offsets[costs.argmin()])))
        found.sort(key=lambda each: each[0])
        good = [self._refined(plane, table) for _, plane in found[: COMPLETION.mirror_directions // 10]]
        return [mirror for mirror in good if self.allows(mirror[None])]

    def _refined(self, plane: Array, table: bool) -> Array:
        """Returns the mirror (4, 4) near a plane (4,) that fits best."""
        free = [0, 1, 3] if table else [0, 1, 2, 3]

        def moved(x: Array) -> Array:
            turned = plane.copy()
            turned[free] += x * np.where(np.array(free) == 3, 0.01, 0.1)
            return turned

        best = minimize(
            lambda x: self.cost(_mirror(moved(x))[None])[0], np.zeros(len(free)), method="Nelder-Mead"
        )
        return _mirror(moved(best.x))


def _mirror(plane: Array) -> Array:
    """Returns (4, 4) the reflection at the plane (4,): normal of any length, and the distance along it [m]."""
    n = plane[:3] / np.linalg.norm(plane[:3])
    T = np.eye(4)
    T[:3, :3] -= 2 * np.outer(n, n)
    T[:3, 3] = 2 * plane[3] * n
    return T


def _revolution(surface: SurfacePoints) -> Array:
    """Returns (TURNS - 1, 4, 4) turns about the line that the surface's normals come nearest to meeting.

    A line of direction d and moment m meets that of a normal n at p where d·(p × n) + m·n = 0 (Pottmann 1999).
    """
    middle = surface.points.mean(axis=0)
    p, n = surface.points - middle, surface.normals
    moments = np.cross(p, n)
    nn, nd, dd = n.T @ n, n.T @ moments, moments.T @ moments
    lever = np.linalg.solve(nn + 1e-9 * np.trace(nn) * np.eye(3), nd)
    d = np.linalg.eigh(dd - nd.T @ lever)[1][:, 0]
    m = -lever @ d
    through = middle + np.cross(d, m)
    turns = se3.rotation_exp(2 * np.pi / COMPLETION.turns * np.arange(1, COMPLETION.turns)[:, None] * d)
    return se3.compose(turns, through - turns @ through)


def _filled(surface: SurfacePoints, maps: Array, volume: Volume, table: bool) -> SurfacePoints:
    """Returns where maps (k, 4, 4) take a surface to that nothing is known of, one point a cell."""
    points = se3.apply(maps, surface.points).reshape(-1, 3)
    normals = np.concatenate([surface.normals @ T[:3, :3].T for T in maps])
    known_share = volume.among(volume.known(1) | volume.clear(), points)
    far = cKDTree(surface.points).query(points)[0] > COMPLETION.guess_distance * volume.grid.cell
    low, high = volume.bounds_object
    new = far & ~known_share & ((points > low) & (points < high)).all(axis=1)
    if table:
        new &= points[:, 2] > COMPLETION.table_margin * volume.grid.cell
    cell = volume.grid.cell
    if not new.any():
        return SurfacePoints(points[new], normals[new])
    at, facing = thinned(points[new] / cell, normals[new])
    return SurfacePoints(at * cell, facing)


def _closest_point(surface: SurfacePoints, cell: float) -> SurfacePoints:
    """From the lowest that was seen straight down to the table, and what stands on it."""
    points, normals = surface
    lowest = (points[:, 2] < (COMPLETION.table_margin + COMPLETION.base_height) * cell) & (
        np.abs(normals[:, 2]) < 0.5
    )
    if not lowest.any():  # it narrows to its foot: what is above stands on all of it
        lowest = points[:, 2] < (COMPLETION.table_margin + COMPLETION.base_height) * cell
    ring, outward = points[lowest, :2], normals[lowest] * [1, 1, 0]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    heights = cell * np.arange(0.5, COMPLETION.table_margin)
    wall = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in heights])
    walls, ways = thinned(wall / cell, np.tile(outward, (len(heights), 1)))
    inside = _filled_in(ring, cell)
    base = np.column_stack([inside, np.zeros(len(inside))])
    down = np.tile([0.0, 0, -1], (len(base), 1))
    return SurfacePoints(np.concatenate([walls * cell, base]), np.concatenate([ways, down]))


def _filled_in(ring: Array, cell: float) -> Array:
    """Returns (m, 2) places a cell apart [m] that a ring of points (n, 2) goes around; if it is open, all between
    them."""
    low = ring.min(axis=0) - (COMPLETION.closed_gap + 1) * cell
    at = np.rint((ring - low) / cell).astype(int)
    image = np.zeros(tuple(at.max(axis=0) + COMPLETION.closed_gap + 2), dtype=bool)
    image[tuple(at.T)] = True
    solid = binary_fill_holes(binary_closing(image, np.ones((3, 3)), iterations=COMPLETION.closed_gap))
    nodes = np.argwhere(np.ones_like(image))
    with contextlib.suppress(QhullError):  # all on one line
        hull = nodes[Delaunay(at).find_simplex(nodes) >= 0]
        if solid.sum() < COMPLETION.open_share * len(hull):
            return np.asarray(low + cell * hull)
    return np.asarray(low + cell * np.argwhere(solid))
