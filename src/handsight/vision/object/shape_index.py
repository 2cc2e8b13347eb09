"""An index of thousands of objects by the sizes of their views, also partly hidden: the few that an image may show."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Indices
from handsight.errors import InvalidFile
from handsight.objects import Entry, Library, ObjectModel, cache, read_shape
from handsight.objects.library.documents import METRES
from handsight.vision.object.appearance import drawn_surface
from handsight.vision.object.region import Scene

Floats = NDArray[np.floating]


class ShapeIndexOptions(NamedTuple):
    """`ShapeIndexOptions` say how views are described, and how many objects an image is compared with."""

    views: int = 100  # of each object, from directions evenly distributed over the sphere
    pixels: int = 32  # of a view, per diameter
    view_points: int = 256  # of its pixels, by which it is described
    away: float = 5.0  # of the camera that draws it [diameters]
    hidden: tuple[float, ...] = (0.12, 0.25)  # shares of a view that are hidden from its further descriptors
    occluders: int = 6  # that hide each share: edges, bars and discs as 3 : 2 : 1
    dimensions: int = 10  # of descriptors in the tree, along the principal axes of them all
    quantiles: tuple[float, ...] = (0.02, 0.212, 0.404, 0.596, 0.788, 0.98)
    shortlist: int = 40  # objects that are searched in an image, of a hundred; it grows with the cube root
    neighbours: int = 800  # nearest descriptors that they are taken from, for each segment
    segments: int = 3  # largest ones of an image that may each be the object, or any two or all together
    points: int = 3000  # pixels by which a segment is described
    block: int = 100  # objects whose views are one file of the cache


SHAPE_INDEX = ShapeIndexOptions()


class ShapeIndex(Mapping[str, ObjectModel]):
    """A `ShapeIndex` has the models of a library by name, each loaded when it is asked for, and a k-d tree over
    descriptors of their views, which says at once which few of thousands a depth image may show.

    `recognise` takes it in place of models. What hides a part of an object changes its descriptor, so each view is also
    described with parts hidden.
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
        self.shortlist = round(SHAPE_INDEX.shortlist * max(len(entries) / 100, 1) ** (1 / 3))
        """Objects that are searched in an image."""
        blocks = range(0, len(entries), SHAPE_INDEX.block)
        rows = [self._described(entries[k : k + SHAPE_INDEX.block]) for k in blocks]
        some = np.concatenate([part[:: SHAPE_INDEX.block] for part in rows]).astype(np.float64)
        self._axes = np.linalg.eigh(np.cov(some.T))[1][:, -SHAPE_INDEX.dimensions :].astype(np.float32)
        self._tree = cKDTree(np.concatenate([rows.pop(0) @ self._axes for _ in blocks], dtype=np.float64))

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __getitem__(self, name: str) -> ObjectModel:
        return self._model(name)

    def nearest(self, scene: Scene) -> dict[str, ObjectModel]:
        """Returns the objects whose views are most like a segment of the scene, like two or like all of them, nearest
        first; any one of them for a scene without segments."""
        step, names = max(1, round(np.sqrt(scene.sizes.sum() / SHAPE_INDEX.points))), list(self)
        labels, points = scene.labels[::step, ::step], scene.camera.points(scene.depth)[::step, ::step]
        largest = np.argsort(-scene.sizes, kind="stable")[: SHAPE_INDEX.segments]
        chosen = [*combinations(largest, 1), *combinations(largest, 2)]  # something may divide an object
        parts = [points[mask] for mask in (labels >= 0, *(np.isin(labels, some) for some in chosen))]
        parts = [part.astype(np.float64) for part in parts if len(part) > len(SHAPE_INDEX.quantiles)]
        if not parts:
            return {names[0]: self[names[0]]}
        count = min(SHAPE_INDEX.neighbours, self._tree.n)
        rows = np.array([described(part) for part in parts]) @ self._axes
        owners = self._tree.query(rows, k=range(1, count + 1))[1] // (self._tree.n // len(names))
        ranked = list[tuple[float, int]]()
        for part, each in zip(parts, owners, strict=True):
            share = len(part) / len(parts[0])  # part of an object says less than all of it
            ranked += [(k / share, owner) for k, owner in enumerate(dict.fromkeys(each.tolist()), 1)]
        found = list(dict.fromkeys(names[owner] for _, owner in sorted(ranked)))
        return {name: self[name] for name in found[: self.shortlist]}

    def _described(self, entries: tuple[Entry, ...]) -> NDArray[np.float16]:
        """Returns the descriptors (n, d) of all views of some entries, those of an entry next to each other."""
        files = [self._library.file(entry) for entry in entries]

        def rows() -> NDArray[np.float16]:
            found = list[Floats]()
            for entry, shape in zip(entries, map(read_shape, files), strict=True):
                if shape.faces is not None:  # without building the mesh's distance fields
                    found.append(described_views(METRES * shape.vertices, shape.faces))
                else:
                    found.append(described_views(*drawn_surface(self[entry.name].surface)))
            return np.concatenate(found).astype(np.float16)

        name = cache.key(f"views 2 {SHAPE_INDEX}", *(np.fromfile(file, dtype=np.uint8) for file in files))
        numbers = cache.remembered_numbers("views", name, np.float16, rows)
        return numbers.reshape(-1, 4 * len(SHAPE_INDEX.quantiles) + 4)


