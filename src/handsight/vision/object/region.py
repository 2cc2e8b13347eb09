"""Where in a depth image an object may be: a box or all of it, without the table, in connected parts."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight._kernels.image import depth_image
from handsight._kernels.image.vision_records import DEPTH_POINT
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask


class RegionOptions(NamedTuple):
    """`RegionOptions` say how an image is divided into table and parts."""

    table_within: float = 0.010  # what is nearer to a table's plane is the table's [m]
    trials: int = 200  # planes through three points each
    trial_pixels: int = 750  # pixels that choose among them
    refine_pixels: int = 3000  # pixels that place the chosen one
    min_part: int = 40  # pixels of a part that is used


REGION = RegionOptions()

NO_TABLE = np.array([0, 0, 0, np.inf])
"""All is above it."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A `Scene` is a depth image, and what of it may be the object."""

    camera: Camera
    depth: Depth
    """(h, w) [m]; 0 where there is none."""
    labels: NDArray[np.int32]
    """(h, w) number of the connected part, `TABLE`, `HAND`, or `OUT`."""
    sizes: Array
    """(p,) pixels of each part."""


def scene_of(
    camera: Camera, depth: Depth, *, wanted: Mask, hand: Mask | None = None, table: Array | None = None
) -> Scene:
    """Returns the parts of an image's wanted pixels (h, w) that are neither hand nor table (4: normal, offset)."""
    known, labels = np.empty(depth.shape, dtype=np.float32), np.empty(depth.shape, dtype=np.int32)
    masks = wanted, np.zeros(depth.shape, dtype=bool) if hand is None else hand
    image = depth.astype(np.float32, copy=False), *masks
    plane = np.append(NO_TABLE if table is None else table, REGION.table_within)
    depth_image.sort_pixels(camera.rays, tuple(map(np.ascontiguousarray, image)), plane, known, labels)
    sizes = np.empty(labels.size // REGION.min_part + 1)
    count = depth_image.label_parts(known, labels, REGION.min_part, sizes)
    return Scene(camera, known, labels, sizes[:count].copy())


def table_plane(camera: Camera, depth: Depth, wanted: Mask, *, extent: float, seed: int = 0) -> Array | None:
    """Returns the plane (4,) that most of the wanted pixels lie on and that is wider than `extent` [m]; None: there
    is none.

    Normal towards the camera, `n·P + offset = 0` on it (random sample consensus).
    """
    pixels = np.flatnonzero(wanted & (depth > 0) & (depth < np.inf))
    if len(pixels) < 500:
        return None
    rng = np.random.default_rng(seed)
    chosen = pixels[rng.choice(len(pixels), min(len(pixels), REGION.refine_pixels), replace=False)]
    z = depth.reshape(-1)[chosen].astype(np.float64)
    points = np.c_[camera.rays.reshape(-1, 2)[chosen] * z[:, None], z]
    within = REGION.table_within * np.maximum(z * z, 1)  # as depth is known
    a, b, c = (points[rng.integers(len(points), size=REGION.trials)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals, a = normals[length > 1e-6] / length[length > 1e-6, None], a[length > 1e-6]
    offsets, some = (a * normals).sum(axis=1), slice(REGION.trial_pixels)
    near = np.abs(points[some] @ normals.T - offsets) < within[some, None]
    best = near.sum(axis=0).argmax()
    on = np.abs(points @ normals[best] - offsets[best]) < within
    for _ in range(3):
        middle = points[on].mean(axis=0)
        off = (points[on] - middle) / within[on, None]
        n = np.linalg.eigh(off.T @ off)[1][:, 0]
        on = np.abs((points - middle) @ n) < within
    on = points[on]
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((on - on.mean(axis=0)).T))[-2:] * 12)
    if spread[0] < extent or len(on) < 0.1 * len(points):
        return None
    n = n if n @ middle < 0 else -n
    return np.append(n, -n @ middle)


def observed_points(scene: Scene, spacing: float, most: int, seed: int = 0) -> NDArray[np.void]:
    """Returns DEPTH_POINT (n,): points of the scene's parts about `spacing` [m] apart, at most so many, in random
    order."""
    order = np.flatnonzero(scene.labels >= 0)
    np.random.default_rng(seed).shuffle(order)
    chosen = np.empty(most, dtype=np.int64)
    count = depth_image.spread(scene.camera.rays, scene.depth, order, spacing, chosen)
    points = np.zeros(count, dtype=DEPTH_POINT)
    depth_image.normals_at(scene.camera.rays, scene.depth, scene.labels, chosen[:count], points)
    return points
