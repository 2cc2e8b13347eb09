"""Where first poses come from: `locate` by itself, or somebody else's detector or pose estimator in front of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Detection2D
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection
from handsight.vision.object.locate import Start, locate, search_mask

MAX_DETECTIONS = 8  # detections of an object in an image that are searched, those with the highest scores


class FirstPoseSource(Protocol):
    """A `FirstPoseSource` is a function that finds an object in a depth image, without a guess; `locate` is one.

    Another one usually asks a detector or an estimator, and passes what it answers to `locate` as box, mask, score or
    start, with the keywords that it was called with.
    """

    def __call__(
        self,
        model: ObjectModel,
        depth: Depth,
        camera: Camera,
        /,
        *,
        hand: Mask | None = None,
        table: Array | None = None,
        noise: DepthNoise = STRUCTURED_LIGHT,
    ) -> ObjectDetection:
        """Returns the poses that the object may have, the likeliest first; none, with the reason, if it is not there.

        depth (h, w) [m], 0 or NaN where there is none; hand (h, w): pixels of the hand; table (4,): `n·P + offset = 0`
        in the camera; noise: of the depth.
        """


def locate_detected(
    model: ObjectModel,
    depth: Depth,
    camera: Camera,
    *,
    detections: Sequence[Detection2D],
    elsewhere: FirstPoseSource | None = None,
    mask: Mask | None = None,
    start: Start | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns the likeliest answer of `locate` of those in the boxes and masks in which the object was detected.

    Detections that cannot be of the camera's images are left out. elsewhere: finds the object where none of them is
    right. Other arguments and errors are as `locate`'s; with `functools.partial` it is a `FirstPoseSource`.
    """
    located = partial(locate, model, depth, camera, start=start, hand=hand, table=table, noise=noise)
    found = list[ObjectDetection]()
    for each in sorted(detections, key=lambda each: -(each.score or 1.0))[:MAX_DETECTIONS]:
        try:
            inside = search_mask(camera, each.box, each.mask)
        except InvalidInput:
            continue
        if mask is not None:
            inside = mask if inside is None else inside & np.asarray(mask, dtype=bool)
        found.append(located(mask=inside, score=each.score))
    best = max(found, key=lambda each: each.probability, default=None)
    if elsewhere is not None and (best is None or best.reason is not None):
        return elsewhere(model, depth, camera, hand=hand, table=table, noise=noise)
    return best or ObjectDetection.nowhere(f"{model.name or 'the object'} was not detected in the image")
