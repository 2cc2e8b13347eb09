"""A depth camera: which ray each pixel looks along, and which pixel a point falls on."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.image import pinhole, raster
from handsight._kernels.image.vision_records import CAMERA
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.representation import short_repr
from handsight.rig import Camera
from handsight.rig.rig import check_lens

MOST_PIXELS = 50_000_000
STEEPER = 1.1
"""A lens is believed so much beyond the steepest ray of the image; its polynomials may lead others back into it."""
Depth = NDArray[np.float32]


class Drawn(NamedTuple):
    """A picture of triangles."""

    depth: Depth
    """(h, w) along the optical axis [m], infinite where there is none."""
    labels: NDArray[np.int32]
    """(h, w) of the nearest triangle, -1 where there is none."""


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """A camera's intrinsics. Optical frame: x right, y down, z forward; pixel centres at whole numbers."""

    matrix: Array
    """(3, 3) focal lengths and principal point [pixels]."""
    size: tuple[int, int]
    """(width, height) of its images [pixels]."""
    lens: Array = field(default_factory=lambda: np.zeros(0))
    """k1, k2, p1, p2[, k3[, k4, k5, k6]] of OpenCV and ROS' CameraInfo; none: images are rectified."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput for what is no camera."""
        K = checks.finite(self.matrix, "matrix", (3, 3))
        if not (K[0, 0] > 0 and K[1, 1] > 0) or K[0, 1] or K[1, 0] or (K[2] != [0, 0, 1]).any():
            raise InvalidInput(
                f"matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {checks.brief(K)}"
            )
        width, height = (checks.integer(n, "size", MOST_PIXELS) for n in self.size)
        if not 0 < width * height <= MOST_PIXELS:
            raise InvalidInput(f"size: expected width and height above 0, got {width} x {height}")
        lens = check_lens(self.lens, "lens")
        for name, value in (("matrix", K), ("size", (width, height)), ("lens", lens)):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, camera: Camera | None) -> "PinholeCamera":
        """A rig's camera; raises InvalidInput where the rig has none, or none of which images are known."""
        if camera is None or camera.intrinsics is None or camera.size is None:
            came = "no camera" if camera is None else "one without"
            raise InvalidInput(f"camera: expected one with intrinsics in the rig, got {came}")
        return cls(camera.intrinsics, camera.size, camera.lens)

    @cached_property
    def _optics(self) -> tuple[NDArray[np.void], NDArray[np.float32]]:
        record = np.zeros(1, dtype=CAMERA)
        row, rays = record[0], np.empty((self.size[1], self.size[0], 2), dtype=np.float32)
        row["fx"], row["fy"] = self.matrix[0, 0], self.matrix[1, 1]
        row["cx"], row["cy"] = self.matrix[0, 2], self.matrix[1, 2]
        row["lens"][: len(self.lens)] = self.lens
        steepest = pinhole.rays(record, rays)
        row["reach2"] = STEEPER**2 * steepest if self.lens.any() else np.inf
        rays.setflags(write=False)
        return record, rays

    @property
    def record(self) -> NDArray[np.void]:
        """(1,) CAMERA, as kernels take it."""
        return self._optics[0]

    @property
    def rays(self) -> NDArray[np.float32]:
        """(h, w, 2) x/z and y/z of each pixel; NaN where the lens leads no ray."""
        return self._optics[1]

    def check_size(self, image: ArrayLike, name: str) -> None:
        """Raises InvalidInput for an image or a mask (h, w) of another size than this camera's."""
        if np.shape(image) != self.size[::-1]:
            expected, came = ("{} x {}".format(*self.size), " x ".join(map(str, np.shape(image)[::-1])))
            raise InvalidInput(f"{name}: expected {expected} pixels, got {came or 'a number'}")

    def check_depth(self, depth: ArrayLike, name: str = "depth") -> Depth:
        """A depth image (h, w) [m] of this camera as float32; raises InvalidInput for another size or whole numbers."""
        image = np.asarray(depth)
        self.check_size(image, name)
        if image.dtype.kind != "f":
            raise InvalidInput(f"{name}: expected metres as floats, got {image.dtype} (millimetres?)")
        return image.astype(np.float32, copy=False)

    def points(self, depth: ArrayLike) -> NDArray[np.float32]:
        """(h, w, 3) points in the camera [m] of a depth image (h, w) [m], NaN where it has none."""
        z = self.check_depth(depth)
        points = np.empty((*z.shape, 3), dtype=np.float32)
        with np.errstate(invalid="ignore"):
            points[..., 2] = np.where((z > 0) & (z < np.inf), z, np.float32(np.nan))
        np.multiply(self.rays, points[..., 2:], out=points[..., :2])
        if self.lens.any():  # a pixel without a ray has no point
            points[np.isnan(points[..., 0])] = np.nan
        return points

    def project(self, points_camera: ArrayLike) -> Array:
        """(n, 2) column and row of points (n, 3) [m] in the camera; NaN where they are not seen."""
        points = checks.finite(points_camera, "points_camera", (None, 3))
        pixels = np.empty((len(points), 2))
        pinhole.pixels_of(self.record, points, pixels)
        return pixels

    def draw(self, vertices_camera: Array, faces: Indices, labels: Indices | None = None) -> Drawn:
        """What the triangles `faces` (m, 3) of vertices (k, 3) [m] look like; `labels` (m,): of each."""
        depth = np.full(self.size[::-1], np.inf, dtype=np.float32)
        drawn = np.full(self.size[::-1], -1, dtype=np.int32)
        named = np.zeros(len(faces), dtype=np.int64) if labels is None else labels
        raster.draw(self.record, vertices_camera, faces, named, depth, drawn)
        return Drawn(depth, drawn)
