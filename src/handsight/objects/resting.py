"""The poses in which an object rests on a table: the faces of its convex hull that are stable for its centre of mass.

The height of the centre of mass above the table, as a function of the direction that points down, is the energy of a
pose. On a face of the hull it is the face's distance from the centre of mass; over an edge between two faces it rises
to the edge's distance. A resting pose is a basin of this energy: a minimum with all faces from which the object rolls
there, and with the minima behind so low a barrier that they are one: the coplanar triangles of a face, the facets of a
scan's noise, or all facets of a curved side, on which the object can roll freely.
"""

from dataclasses import dataclass, field

import numpy as np

from handsight.checks import Array
from handsight.objects.geometry import Geometry
from handsight.objects.surface import Triangles, unit

BARRIER = 0.003
"""Height of the centre of mass above the higher of two minima below which both are one [diameters]: a scan's facets
leave less, a block that stands on its narrow end (a twentieth of its height) has more."""
PLACED = 0.5
"""Share of objects that were put on any side, not dropped: a bottle stands upright more often than by chance."""
LEAST = 0.002  # probability of a pose that is kept
WINDOW = float(np.deg2rad(10))
"""Within this turn [rad], one standard deviation, members of a curved side count for its direction here."""
ROLLS = float(np.deg2rad(6))
"""Members spread wider than this [rad], one standard deviation, within the window: the object can roll freely."""
FREE = 2 * np.pi
"""Variance of a tilt about which nothing is known [rad²]: its density at the mean is that of any angle, 1 / 2π."""


@dataclass(frozen=True, slots=True, eq=False)
class RestingPose:
    """One way in which an object rests on a table, at any yaw, and rolled along a curved side."""

    down: Array  # (m, 3) unit directions in the object's frame that can point down, the lowest first
    heights: Array  # (m,) the height of the centre of mass above the table with each of them [m]
    weights: Array  # (m,) how likely each of them is, relative to the others
    center_object: Array  # (3,) the centre of mass in the object's frame [m]
    probability: float  # of this pose among all of the object's resting poses
    _near: dict[int, tuple[Array, float, Array, Array]] = field(default_factory=dict, init=False, repr=False)
    """What `_member` returns, by the number of each direction that was asked for."""

    def near(self, down: Array) -> tuple[Array, float, Array]:
        """Returns the direction (3,) of this pose near a direction (3,), the centre of mass's height with it [m], and
        the covariance (3, 3) of the direction [rad²], which is large along a side on which the object can roll."""
        k = int((self.down @ down).argmax())
        if k not in self._near:
            self._near[k] = _member(self, k)
        mean, height, spread, rolls = self._near[k]
        if rolls.shape[1]:  # there, every direction is as good as the one that is asked for
            mean = mean + rolls @ (rolls.T @ (down - mean))
            mean = mean / np.linalg.norm(mean)
        return mean, height, spread


def _member(pose: RestingPose, k: int) -> tuple[Array, float, Array, Array]:
    """Returns the mean direction (3,) near member k of a pose, its height, its covariance (see `RestingPose.near`), and
    the directions (3, r) in which it rolls."""
    angles = np.arccos(np.clip(pose.down @ pose.down[k], -1.0, 1.0))
    weights = pose.weights * np.exp(-0.5 * (angles / WINDOW) ** 2)
    weights /= weights.sum()
    mean = weights @ pose.down
    mean /= np.linalg.norm(mean)
    across = (pose.down - mean) - np.outer((pose.down - mean) @ mean, mean)
    values, vectors = np.linalg.eigh((weights * across.T) @ across)
    rolls = values > ROLLS**2
    spread = (vectors * np.where(rolls, FREE, values)) @ vectors.T
    return mean, float(weights @ pose.heights), spread, vectors[:, rolls]


