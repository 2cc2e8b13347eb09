"""A camera's pose, calibrated from a recording: by touch, or by the hand in its depth images.

By touch: contacts measure the object's pose in the palm, and the camera's constant error stays in the world while the
object turns with the palm. By the hand: each image measures the palm's pose in the camera, and the robot knows it in
the world.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.replay import Tally, replay
from handsight.tracking.tracker import Tracker
from handsight.vision.palm.hand_in_image import HandInImage
from handsight.vision.palm.palm_detector import PalmNotFound

LITTLE_TURN = np.deg2rad(20)
"""With a palm that turned less than this [rad], the camera's error cannot be told from the object's pose."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibratedCamera:
    """The pose of a camera in its mount, as a correction of the rig's."""

    T_mount_camera: Array
    """(4, 4) the corrected pose."""
    correction: Array
    """(6,) shift [m] and rotation [rad] from the rig's pose to this one, along the mount's axes, about `pivot`."""
    covariance: Array
    """(6, 6) of the correction."""
    pivot: Array
    """(3,) where the object or the hand was, in the mount's frame [m]: there the correction is known best."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraCalibration(CalibratedCamera):
    """A camera's pose by touch."""

    turned: float
    """How far the palm turned in the mount while the object was in hand [rad]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandCalibration(CalibratedCamera):
    """A camera's pose by the hand in its images.

    Its covariance is not divided by the number of views, because they have the errors of camera and joints in common.
    """

    spread: Array
    """(6,) root mean square of the views about their mean [m, rad]."""
    views: int
    """How many views agree."""
    images: int
    """How many images were used."""


def calibrate_camera(
    observations: Iterable[Observation], rig: Rig, model: ObjectModel
) -> CameraCalibration | None:
    """Returns the pose of the rig's camera, estimated together with the object's pose while the palm turns.

    None where no object was both touched and measured by vision; raises InvalidInput where the rig has no camera.
    """
    last = deque(calibrations(observations, Tracker(rig, model), Tally()), maxlen=1)
    return last[0] if last else None


def calibrations(
    observations: Iterable[Observation], tracker: Tracker, tally: Tally
) -> Iterator[CameraCalibration]:
    """Yields the calibration by touch after each observation that adds to it; `tally` is filled as in `replay`."""
    camera = tracker.rig.camera
    if camera is None:
        raise InvalidInput("camera: expected one in the rig, got none")
    first = None
    turned = 0.0
    for step in replay(observations, tracker, tally):
        if not step.fingers or not step.estimate.consistent or step.T_palm_object_vision is None:
            continue
        error = tracker.vision_bias()
        if error is None or tracker.smoother is None:
            continue
        (bias, covariance), pivot, T = error, tracker.smoother.pivot, step.T_world_palm
        R = np.eye(3) if T is None or camera.on == "palm" else T[:3, :3]
        first = R if first is None else first
        turned = max(turned, float(np.linalg.norm(se3.rotation_log(first.T @ R))))
        # The correction is the inverse of vision's bias.
        back = se3.rotation_exp(-bias[3:])
        correction = np.concatenate([-back @ bias[:3], -bias[3:]])
        yield CameraCalibration(
            T_mount_camera=corrected(camera.T_mount_camera, correction, pivot),
            correction=correction,
            covariance=se3.rotate_covariance(back, covariance),
            pivot=pivot,
            turned=turned,
        )


def corrected(T_mount_camera: Array, correction: Array, pivot: Array) -> Array:
    """Returns (4, 4) a camera's pose after a correction (6,), which shifts what is at the pivot and turns it there."""
    E = se3.compose(se3.rotation_exp(correction[3:]), np.zeros(3))
    E[:3, 3] = pivot + correction[:3] - E[:3, :3] @ pivot
    return np.asarray(E @ T_mount_camera)


def correction_between(T_mount_camera: Array, other: Array, pivot: Array) -> Array:
    """Returns (6,) the correction that takes one pose of a camera (4, 4) to another."""
    E = other @ se3.inverse(T_mount_camera)
    return np.concatenate([se3.apply(E, pivot[None])[0] - pivot, se3.rotation_log(E[:3, :3])])


