"""Where a camera is, from the hand in its depth images: each says where the palm is, and the robot where that is."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.camera_calibration import corrected, correction_between
from handsight.vision.depth_noise import PRESETS
from handsight.vision.palm.hand_in_image import HandInImage
from handsight.vision.palm.palm_detector import PalmDetection, PalmNotFound, detect_palm


class HandViewOptions(NamedTuple):
    """`HandViewOptions` say which pictures of a recording are used to calibrate the camera."""

    period: float = 0.25  # between pictures that are used [s]
    max_views: int = 60  # pictures that are used
    min_views: int = 3  # views that must agree


HAND_VIEWS = HandViewOptions()

SPREAD = 0.015, float(np.deg2rad(6))
"""Views that are farther from the middle one than this are wrong, not noisy [m, rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class HandCalibration:
    """A `HandCalibration` says where the camera is, by the hand that it saw."""

    T_mount_camera: Array
    """(4, 4) its corrected pose in what it is fixed to."""
    correction: Array
    """(6,) shift [m] and turn [rad] from the rig's pose to this one, along the mount's axes, about `pivot`."""
    covariance: Array
    """(6, 6) of the correction; what is constant in it, of camera and joints, is not averaged away."""
    pivot: Array
    """(3,) where the hand was, in the mount's frame [m]."""
    spread: Array
    """(6,) of the views about their mean, root mean square [m, rad]."""
    views: int
    """That agree."""
    images: int
    """Pictures."""


class HandViews:
    """A `HandViews` is what the pictures of a recording say of the camera's pose, gathered while they pass."""

    def __init__(self, rig: Rig) -> None:
        """The rig as it is believed; without intrinsics, or shapes of the hand, nothing is gathered."""
        self._rig, self._views = rig, list[tuple[Array, Array, Array]]()
        self._last, self.images, self.refusals = -np.inf, 0, dict[str, int]()
        self._camera: Camera | None = None
        self._hand = HandInImage(rig)
        camera = rig.camera
        if camera is not None and camera.intrinsics is not None and camera.size is not None:
            self._camera = Camera.of(camera)

    def watched(self, observations: Iterable[Observation]) -> Iterator[Observation]:
        """Yields the same observations; their depth images are looked at as they pass."""
        for observation in observations:
            self._watch(observation)
            yield observation

    def _watch(self, observation: Observation) -> None:
        depth, camera = observation.depth, self._rig.camera
        if depth is None or self._camera is None or camera is None:
            return
        T_mount_palm = np.eye(4) if camera.on == "palm" else observation.T_world_palm
        if T_mount_palm is None:
            return
        if self.images >= HAND_VIEWS.max_views or observation.stamp < self._last + HAND_VIEWS.period:
            return
        hand = self._hand.placed(observation.joint_positions)
        if hand is None:  # joints that are missing are told of elsewhere
            return
        self._last, self.images = observation.stamp, self.images + 1
        detection = detect_palm(
            self._camera,
            depth,
            hand,
            se3.inverse(camera.T_mount_camera) @ T_mount_palm,
            sigma_position=camera.sigma_position_constant,
            sigma_rotation=camera.sigma_rotation_constant,
            noise=PRESETS[camera.depth_camera],
        )
        if isinstance(detection, PalmNotFound):
            self.refusals[detection.reason] = self.refusals.get(detection.reason, 0) + 1
            return
        T_mount_camera = T_mount_palm @ se3.inverse(detection.T_camera_palm)
        pivot = se3.apply(T_mount_palm, hand.middle[None])[0]
        covariance = _at(detection, detection.T_camera_palm[:3, :3] @ hand.middle, T_mount_camera[:3, :3])
        self._views.append((T_mount_camera, pivot, covariance))

    def calibration(self) -> HandCalibration | None:
        """Returns the mean of the views that agree with their middle one; None where fewer than
        `HAND_VIEWS.min_views` do."""
        if len(self._views) < HAND_VIEWS.min_views or self._rig.camera is None:
            return None
        Ts, pivots, covariances = (np.stack(part) for part in zip(*self._views, strict=True))
        pivot, believed = np.median(pivots, axis=0), self._rig.camera.T_mount_camera
        corrections = np.stack([correction_between(believed, T, pivot) for T in Ts])
        away = np.abs(corrections[:, None] - corrections)
        far = np.maximum(away[..., :3].max(axis=2) / SPREAD[0], away[..., 3:].max(axis=2) / SPREAD[1])
        agree = far[np.median(far, axis=1).argmin()] < 1
        if agree.sum() < HAND_VIEWS.min_views:
            return None
        mean = corrections[agree].mean(axis=0)
        spread = corrections[agree] - mean
        return HandCalibration(
            T_mount_camera=corrected(believed, mean, pivot),
            correction=mean,
            covariance=covariances[agree].mean(axis=0),
            pivot=pivot,
            spread=np.sqrt((spread**2).mean(axis=0)),
            views=int(agree.sum()),
            images=self.images,
        )


def _at(detection: PalmDetection, arm: Array, R_mount_camera: Array) -> Array:
    """Returns (6, 6) a seen hand's covariance at its middle, `arm` from the palm's origin, along the mount's axes."""
    to_middle = se3.point_jacobian(arm)
    return se3.rotate_covariance(R_mount_camera, to_middle @ detection.covariance @ to_middle.T)