def resting_poses(geometry: Geometry, center_of_mass: Array | None = None) -> tuple[RestingPose, ...]:
    """Returns the resting poses of an object, the likeliest first.

    `center_of_mass` (3,), in the object's frame [m]; None: that of the volume, or of the hull where the surface is open
    or a cloud. The probability is the basin's solid angle about the centre of mass, as for an object that was dropped
    (Boothroyd and Ho 1977), mixed with an even share for each pose, as for one that was put down.
    """
    # Imported here because SciPy takes a while to load, which a robot without a table need not wait for.
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(geometry.vertices)
    except QhullError:  # flat: the points are moved a little
        hull = ConvexHull(geometry.vertices, qhull_options="QJ")
    normals = hull.equations[:, :3]
    corners = hull.points[hull.simplices]
    if center_of_mass is not None:
        center = center_of_mass
    elif geometry.closed and isinstance(geometry.surface, Triangles):
        center = geometry.surface.volume_centroid
    else:  # that of the hull
        inside = corners.mean(axis=(0, 1))
        volumes = np.abs(np.linalg.det(corners - inside))
        center = np.asarray(inside + volumes @ (corners - inside).sum(axis=1) / (4 * volumes.sum()))
    corners = corners - center
    heights = np.einsum("ij,ij->i", normals, corners[:, 0])
    basin = _basins(corners, normals, heights, hull.neighbors, BARRIER * geometry.diameter)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    labels = np.unique(basin)
    shares = np.bincount(basin, weights=_solid_angles(corners))
    share = shares[labels] / shares.sum()
    labels = labels[share > LEAST]
    share = share[share > LEAST]
    probabilities = (1 - PLACED) * share / share.sum() + PLACED / len(labels)
    found = []
    for k in np.argsort(-probabilities, kind="stable"):
        faces = np.flatnonzero(basin == labels[k])
        faces = faces[np.argsort(heights[faces], kind="stable")]
        rise = (heights[faces] - heights[faces[0]]) / (BARRIER * geometry.diameter)
        faces = faces[rise < 3.0]
        rise = rise[rise < 3.0]
        weights = areas[faces] * np.exp(-rise)
        found.append(RestingPose(normals[faces], heights[faces], weights, center, float(probabilities[k])))
    return tuple(found)


def _basins(corners: Array, normals: Array, heights: Array, neighbors: Array, barrier: float) -> Array:
    """Returns the number (m,) of each face's basin: that of one of its faces.

    `corners` (m, 3, 3) are relative to the centre of mass, the side opposite to corner k is common with the face
    `neighbors[:, k]`. Over each side the energy rises to the side's distance, if its nearest point is over the side on
    the way from one face to the other. By rising passes (watershed), two basins are united where the pass is less than
    `barrier` [m] above the higher of their minima.
    """
    one, k = np.nonzero(neighbors >= 0)
    other = neighbors[one, k]
    a = corners[one, (k + 1) % 3]
    b = corners[one, (k + 2) % 3]
    along = unit(b - a)
    nearest = a - np.einsum("ij,ij->i", a, along)[:, None] * along
    length = np.linalg.norm(nearest, axis=1)
    dot = np.einsum("nij,nj->ni", np.stack([normals[one], normals[other]], axis=1), nearest)
    between = dot.min(axis=1) >= np.einsum("ij,ij->i", normals[one], normals[other]) * length
    passes = np.where(between, length, np.maximum(heights[one], heights[other]))
    parent = list(range(len(heights)))
    lowest = heights.copy()

    def root(face: int) -> int:
        while parent[face] != face:
            parent[face] = face = parent[parent[face]]
        return face

    for i in np.argsort(passes, kind="stable").tolist():
        p = root(int(one[i]))
        q = root(int(other[i]))
        if p != q and passes[i] - max(lowest[p], lowest[q]) < barrier:
            low, high = (p, q) if lowest[p] <= lowest[q] else (q, p)
            parent[high] = low
    return np.array([root(face) for face in range(len(parent))])


def _solid_angles(corners: Array) -> Array:
    """Returns the solid angle (m,) of triangles (m, 3, 3) about the origin [sr] (Van Oosterom and Strackee 1983)."""
    a = corners[:, 0]
    b = corners[:, 1]
    c = corners[:, 2]
    x, y, z = (np.linalg.norm(p, axis=1) for p in (a, b, c))

    def dot(p: Array, q: Array) -> Array:
        return np.asarray(np.einsum("ij,ij->i", p, q))

    volume = np.abs(dot(a, np.cross(b, c)))
    return np.asarray(2 * np.arctan2(volume, x * y * z + dot(a, b) * z + dot(a, c) * y + dot(b, c) * x))
