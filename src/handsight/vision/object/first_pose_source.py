"""Where first poses come from: `locate` by itself, or somebody else's detector or pose estimator in front of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.observation import Detection2D
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection
from handsight.vision.object.locate import Start, locate

MAX_DETECTIONS = 8
"""Detections of an object in an image that are searched, those with the highest scores."""


class FirstPoseSource(Protocol):
    """A `FirstPoseSource` is a function that finds an object in a depth image, without a guess; `locate` is one.

    Another one usually asks a detector or an estimator, and passes what it answers to `locate`:

    ```
    def found_by_mine(model, depth, camera, **known):
        return hs.locate(model, depth, camera, box=..., score=..., start=..., **known)
    ```
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
    mask: Mask | None = None,
    start: Start | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns the likeliest answer of `locate` of those in the boxes and masks in which the object was detected.

    `functools.partial(locate_detected, detections=...)` is a `FirstPoseSource`. Other arguments and errors are as
    `locate`'s.
    """
    best = ObjectDetection.nowhere(f"{model.name or 'the object'} was not detected in the image")
    for k, each in enumerate(sorted(detections, key=lambda each: -(each.score or 1.0))[:MAX_DETECTIONS]):
        box, pixels = (each.box, mask) if each.mask is None else (None, each.mask)
        if each.mask is not None and mask is not None:
            camera.check_size(each.mask, "mask")
            pixels = np.asarray(each.mask, dtype=bool) & np.asarray(mask, dtype=bool)
        found = locate(
            model,
            depth,
            camera,
            box=box,
            mask=pixels,
            start=start,
            score=each.score,
            hand=hand,
            table=table,
            noise=noise,
        )
        best = found if k == 0 or found.probability > best.probability else best
    return best
