"""Where an object is in one depth image: the region, the table and the hand, then the pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection, first_pose
from handsight.vision.object.region import Scene, scene_of, table_plane


class LocateOptions(NamedTuple):
    """`LocateOptions` say when an object is found in an image."""

    max_plane: float = 1.5  # a plane that is so many of the object's diameters wide is no part of it
    min_probability: float = 0.02
    """Of the best pose, for the object to be there: real cameras are less like what was fitted than drawn pictures
    (`experiments/sight_recognition.py` prints what is kept and claimed).
    """
    max_range: float = 20.0  # an image half of which is beyond it is in another unit [m]


LOCATE = LocateOptions()


def locate(
    model: ObjectModel,
    camera: Camera,
    depth: Depth,
    *,
    wanted: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns where the object is in a depth image (h, w) [m], 0 or NaN where there is none; nowhere, and why, if it
    is not.

    wanted, hand: (h, w) pixels it may be in (all), and those of the hand. table: (4,) `n·P + offset = 0` in the camera,
    n towards it; else the widest plane. noise: of the depth. Raises InvalidInput for images of another size than the
    camera's, and for depth that is not in metres.
    """
    extent = LOCATE.max_plane * model.diameter
    scene = scene_in(camera, depth, extent, wanted=wanted, hand=hand, table=table)
    if not len(scene.sizes):
        return _nowhere(nothing_in(scene))
    found = first_pose(model, scene, noise=noise)
    if found.probability >= LOCATE.min_probability:
        return found
    if not len(found.candidates):
        return _nowhere("no surface there is large enough to tell its shape")
    name = model.name or "the object"
    return _nowhere(
        f"the likeliest pose of {name} is right with a probability of {found.probability:.2f} only"
    )


def scene_in(
    camera: Camera,
    depth: Depth,
    extent: float,
    *,
    wanted: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
) -> Scene:
    """Returns what of an image may be an object; a plane wider than `extent` [m] is a table. Raises as `locate`
    does."""
    depth = camera.check_depth(depth)
    for name, mask in (("wanted", wanted), ("hand", hand)):
        if mask is not None:
            camera.check_size(mask, name)
    known = depth[np.isfinite(depth) & (depth > 0)]
    if len(known) and np.median(known) > LOCATE.max_range:
        guess = f"a median of {np.median(known):.4g} (millimetres?)"
        raise InvalidInput(f"depth: expected metres, got {guess}")
    where = np.ones(depth.shape, dtype=bool) if wanted is None else np.asarray(wanted, dtype=bool)
    covered = None if hand is None else np.asarray(hand, dtype=bool)
    if table is None:
        clear = np.ones(depth.shape, dtype=bool) if covered is None else ~covered
        table = table_plane(camera, depth, clear, extent=extent)
    return scene_of(camera, depth, wanted=where, hand=covered, table=table)


def nothing_in(scene: Scene) -> str:
    """Returns why a scene without parts has none."""
    if not (scene.depth > 0).any():
        return "no pixel has a depth"
    return "nothing is seen there but the table and the hand"


def _nowhere(reason: str) -> ObjectDetection:
    return ObjectDetection(
        np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), np.zeros(0), np.zeros(0, dtype=CANDIDATE), 0.0, reason
    )
