"""Where first poses come from: `locate` by itself, or somebody else's detector or pose estimator in front of it."""

from __future__ import annotations

from typing import Protocol

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection


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