def described_views(vertices: Array, faces: Indices) -> Floats:
    """Returns the descriptors (k, d) of the views of an object with vertices (k, 3) [m] and triangles (m, 3), of the
    complete ones and of those that are partly hidden."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    focal, middle = SHAPE_INDEX.pixels * SHAPE_INDEX.away, 0.6 * SHAPE_INDEX.pixels
    camera = Camera(np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]]), (int(2 * middle),) * 2)
    views = np.empty((SHAPE_INDEX.views, SHAPE_INDEX.view_points, 3), dtype=np.float32)
    for view, way in zip(views, se3.directions(SHAPE_INDEX.views), strict=True):
        x = se3.perpendicular(way)
        placed = (vertices - (low + high) / 2) @ np.stack([x, np.cross(-way, x), -way]).T
        placed[:, 2] += SHAPE_INDEX.away * np.linalg.norm(high - low)
        points = camera.points(camera.draw(placed, faces).depth)
        points = points[points[..., 2] > 0]
        points = points if len(points) else placed  # thinner than a pixel
        view[:] = points[np.linspace(0, len(points) - 1, len(view)).astype(int)]
    found = list(map(described, [views, *partly_hidden(views, np.random.default_rng(0))]))
    return np.concatenate([each.reshape(-1, each.shape[-1]) for each in found])


def partly_hidden(views: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """Yields for each share that is hidden of views' points (v, n, 3) what is left of them (v, k, m, 3) by drawn
    occluders: behind straight edges, then beside bars, then around discs."""
    each, count = np.arange(len(views))[:, None], SHAPE_INDEX.occluders
    bars = slice(count // 2, count * 5 // 6)
    for share in SHAPE_INDEX.hidden:
        middles = views[each, rng.integers(views.shape[1], size=(len(views), count))]
        away = views[:, None, :, :2] - middles[:, :, None, :2]
        angle = rng.uniform(0, 2 * np.pi, (*middles.shape[:2], 1)).astype(np.float32)
        hides = np.cos(angle) * away[..., 0] + np.sin(angle) * away[..., 1]
        hides[:, bars] = np.abs(hides[:, bars])
        hides[:, bars.stop :] = np.hypot(away[:, bars.stop :, :, 0], away[:, bars.stop :, :, 1])
        number = int(share * views.shape[1])
        yield views[each[..., None], np.argpartition(hides, number, axis=-1)[..., number:]]


def described(points: Floats) -> Floats:
    """Returns the descriptor (..., d) [m] of the points (..., n, 3) of a segment in a camera, whatever its turn about
    the ray: quantiles of the coordinates along the principal axes across the mean ray, of the distance from that ray,
    and of the depth along it; then the depth's correlations with these coordinates and with their squares."""
    n, middle = points.shape[-2], points.mean(axis=-2, keepdims=True)
    ray = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    away = points - middle
    depth = away @ ray.swapaxes(-1, -2)
    across = away - depth * ray
    variances, axes = np.linalg.eigh(across.swapaxes(-1, -2) @ across / n)
    coordinates = (across @ axes[..., :0:-1]).swapaxes(-1, -2)
    sigmas = np.sqrt(variances[..., :0:-1].clip(1e-18))
    sizes = np.abs(coordinates)
    radius = np.hypot(sizes[..., :1, :], sizes[..., 1:, :])
    rows = np.sort(np.concatenate([sizes, radius, depth.swapaxes(-1, -2)], axis=-2), axis=-1)
    chosen = rows[..., (np.array(SHAPE_INDEX.quantiles) * n).astype(int)]
    bent, tilted = (sizes**2 @ depth)[..., 0] / sigmas**2, np.abs(coordinates @ depth)[..., 0] / sigmas
    return np.concatenate([chosen.reshape(*chosen.shape[:-2], -1), bent / n, tilted / n], axis=-1)
