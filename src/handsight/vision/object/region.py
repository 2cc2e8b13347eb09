"""Where in a depth image an object may be: its wanted pixels without hand and table, in connected segments."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight import checks
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.vision.kernels import depth_image
from handsight.vision.kernels.vision_records import DEPTH_POINT, HAND

TABLE_WITHIN = 0.010  # points nearer to the table's plane are the table's [m]
REGION_TRIALS = 200  # planes through three points each
TRIAL_PIXELS = 750  # pixels that choose among them
REFINE_PIXELS = 3000  # pixels that the chosen one is fitted to
MIN_SEGMENT = 40  # pixels of a segment that is used
MAX_RANGE = 20  # an image half of which is beyond it is in another unit [m]
CHECKED_ROWS = 60  # of an image, by which that is decided


@dataclass(frozen=True, eq=False)
class Scene:
    """A depth image, with the segments of it that may be the object."""

    camera: Camera
    depth: Depth  # (h, w) [m]; 0 where there is none
    labels: NDArray[np.int32]  # (h, w) number of the segment, `TABLE`, `HAND`, or `OUT`
    sizes: Array  # (p,) pixels of each segment

    @property
    def reason(self) -> str:
        """Why it has no segments, if it has none."""
        known = (self.depth > 0).any()
        return "nothing is seen there but the table and the hand" if known else "no pixel has a depth"

    def without(self, excluded: Mask) -> "Scene":
        """Returns the scene with some pixels (h, w) excluded as the hand's are: what is behind them is hidden by them.
        What is left is divided into segments again."""
        inside = self.labels >= 0
        labels = np.where(inside, np.int32(depth_image.OPEN), self.labels)
        labels[excluded & inside] = HAND
        return _divided(self.camera, self.depth, labels)


def _divided(camera: Camera, depth: Depth, labels: NDArray[np.int32]) -> Scene:
    """Returns the scene whose `OPEN` labels are divided into segments, which are written to them."""
    sizes = np.empty(labels.size // MIN_SEGMENT + 1)
    count = depth_image.label_parts(depth, labels, MIN_SEGMENT, sizes)
    return Scene(camera, depth, labels, sizes[:count].copy())


def scene_of(
    camera: Camera,
    depth: Depth,
    *,
    wanted: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    extent: float = np.inf,
) -> Scene:
    """Returns the segments of an image's wanted pixels (h, w; None: all) that are neither the hand's nor the table's.

    table (4,): `n·P + offset = 0` in the camera; None: the widest plane, if it is wider than `extent` [m]. Raises
    InvalidInput for images of another size than the camera's, and for depth that is not in metres.
    """
    depth = camera.check_depth(depth)
    check_metres(depth)
    where = np.ones(depth.shape, dtype=bool)
    covered = np.zeros(depth.shape, dtype=bool)
    for name, mask, pixels in (("wanted", wanted, where), ("hand", hand, covered)):
        if mask is not None:
            camera.check_size(mask, name)
            pixels[:] = mask
    if table is None and extent < np.inf:
        table = table_plane(camera, depth, ~covered, extent=extent)
    plane = np.array([0, 0, 0, np.inf]) if table is None else checks.finite(table, "table", (4,))
    filled = np.empty(depth.shape, dtype=np.float32)
    labels = np.empty(depth.shape, dtype=np.int32)
    image = np.ascontiguousarray(depth), where, covered
    depth_image.sort_pixels(camera.rays, image, np.append(plane, TABLE_WITHIN), filled, labels)
    return _divided(camera, filled, labels)


def check_metres(depth: Depth) -> None:
    """Raises InvalidInput for a depth image (h, w) that is not in metres: most of its depths are beyond any room's."""
    # A part of its pixels says that as well as all, in a hundredth of the time.
    step = max(1, min(depth.shape) // CHECKED_ROWS)
    known = depth[::step, ::step]
    known = known[(known > 0) & (known < np.inf)]
    if len(known) and np.median(known) > MAX_RANGE:
        came = f"a median of {np.median(known):.4g} (millimetres?)"
        raise InvalidInput(f"depth: expected metres, got {came}")


def table_plane(camera: Camera, depth: Depth, wanted: Mask, *, extent: float) -> Array | None:
    """Returns the plane (4,) that most of the wanted pixels (h, w) lie on, by random sample consensus. It is `n·P +
    offset = 0` with n towards the camera; None where no plane is wider than `extent` [m]."""
    pixels = np.flatnonzero(wanted & (depth > 0) & (depth < np.inf))
    if len(pixels) < 500:
        return None
    rng = np.random.default_rng(0)
    chosen = pixels[rng.choice(len(pixels), min(len(pixels), REFINE_PIXELS), replace=False)]
    z = depth.reshape(-1)[chosen].astype(np.float64)
    points = np.c_[camera.rays.reshape(-1, 2)[chosen] * z[:, None], z]
    within = TABLE_WITHIN * np.maximum(z * z, 1)  # the noise of depth grows like that
    a, b, c = (points[rng.integers(len(points), size=REGION_TRIALS)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    proper = length > 1e-6
    normals = normals[proper] / length[proper, None]
    offsets = (a[proper] * normals).sum(axis=1)
    near = np.abs(points[:TRIAL_PIXELS] @ normals.T - offsets) < within[:TRIAL_PIXELS, None]
    best = near.sum(axis=0).argmax()
    on = np.abs(points @ normals[best] - offsets[best]) < within
    for _ in range(3):
        middle = points[on].mean(axis=0)
        off = (points[on] - middle) / within[on, None]
        n = np.linalg.eigh(off.T @ off)[1][:, 0]
        on = np.abs((points - middle) @ n) < within
    on = points[on]
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(on.T))[-2:] * 12)
    if spread[0] < extent or len(on) < 0.1 * len(points):
        return None
    n = n if n @ middle < 0 else -n
    return np.append(n, -n @ middle)


def observed_points(scene: Scene, spacing: float, most: int) -> NDArray[np.void]:
    """Returns DEPTH_POINT (n,): at most so many points of the segments, `spacing` [m] apart, in random order."""
    order = np.flatnonzero(scene.labels >= 0)
    np.random.default_rng(0).shuffle(order)
    chosen = np.empty(most, dtype=np.int64)
    count = depth_image.spread(scene.camera.rays, scene.depth, order, spacing, chosen)
    points = np.zeros(count, dtype=DEPTH_POINT)
    depth_image.normals_at(scene.camera.rays, scene.depth, scene.labels, chosen[:count], points)
    return points
