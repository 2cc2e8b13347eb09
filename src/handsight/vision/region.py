"""Where in a depth image an object may be: a box or all of it, without the table, in connected parts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import depth_image
from handsight._kernels.look_score import HAND, OUT, TABLE
from handsight._kernels.sight_records import SEEN
from handsight.checks import Array, Mask
from handsight.vision.camera import Depth, PinholeCamera

TABLE_WITHIN = 0.010
"""What is nearer to a table's plane is the table's [m]."""
TRIALS = 200
LEAST_PART = 40
"""Pixels of a part that is looked at."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A depth image, and what of it may be the object."""

    camera: PinholeCamera
    depth: Depth
    """(h, w) [m]; 0 where there is none."""
    labels: NDArray[np.int32]
    """(h, w) number of the connected part, `TABLE`, `HAND`, or `OUT`."""
    sizes: Array
    """(p,) pixels of each part."""


def scene_of(
    camera: PinholeCamera, depth: Depth, *, wanted: Mask, hand: Mask | None = None, table: Array | None = None
) -> Scene:
    """The parts of an image's wanted pixels (h, w) that are neither hand nor table (4: normal, offset)."""
    known = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    here = wanted & (known > 0)
    if hand is not None:
        here = here & ~hand
    if table is not None:
        n = table[:3].astype(np.float32)
        height = known * (camera.rays[..., 0] * n[0] + camera.rays[..., 1] * n[1] + n[2]) + np.float32(
            table[3]
        )
        within = TABLE_WITHIN * np.maximum(known * known, 1)
        here, on_table = here & (height > within), (known > 0) & (np.abs(height) <= within)
    labels = np.empty(known.shape, dtype=np.int32)
    count = depth_image.label_parts(known, here, labels)
    sizes = np.bincount(labels[labels >= 0], minlength=max(count, 1))
    numbers = np.where(sizes >= LEAST_PART, np.cumsum(sizes >= LEAST_PART) - 1, OUT)
    labels = np.where(labels >= 0, numbers[labels], OUT).astype(np.int32)
    if table is not None:
        labels[on_table] = TABLE
    if hand is not None:
        labels[hand] = HAND
    return Scene(camera, known, labels, sizes[sizes >= LEAST_PART].astype(np.float64))


def table_plane(
    camera: PinholeCamera, depth: Depth, wanted: Mask, *, extent: float, seed: int = 0
) -> Array | None:
    """The plane (4,) that most of the wanted pixels lie on and that is wider than `extent` [m]; None: there is none.

    Normal towards the camera, `n·P + offset = 0` on it (random sample consensus).
    """
    rows, columns = np.nonzero(wanted & np.isfinite(depth) & (depth > 0))
    if len(rows) < 500:
        return None
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(rows), min(len(rows), 3000), replace=False)
    z = depth[rows[chosen], columns[chosen]].astype(np.float64)
    points = np.c_[camera.rays[rows[chosen], columns[chosen]] * z[:, None], z]
    within = TABLE_WITHIN * np.maximum(z * z, 1)  # as depth is known
    a, b, c = (points[rng.integers(len(points), size=TRIALS)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals, a = normals[length > 1e-6] / length[length > 1e-6, None], a[length > 1e-6]
    near = np.abs(points @ normals.T - (a * normals).sum(axis=1)) < within[:, None]
    on = near[:, near.sum(axis=0).argmax()]
    for _ in range(3):
        middle = points[on].mean(axis=0)
        n = np.linalg.svd((points[on] - middle) / within[on, None], full_matrices=False)[2][2]
        on = np.abs((points - middle) @ n) < within
    on = points[on]
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((on - on.mean(axis=0)).T))[-2:] * 12)
    if spread[0] < extent or len(on) < 0.1 * len(points):
        return None
    n = n if n @ middle < 0 else -n
    return np.append(n, -n @ middle)


def seen_points(scene: Scene, spacing: float, most: int, seed: int = 0) -> NDArray[np.void]:
    """SEEN (n,): points of the scene's parts about `spacing` [m] apart, at most so many, in random order."""
    rows, columns = np.nonzero(scene.labels >= 0)
    z = scene.depth[rows, columns].astype(np.float64)
    points = np.c_[scene.camera.rays[rows, columns] * z[:, None], z]
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(points))
    cells = np.floor(points[order] / spacing).astype(np.int64)
    key = (cells[:, 0] * 1_000_003 + cells[:, 1]) * 1_000_003 + cells[:, 2]
    first = np.sort(np.unique(key, return_index=True)[1])
    chosen = order[first[:most]]
    seen = np.zeros(len(chosen), dtype=SEEN)
    pixels = np.stack([rows[chosen], columns[chosen]], axis=1)
    depth_image.look_at(scene.camera.rays, scene.depth, scene.labels, pixels, seen)
    return seen
