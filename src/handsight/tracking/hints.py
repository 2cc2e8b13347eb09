"""Where other programs have last had the object in a camera's images, as a source of first poses for its tracker."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Detection2D, Observation
from handsight.vision import FirstPoseSource, ObjectDetection, locate, locate_detected
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.locate import search_mask


class HintOptions(NamedTuple):
    """`HintOptions` say how long hints count."""

    max_age: float = 1.0  # after which they say nothing of an image, as object or camera may have moved [s]


HINTS = HintOptions()


@dataclass(frozen=True, slots=True, eq=False)
class SearchHints:
    """`SearchHints` are the last detections of an object and the last pose of it by another estimator.

    They are a `FirstPoseSource`: the object is first searched where they have it, then in the entire image.
    """

    label: str
    """What the detector calls the object."""
    elsewhere: FirstPoseSource = locate
    """Finds the object where they say nothing, or nothing that is right."""
    detections: tuple[Detection2D, ...] = ()
    detected_at: float = -np.inf
    """Stamp of the detections [s]."""
    T_camera_object: Array | None = None
    estimated_at: float = -np.inf
    """Stamp of the pose [s]."""

    def after(self, observation: Observation) -> "SearchHints":
        """Returns the hints with those of an observation, and without those that are too old."""
        now, hints, found = observation.stamp, self, list[Detection2D]()
        if observation.detections is not None:
            found += (each for each in observation.detections if each.label in ("", self.label))
        if observation.mask is not None:
            found += mask_of(observation.mask, self.label)
        if observation.detections is not None or observation.mask is not None:
            hints = replace(hints, detections=tuple(found), detected_at=now)
        vision = observation.vision
        if vision is not None and vision.frame == "camera":
            hints = replace(hints, T_camera_object=vision.T_frame_object, estimated_at=now)
        if hints.detections and abs(now - hints.detected_at) > HINTS.max_age:
            hints = replace(hints, detections=())
        if hints.T_camera_object is not None and abs(now - hints.estimated_at) > HINTS.max_age:
            hints = replace(hints, T_camera_object=None)
        return hints

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
        """Returns where the object is in a depth image, as a `FirstPoseSource` does."""
        start, detections = self.T_camera_object, [each for each in self.detections if _fits(each, camera)]
        if detections:
            found = locate_detected(
                model,
                depth,
                camera,
                detections=detections,
                start=start,
                hand=hand,
                table=table,
                noise=noise,
            )
            if found.reason is None:
                return found
        if start is not None:
            found = locate(model, depth, camera, start=start, hand=hand, table=table, noise=noise)
            if found.reason is None or self.elsewhere is locate:
                return found
        return self.elsewhere(model, depth, camera, hand=hand, table=table, noise=noise)


def mask_of(labels: NDArray[np.integer], label: str) -> list[Detection2D]:
    """Returns where a mask image (h, w) has an object: where it has the object's number, or its only one but 0.

    The list is empty where it does not have the object.
    """
    number = int(label) if label.isdecimal() and len(label) < 10 else None
    mask = labels == number if number is not None and number > 0 else np.zeros(labels.shape, dtype=bool)
    if not mask.any():
        mask = labels != 0
        if not mask.any() or (labels[mask] != labels[mask].flat[0]).any():
            return []
    return [Detection2D(label, mask=mask)]


def _fits(detection: Detection2D, camera: Camera) -> bool:
    """Returns whether a detection can be of the camera's images."""
    try:
        search_mask(camera, detection.box, detection.mask)
    except InvalidInput:
        return False
    return True