VIEW_PERIOD = 0.25  # least time between images that are used [s]
MAX_VIEWS = 60  # most images that are used
MIN_VIEWS = 3  # fewest views that must agree
MAX_SHIFT = 0.015  # a view farther from the median one is an outlier [m]
MAX_TURN = float(np.deg2rad(6))  # the same of its rotation [rad]


class HandViews:
    """Gathers views of the hand from the images of a recording, while they pass, for a calibration."""

    def __init__(self, rig: Rig) -> None:
        """Nothing is gathered if the rig's camera has no intrinsics, or its hand no shapes."""
        self._rig = rig
        self._views = list[tuple[Array, Array, Array]]()
        """Of each view: T_mount_camera (4, 4), the hand's middle in the mount (3,) [m], and a covariance (6, 6)."""
        self._last = -np.inf
        self.images = 0
        self.refusals = Counter[str]()
        """Stamp of the last image that was used [s], their number, and why the palm was not detected in some."""
        camera = rig.camera
        self._hand = HandInImage(rig)
        known = camera is not None and camera.intrinsics is not None and camera.size is not None
        self._camera = Camera.of(camera) if known else None

    def watched(self, observations: Iterable[Observation]) -> Iterator[Observation]:
        """Yields the same observations, and evaluates their depth images as they pass."""
        for observation in observations:
            self._watch(observation)
            yield observation

    def _watch(self, observation: Observation) -> None:
        depth = observation.depth
        joints = observation.joint_positions
        camera = self._rig.camera
        if depth is None or self._camera is None or camera is None:
            return
        T_mount_palm = np.eye(4) if camera.on == "palm" else observation.T_world_palm
        if T_mount_palm is None:
            return
        if self.images >= MAX_VIEWS or observation.stamp < self._last + VIEW_PERIOD:
            return
        sigmas = camera.sigma_position_constant, camera.sigma_rotation_constant
        T_camera_palm = se3.inverse(camera.T_mount_camera) @ T_mount_palm
        hand = self._hand.placed(joints)
        found = self._hand.detected(self._camera, depth, joints, T_camera_palm, sigmas)
        if found is None or hand is None:  # joints that are missing are reported elsewhere
            return
        self._last, self.images = observation.stamp, self.images + 1
        if isinstance(found, PalmNotFound):
            self.refusals[found.reason] += 1
            return
        T_mount_camera = T_mount_palm @ se3.inverse(found.T_camera_palm)
        at_middle = GaussianPose(found.T_camera_palm, found.covariance).at_point(hand.middle)
        pivot = hand.middle_at(T_mount_palm)
        self._views.append((T_mount_camera, pivot, at_middle.transformed(T_mount_camera).covariance))

    def calibration(self) -> HandCalibration | None:
        """Returns the mean of the views that agree with their median; None if those are fewer than `min_views`."""
        if len(self._views) < MIN_VIEWS or self._rig.camera is None:
            return None
        Ts, pivots, covariances = (np.stack(part) for part in zip(*self._views, strict=True))
        pivot = np.median(pivots, axis=0)
        T_rig = self._rig.camera.T_mount_camera
        corrections = np.stack([correction_between(T_rig, T, pivot) for T in Ts])
        away = np.abs(corrections[:, None] - corrections)
        shift = away[..., :3].max(axis=2)
        turn = away[..., 3:].max(axis=2)
        far = np.maximum(shift / MAX_SHIFT, turn / MAX_TURN)
        agree = far[np.median(far, axis=1).argmin()] < 1
        if agree.sum() < MIN_VIEWS:
            return None
        mean = corrections[agree].mean(axis=0)
        return HandCalibration(
            T_mount_camera=corrected(T_rig, mean, pivot),
            correction=mean,
            covariance=covariances[agree].mean(axis=0),
            pivot=pivot,
            spread=np.sqrt(((corrections[agree] - mean) ** 2).mean(axis=0)),
            views=int(agree.sum()),
            images=self.images,
        )
