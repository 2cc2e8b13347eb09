"""A camera's constant error: it stays in the world while the object turns with the palm, and touch says where it is."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import MountedCamera, Rig
from handsight.tracking.replay import Tally, replay
from handsight.tracking.tracker import Tracker

LITTLE_TURN = np.deg2rad(20)
"""A palm that turned less leaves error and pose mixed."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A `CameraCalibration` says where the camera is, by touch."""

    T_mount_camera: Array
    """(4, 4) its corrected pose in what it is fixed to."""
    correction: Array
    """(6,) shift [m] and turn [rad] from the rig's pose to this one, along the mount's axes, about `pivot`."""
    covariance: Array
    """(6, 6) of the correction."""
    pivot: Array
    """(3,) where the object was first seen, in the mount's frame [m]: there the correction is known best."""
    turned: float
    """How far the palm turned in the mount while the object was held [rad]."""

    def away_from(self, T_mount_camera: Array) -> tuple[float, float]:
        """Returns how far another pose of the camera puts what is at the pivot from there [m], and turns it [rad]."""
        away = correction_between(self.T_mount_camera, T_mount_camera, self.pivot)
        return float(np.linalg.norm(away[:3])), float(np.linalg.norm(away[3:]))


def calibrate_camera(
    observations: Iterable[Observation], rig: Rig, model: ObjectModel
) -> CameraCalibration | None:
    """Returns the constant error of the rig's camera, estimated with the object's pose while the palm turns.

    None where no object was ever touched and measured by vision; raises InvalidInput where the rig has no camera.
    """
    last = deque(calibrations(observations, Tracker(rig, model), Tally()), maxlen=1)
    return last[0] if last else None


def calibrations(
    observations: Iterable[Observation], tracker: Tracker, tally: Tally
) -> Iterator[CameraCalibration]:
    """Yields what `calibrate_camera` would answer after each observation that has something to say; `tally` is
    filled."""
    camera = tracker.rig.camera
    if camera is None:
        raise InvalidInput("camera: expected one in the rig, got none")
    first, turned = None, 0.0
    for step in replay(observations, tracker, tally):
        if not step.fingers or not step.estimate.consistent or step.T_palm_object_vision is None:
            continue
        error = tracker.vision_bias()
        if error is None or tracker.smoother is None:
            continue
        T = step.T_world_palm
        R = np.eye(3) if T is None or camera.on == "palm" else T[:3, :3]
        first = R if first is None else first
        turned = max(turned, float(np.linalg.norm(se3.rotation_log(first.T @ R))))
        yield _calibration(camera, tracker.smoother.pivot, *error, turned)


def _calibration(
    camera: MountedCamera, pivot: Array, wrong: Array, covariance: Array, turned: float
) -> CameraCalibration:
    """Returns the camera's pose, given vision's bias (6,) about the pivot and its covariance (6, 6)."""
    # Vision is off by that, so the camera is where it took it from.
    back = se3.rotation_exp(-wrong[3:])
    correction = np.concatenate([-back @ wrong[:3], -wrong[3:]])
    return CameraCalibration(
        T_mount_camera=corrected(camera.T_mount_camera, correction, pivot),
        correction=correction,
        covariance=se3.rotate_covariance(back, covariance),
        pivot=pivot,
        turned=turned,
    )


def corrected(T_mount_camera: Array, correction: Array, pivot: Array) -> Array:
    """Returns (4, 4) the camera's pose after a correction (6,): what it sees at the pivot shifts, all turns about
    it."""
    E = se3.compose(se3.rotation_exp(correction[3:]), np.zeros(3))
    E[:3, 3] = pivot + correction[:3] - E[:3, :3] @ pivot
    return np.asarray(E @ T_mount_camera)


def correction_between(T_mount_camera: Array, other: Array, pivot: Array) -> Array:
    """Returns (6,) the correction that makes one pose of a camera (4, 4) another."""
    E = other @ se3.inverse(T_mount_camera)
    return np.concatenate([se3.apply(E, pivot[None])[0] - pivot, se3.rotation_log(E[:3, :3])])
