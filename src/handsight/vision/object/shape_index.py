"""An index of thousands of objects by the sizes of their views: the few of them that a depth image may show."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Indices
from handsight.errors import InvalidFile
from handsight.objects import Entry, Library, ObjectModel, cache, read_shape
from handsight.objects.library.bop import METRES
from handsight.vision.object.appearance import drawn_surface
from handsight.vision.object.region import Scene


class ShapeIndexOptions(NamedTuple):
    """`ShapeIndexOptions` say how views are described, and how many objects an image is compared with."""

    views: int = 100  # of each object, from directions evenly distributed over the sphere
    pixels: int = 32  # of a view, per diameter
    away: float = 5.0  # of the camera that draws it [diameters]
    quantiles: tuple[float, ...] = (0.02, 0.212, 0.404, 0.596, 0.788, 0.98)
    shortlist: int = 40  # objects that are searched in an image
    neighbours: int = 800  # nearest views that they are taken from, for each segment
    segments: int = 3  # largest ones of an image that may each be the object; all together may be it as well
    points: int = 3000  # pixels by which a segment is described
    block: int = 100  # objects whose views are one file of the cache


SHAPE_INDEX = ShapeIndexOptions()


class ShapeIndex(Mapping[str, ObjectModel]):
    """A `ShapeIndex` has the models of a library by name, each loaded when it is asked for, and a k-d tree over
    descriptors of their views, which says at once which few of thousands a depth image may show.

    `recognise` takes it in place of models. What hides a part of an object changes its descriptor.
    """

    def __init__(self, library: Library) -> None:
        """Describes each object's views, or takes them from the cache; raises InvalidFile for an empty library, and
        where a file is damaged."""
        from scipy.spatial import cKDTree  # its import is long

        if not (entries := library.entries()):
            raise InvalidFile(f"{library.place}: expected objects, got an empty library")
        self._library, self._entries = library, {entry.name: entry for entry in entries}
        self._model = lru_cache(8 * SHAPE_INDEX.shortlist)(lambda name: library.model(self._entries[name]))
        self.max_diameter = max(entry.diameter for entry in entries)
        """Of all objects [m]."""
        parts = (entries[k : k + SHAPE_INDEX.block] for k in range(0, len(entries), SHAPE_INDEX.block))
        self._tree = cKDTree(np.concatenate([self._described(part) for part in parts]))

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __getitem__(self, name: str) -> ObjectModel:
        return self._model(name)

    def nearest(self, scene: Scene) -> dict[str, ObjectModel]:
        """Returns the objects whose views are most like a segment of the scene, or like all of them, nearest first; any
        one of them for a scene without segments."""
        step, names = max(1, round(np.sqrt(scene.sizes.sum() / SHAPE_INDEX.points))), list(self)
        labels, points = scene.labels[::step, ::step], scene.camera.points(scene.depth)[::step, ::step]
        largest = np.argsort(-scene.sizes, kind="stable")[: SHAPE_INDEX.segments]
        parts = [points[mask] for mask in (labels >= 0, *(labels == part for part in largest))]
        rows = [
            described(part.astype(np.float64)) for part in parts if len(part) > len(SHAPE_INDEX.quantiles)
        ]
        if not rows:
            return {names[0]: self[names[0]]}
        count = min(SHAPE_INDEX.neighbours, SHAPE_INDEX.views * len(names))
        distance, view = self._tree.query(np.array(rows), k=range(1, count + 1))
        order = view.reshape(-1)[np.argsort(distance, axis=None, kind="stable")] // SHAPE_INDEX.views
        found = [names[k] for k in dict.fromkeys(order.tolist())]
        return {name: self[name] for name in found[: SHAPE_INDEX.shortlist]}

    def _described(self, entries: tuple[Entry, ...]) -> NDArray[np.float32]:
        """Returns the descriptors (n, d) of all views of some entries, those of an entry next to each other."""
        files = [self._library.file(entry) for entry in entries]

        def rows() -> NDArray[np.float32]:
            found = list[Array]()
            for entry, shape in zip(entries, map(read_shape, files), strict=True):
                if shape.faces is not None:  # without building the mesh's distance fields
                    found += described_views(METRES * shape.vertices, shape.faces)
                else:
                    found += described_views(*drawn_surface(self[entry.name].surface))
            return np.concatenate(found).astype(np.float32)

        name = cache.key(f"views 1 {SHAPE_INDEX}", *(np.fromfile(file, dtype=np.uint8) for file in files))
        numbers = cache.remembered_numbers("views", name, np.float32, rows)
        return numbers.reshape(SHAPE_INDEX.views * len(entries), -1)


def described_views(vertices: Array, faces: Indices) -> list[Array]:
    """Returns the descriptors (d,) of the views of an object with vertices (k, 3) [m] and triangles (m, 3)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    focal, middle = SHAPE_INDEX.pixels * SHAPE_INDEX.away, 0.6 * SHAPE_INDEX.pixels
    matrix = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    camera, found = Camera(matrix, (int(2 * middle), int(2 * middle))), []
    for way in se3.directions(SHAPE_INDEX.views):
        x = se3.perpendicular(way)
        placed = (vertices - (low + high) / 2) @ np.stack([x, np.cross(-way, x), -way]).T
        placed[:, 2] += SHAPE_INDEX.away * np.linalg.norm(high - low)
        points = camera.points(camera.draw(placed, faces).depth).astype(np.float64)
        found.append(described(points[points[..., 2] > 0]))
    return found


def described(points: Array) -> Array:
    """Returns the descriptor (d,) [m] of the points (n, 3) of a segment in a camera, whatever its turn about the ray:
    quantiles of the coordinates along the principal axes across the mean ray, of the distance from that ray, and of the
    depth along it; then the depth's correlations with these coordinates and with their squares."""
    middle = points.mean(axis=0)
    ray = middle / np.linalg.norm(middle)
    depth = (points - middle) @ ray
    across = points - middle - depth[:, None] * ray
    variances, axes = np.linalg.eigh(across.T @ across / len(points))
    coordinates, sigmas = across @ axes[:, :0:-1], np.sqrt(variances[:0:-1].clip(1e-18))
    sizes = np.abs(coordinates)
    rows = np.sort(np.column_stack([sizes, np.hypot(*sizes.T), depth]), axis=0)
    chosen = rows[(np.array(SHAPE_INDEX.quantiles) * len(points)).astype(int)]
    bent, tilted = depth @ sizes**2 / sigmas**2, np.abs(depth @ coordinates) / sigmas
    return np.concatenate([chosen.T.reshape(-1), bent / len(points), tilted / len(points)])
