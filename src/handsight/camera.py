"""A camera: the ray of each pixel, and the pixel on which a point falls."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._compiled import pinhole, raster
from handsight._compiled.records import CAMERA
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.representation import short_repr

MAX_PIXELS = 50_000_000
MIN_FOCAL = 0.01
MAX_FOCAL = 1e6
"""Smallest and largest focal length, and largest distance of the principal point from pixel (0, 0) [pixels]."""
MAX_LENS = 1e4
"""Largest coefficient of a lens."""
Depth = NDArray[np.float32]


class ImageSource(Protocol):
    """What may know the intrinsics of its images, such as a rig's camera."""

    @property
    def intrinsics(self) -> Array | None:
        """(3, 3) camera matrix [pixels]."""

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) [pixels]."""

    @property
    def lens(self) -> Array:
        """Distortion, as `Camera.lens`."""


class DrawnTriangles(NamedTuple):
    """A depth image of triangles, with the label of the triangle in each pixel."""

    depth: Depth
    """(h, w) along the optical axis [m], infinite where there is none."""
    labels: NDArray[np.int32]
    """(h, w) label of the nearest triangle, -1 where there is none."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera behind a lens, by its intrinsics.

    Its optical frame has x right, y down and z forward; pixel centres are at whole numbers.
    """

    matrix: Array
    """(3, 3) focal lengths and principal point [pixels]."""
    size: tuple[int, int]
    """(width, height) of its images [pixels]."""
    lens: Array = field(default_factory=lambda: np.zeros(0))
    """k1, k2, p1, p2[, k3[, k4, k5, k6]] of OpenCV and ROS' CameraInfo; none: images are rectified."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput for a matrix, a size or a lens that no camera has."""
        K = checks.finite(self.matrix, "matrix", (3, 3))
        if not (K[0, 0] > 0 and K[1, 1] > 0) or K[0, 1] or K[1, 0] or (K[2] != [0, 0, 1]).any():
            expected = "expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            raise InvalidInput(f"matrix: {expected}, got {checks.brief(K)}")
        if min(K[0, 0], K[1, 1]) < MIN_FOCAL or np.abs(K).max() > MAX_FOCAL:
            focal = f"fx, fy from {MIN_FOCAL:g} to {MAX_FOCAL:g} pixels"
            expected = f"expected {focal}, and cx, cy within {MAX_FOCAL:g}"
            raise InvalidInput(f"matrix: {expected}, got {checks.brief(K)}")
        width, height = (checks.integer(n, "size", MAX_PIXELS) for n in self.size)
        if not 0 < width * height <= MAX_PIXELS:
            raise InvalidInput(f"size: expected width and height above 0, got {width} x {height}")
        lens = check_lens(self.lens, "lens")
        checked = {"matrix": K, "size": (width, height), "lens": lens}
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, camera: ImageSource | None) -> Camera:
        """Returns the camera of a rig's images; raises InvalidInput where the rig has none, or no intrinsics of it."""
        if camera is None or camera.intrinsics is None or camera.size is None:
            came = "no camera" if camera is None else "one without"
            raise InvalidInput(f"camera: expected one with intrinsics in the rig, got {came}")
        return cls(camera.intrinsics, camera.size, camera.lens)

    def equals(self, other: Camera) -> bool:
        """Returns whether the other is the same camera."""
        same = np.array_equal(self.matrix, other.matrix) and np.array_equal(self.lens, other.lens)
        return same and self.size == other.size

    def resized(self, size: tuple[int, int]) -> Camera:
        """Returns the camera of the same images, scaled to another (width, height) [pixels] of the same proportions.

        Raises InvalidInput for other proportions.
        """
        across, down = (new / old for new, old in zip(size, self.size, strict=True))
        if abs(across * self.size[1] - down * self.size[1]) > 1.0:  # more than a pixel's rounding
            came = f"{size[0]} x {size[1]}"
            raise InvalidInput(
                f"size: expected the proportions of {self.size[0]} x {self.size[1]}, got {came}"
            )
        scale = np.diag([across, down, 1.0])
        matrix = scale @ self.matrix
        # A pixel's centre is at a whole number, so an image begins half a pixel before 0.
        matrix[:2, 2] += (scale.diagonal()[:2] - 1) / 2
        return Camera(matrix, size, self.lens)

    @cached_property
    def _optics(self) -> tuple[NDArray[np.void], NDArray[np.float32]]:
        record = np.zeros(1, dtype=CAMERA)
        row = record[0]
        rays = np.empty((self.size[1], self.size[0], 2), dtype=np.float32)
        row["fx"] = self.matrix[0, 0]
        row["fy"] = self.matrix[1, 1]
        row["cx"] = self.matrix[0, 2]
        row["cy"] = self.matrix[1, 2]
        row["lens"][: len(self.lens)] = self.lens
        steepest = pinhole.rays(record, rays)
        # A lens is used a tenth beyond the image: its polynomials may lead steeper rays back into the image.
        row["reach2"] = 1.1**2 * steepest if self.lens.any() else np.inf
        rays.setflags(write=False)
        return record, rays

    @property
    def record(self) -> NDArray[np.void]:
        """(1,) CAMERA, as kernels take it."""
        return self._optics[0]

    @property
    def rays(self) -> NDArray[np.float32]:
        """(h, w, 2) x/z and y/z of the ray of each pixel; NaN where the lens lets none through."""
        return self._optics[1]

    def check_size(self, image: ArrayLike, name: str) -> None:
        """Raises InvalidInput for an image or a mask (h, w) of another size than this camera's."""
        if np.shape(image) != self.size[::-1]:
            expected = "{} x {}".format(*self.size)
            came = " x ".join(map(str, np.shape(image)[::-1]))
            raise InvalidInput(f"{name}: expected {expected} pixels, got {came or 'a number'}")

    def check_depth(self, depth: ArrayLike, name: str = "depth") -> Depth:
        """Returns a depth image (h, w) [m] of this camera as float32; raises InvalidInput for other sizes, integers."""
        image = checks.unmasked(depth, name)
        self.check_size(image, name)
        if image.dtype.kind != "f":
            raise InvalidInput(f"{name}: expected metres as floats, got {image.dtype} (millimetres?)")
        return image.astype(np.float32, copy=False)

    def points(self, depth: ArrayLike) -> NDArray[np.float32]:
        """Returns the points (h, w, 3) [m] of a depth image (h, w) [m], in the camera; NaN where it has no depth."""
        z = self.check_depth(depth)
        points = np.empty((*z.shape, 3), dtype=np.float32)
        with np.errstate(invalid="ignore"):
            points[..., 2] = np.where((z > 0) & (z < np.inf), z, np.float32(np.nan))
        np.multiply(self.rays, points[..., 2:], out=points[..., :2])
        if self.lens.any():  # a pixel without a ray has no point
            points[np.isnan(points[..., 0])] = np.nan
        return points

    def project(self, points_camera: ArrayLike) -> Array:
        """Returns column and row (n, 2) of points (n, 3) [m] in the camera; NaN for those out of view."""
        points = checks.finite(points_camera, "points_camera", (None, 3))
        pixels = np.empty((len(points), 2))
        pinhole.pixels_of(self.record, points, pixels)
        return pixels

    def draw(self, vertices_camera: Array, faces: Indices, labels: Indices | None = None) -> DrawnTriangles:
        """Returns the image of triangles `faces` (m, 3) of vertices (k, 3) [m] with labels (m,); None: all 0."""
        depth = np.full(self.size[::-1], np.inf, dtype=np.float32)
        drawn = np.full(self.size[::-1], -1, dtype=np.int32)
        named = np.zeros(len(faces), dtype=np.int64) if labels is None else labels
        raster.draw(self.record, vertices_camera, faces, named, depth, drawn)
        return DrawnTriangles(depth, drawn)


def check_lens(value: ArrayLike, name: str) -> Array:
    """Returns the coefficients of a lens (n,): none, plumb_bob without or with k3, or a rational polynomial.

    Raises InvalidInput for another number of them, and for one beyond `MAX_LENS`.
    """
    lens = checks.finite(value, name, (None,))
    if (np.abs(lens) > MAX_LENS).any():
        raise InvalidInput(f"{name}: expected numbers within {MAX_LENS:g}, got {checks.brief(lens)}")
    if len(lens) not in (0, 4, 5, 8):
        raise InvalidInput(f"{name}: expected 0, 4, 5, 8 numbers, got {len(lens)}")
    return lens
