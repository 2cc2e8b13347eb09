"""Poses that the first image of an object cannot tell from the one that is followed, such as half a turn of a bottle.

All images weigh them, until one has won: one image alone would often choose the wrong one, and what follows would only
refine that. Images from one side share their errors, so together they weigh as their mean.
"""

from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction.modes import apart, pose_distances
from handsight.objects import ObjectModel
from handsight.vision.object.first_pose import ObjectDetection

LEAST_WEIGHT = 0.05  # of a rival, as a share of the followed pose's; one that has less is dropped
TWIN_DISTANCE = 0.4
"""From a pose, at which another one may be that of another object like it [diameters]."""
ONE_VIEW = float(np.deg2rad(15))
"""Images between which the object turns by less before the camera are from one side [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """Other poses of a followed object, each with its log odds against the followed one."""

    T_object_rivals: Array
    """(k, 4, 4) the rivals, in the frame of the object at the followed pose."""
    earlier: Array
    """(k,) the log odds by images from other sides."""
    here: Array
    """(k,) their mean over the images from this side."""
    images: int
    """How many these are."""
    R_camera_object: Array
    """(3, 3) the followed pose's rotation in the first of them."""

    @classmethod
    def of(cls, model: ObjectModel, found: ObjectDetection, followed: int) -> "Rivals":
        """Returns the rivals of one of the poses that were found in an image, by its number; one far from it is another
        object like it."""
        T = found.Ts_camera_object[followed]
        shift, _ = pose_distances(model, found.Ts_camera_object, T)
        others = shift < TWIN_DISTANCE * model.diameter
        others[followed] = False
        Ts = se3.inverse(T) @ found.Ts_camera_object[others]
        log_odds = np.log(np.maximum(found.weights[others], 1e-300) / found.weights[followed])
        return cls(Ts, np.zeros(len(Ts)), log_odds, 1, T[:3, :3]).likely()

    @property
    def log_odds(self) -> Array:
        """(k,) of each against the followed pose, by all images."""
        return self.earlier + self.here

    def __len__(self) -> int:
        """Returns the number of rivals."""
        return len(self.here)

    def weighed(self, T_camera_object: Array, Ts_camera_rivals: Array, gains: Array) -> "Rivals":
        """Returns the rivals after an image that shows the followed pose (4, 4) and each of them (k, 4, 4), in which
        their log odds are `gains` (k,)."""
        R_camera_object = T_camera_object[:3, :3]
        turn = np.linalg.norm(se3.rotation_log(R_camera_object @ self.R_camera_object.T))
        Ts = se3.inverse(T_camera_object) @ Ts_camera_rivals
        if turn > ONE_VIEW:
            return Rivals(Ts, self.log_odds, gains, 1, R_camera_object)
        images = self.images + 1
        mean = self.here + (gains - self.here) / images
        return replace(self, T_object_rivals=Ts, here=mean, images=images)

    @property
    def winner(self) -> int | None:
        """The number of a rival that has won against the followed pose; None: none has."""
        if not len(self) or self.log_odds.max() < -np.log(LEAST_WEIGHT):
            return None
        return int(self.log_odds.argmax())

    def against(self, number: int) -> "Rivals":
        """Returns the rivals of one of them, which is followed from now on."""
        others = np.arange(len(self)) != number
        T_rival = self.T_object_rivals[number]
        Ts = se3.inverse(T_rival) @ self.T_object_rivals[others]
        R = self.R_camera_object @ T_rival[:3, :3]
        earlier = self.earlier[others] - self.earlier[number]
        return Rivals(Ts, earlier, self.here[others] - self.here[number], self.images, R).likely()

    def reason(self, model: ObjectModel) -> str:
        """Returns how far the rivals are from the followed pose, for a person; empty where there are none."""
        return apart(model, self.T_object_rivals, np.eye(4), "images")

    def likely(self) -> "Rivals":
        """Returns those that have not lost."""
        kept = self.log_odds >= np.log(LEAST_WEIGHT)
        Ts = self.T_object_rivals[kept]
        return replace(self, T_object_rivals=Ts, earlier=self.earlier[kept], here=self.here[kept])


NO_RIVALS = Rivals(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0), 0, np.eye(3))
