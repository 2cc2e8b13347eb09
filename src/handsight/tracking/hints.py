"""Where other programs have last had the object in a camera's images, as a source of first poses for its tracker."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.observation import Detection2D, Observation
from handsight.vision import FirstPoseSource, locate, locate_detected

MAX_AGE = 1.0  # after which they say nothing of an image, as object or camera may have moved [s]


@dataclass(frozen=True, slots=True, eq=False)
class SearchHints:
    """The last detections of an object and the last pose of it by another estimator.

    The object is first searched where they have it, then in the entire image.
    """

    label: str
    """What the detector calls the object."""
    elsewhere: FirstPoseSource = locate
    """Finds the object where they say nothing, or nothing that is right."""
    detections: tuple[Detection2D, ...] = ()
    T_camera_object: Array | None = None
    stamps: tuple[float, float] = (-np.inf, -np.inf)
    """Of the detections and of the pose [s]."""

    def after(self, observation: Observation) -> "SearchHints":
        """Returns the hints with those of an observation, and without those that are too old."""
        now, vision, new = observation.stamp, observation.vision, observation.detections
        detected, estimated = self.stamps
        detections, T = self.detections, self.T_camera_object
        if new is not None or observation.mask is not None:
            found = [each for each in new or () if each.label in ("", self.label)]
            found += [] if observation.mask is None else mask_of(observation.mask, self.label)
            detections = tuple(found)
            detected = now
        if vision is not None and vision.frame == "camera":
            T = vision.T_frame_object
            estimated = now
        detections = detections if abs(now - detected) <= MAX_AGE else ()
        T = T if abs(now - estimated) <= MAX_AGE else None
        return SearchHints(self.label, self.elsewhere, detections, T, (detected, estimated))

    def source(self) -> FirstPoseSource:
        """Returns what searches the object where the hints have it, then where `elsewhere` finds it."""
        T = self.T_camera_object
        places = self.detections or (() if T is None else (Detection2D(),))
        return partial(locate_detected, detections=places, elsewhere=self.elsewhere, start=T)


def mask_of(labels: NDArray[np.integer], label: str) -> list[Detection2D]:
    """Returns where a mask image (h, w) has an object, if it does: at the object's number, or at its only one but 0."""
    number = int(label) if label.isdecimal() and len(label) < 10 else None
    mask = labels == number if number is not None and number > 0 else np.zeros(labels.shape, dtype=bool)
    if not mask.any():
        mask = labels != 0
        if not mask.any() or (labels[mask] != labels[mask].flat[0]).any():
            return []
    return [Detection2D(label, mask=mask)]
