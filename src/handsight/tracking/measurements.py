"""Vision as measurements of the object's pose; a gate rejects those that are implausible."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import MountedCamera, Rig
from handsight.tracking.camera_from_palm import CameraFromPalm, HandView
from handsight.tracking.smoother import STILL, Motion, PoseBiasSmoother

Mount = Literal["world", "palm"]


CHI2 = 27.9
"""χ² of six numbers that one in ten thousand exceeds: beyond it a pose is wrong, or the object has moved."""
MAX_REJECTED = 5  # so many rejected poses in a row say that the object has moved
LEAST_SIGMA = 1e-6
"""Of a camera's errors, even of one that has none [m, rad]: a covariance must be invertible."""

UNINFORMATIVE = np.array([0.3**2] * 3 + [1.0] * 3)
"""Variances of a pose before anything is known (δp [m²], δθ [rad²])."""
EYE, EYE_6 = np.eye(4), np.eye(6)


@dataclass(frozen=True, slots=True, eq=False)
class VisionUpdate:
    """Updates a smoother by poses from vision, and counts those that it rejects.

    The poses are transformed to the camera's mount (the world or the palm), because vision's bias is constant there.
    """

    rig: Rig
    """Its camera may be None: then vision's poses must be in the world or the palm."""
    model: ObjectModel
    mount: Mount | None = None
    """The frame in which vision's bias is constant: that of the first measurement."""
    unplaced: int = 0
    """How many measurements had no T_world_palm to place them."""
    rejected: int = 0
    """How many measurements were beyond the gate."""
    rejected_in_a_row: int = 0
    """How many of the last measurements were beyond the gate."""
    camera_from_palm: CameraFromPalm = field(default_factory=CameraFromPalm)
    """The camera's constant error, measured by the hand in its images."""
    last: tuple[GaussianPose, Array, Motion] | None = None
    """The last measured pose in the mount, T_mount_palm (4, 4) at that instant, and how the palm moved."""
    chi2: float | None = None
    """χ² of the last measurement, given those before: a number with six degrees of freedom; None before the second."""

    @property
    def camera(self) -> MountedCamera:
        """The rig's camera, or one with the default errors."""
        return self.rig.camera or MountedCamera()

    def updated(
        self,
        observation: Observation,
        smoother: PoseBiasSmoother | None,
        T_world_palm: Array | None,
        motion: Motion = STILL,
        T_then_now: Array = EYE,
    ) -> tuple["VisionUpdate", PoseBiasSmoother | None]:
        """Returns this and the smoother after an observation; both unchanged where it has no pose.

        `motion` is that of T_world_palm (4, 4), where the object is in the hand. `T_then_now` (4, 4): the palm now in
        the palm at the time of a pose, where the object has stayed in the world.
        Raises InvalidInput for a pose in the camera's frame if the rig has no camera, or for one far from any hand.
        """
        measured = observation.vision
        if measured is None:
            return self, smoother
        mount = self._mount_of(measured)
        after = self if self.mount is not None else replace(self, mount=mount)
        T_mount_palm = T_then_now if mount == "palm" else T_world_palm
        if mount != after.mount or T_mount_palm is None:
            return replace(after, unplaced=self.unplaced + 1), smoother
        if mount == "palm":
            motion = STILL
        pose, gain = self._in_mount(measured), self._drift_gain(measured)
        position_palm = (se3.inverse(T_mount_palm) @ pose.T_a_b)[:3, 3]
        checks.position(position_palm, "vision: the object's place in the palm", (3,))
        motion = motion._replace(drift_gain=gain * motion.drift_gain)
        known = pose, T_mount_palm, motion
        if smoother is not None:
            after, smoother = after._gated(smoother, *known)
            if after.rejected_in_a_row:
                return after, smoother
            after = replace(after, last=known)
            if smoother.is_near:
                return after, smoother
        after = replace(after, last=known)
        return replace(after, rejected_in_a_row=0), after.afresh()

    def palm_detected(
        self, view: HandView, smoother: PoseBiasSmoother | None
    ) -> tuple["VisionUpdate", PoseBiasSmoother | None]:
        """Returns this and the smoother after the palm was detected; the smoother changes if a view is confirmed."""
        before = self.camera_from_palm.confirmed
        after = replace(self, camera_from_palm=self.camera_from_palm.updated(view))
        confirmed = after.camera_from_palm.confirmed
        if confirmed == before or smoother is None:
            return after, smoother
        if confirmed[:-1] != before:  # the view contradicts earlier ones, which were dropped
            return after, after.afresh() or smoother
        return after, smoother.informed(view.bias(smoother.pivot))

    def afresh(self) -> PoseBiasSmoother | None:
        """Returns a smoother from the last measurement alone, in the palm at its instant; None where there was none."""
        if self.last is None:
            return None
        pose, T_mount_palm, motion = self.last
        T_palm_object = se3.inverse(T_mount_palm) @ pose.T_a_b
        started = self.smoother_from(T_palm_object, np.diag(UNINFORMATIVE), pose.T_a_b[:3, 3])
        return self._gated(started, pose, T_mount_palm, motion)[1]

    def in_palm(self, observation: Observation | None, T_world_palm: Array | None) -> Array | None:
        """Returns (4, 4) the pose from vision in the palm, with vision's bias.

        None where the observation has none, or where T_world_palm is needed and missing.
        """
        measured = None if observation is None else observation.vision
        if measured is None:
            return None
        T_mount_palm = EYE if self._mount_of(measured) == "palm" else T_world_palm
        return None if T_mount_palm is None else se3.inverse(T_mount_palm) @ self._in_mount(measured).T_a_b

    def smoother_from(self, T_palm_object: Array, covariance: Array, pivot: Array) -> PoseBiasSmoother:
        """Returns a smoother that starts at a pose with a covariance (6, 6); the bias is about `pivot` (3,) [m]."""
        c = self.camera
        constant = np.array([c.sigma_position_constant, c.sigma_rotation_constant])
        bias = np.diag(np.repeat(np.maximum(constant, LEAST_SIGMA) ** 2, 3))
        pose = (T_palm_object, invertible(covariance))
        errors = (c.drift, (c.latency, c.sigma_latency))
        smoother = PoseBiasSmoother.from_prior(*pose, bias, pivot, *errors)
        for view in self.camera_from_palm.confirmed:
            smoother = smoother.informed(view.bias(pivot))
        return smoother

    def _mount_of(self, measured: PoseMeasurement) -> Mount:
        if measured.frame != "camera":
            return measured.frame
        if self.rig.camera is None:
            raise InvalidInput("vision.frame: expected world or palm (the rig has no camera), got 'camera'")
        return self.rig.camera.on

    def _in_mount(self, measured: PoseMeasurement) -> GaussianPose:
        """Returns the measured pose in the mount's frame."""
        c, covariance = self.camera, measured.covariance
        T_mount_frame = c.T_mount_camera if measured.frame == "camera" else EYE
        if covariance is None:
            T_mount_object = T_mount_frame @ measured.T_frame_object
            return GaussianPose(T_mount_object, invertible(c.noise_at(T_mount_object[:3, 3])))
        pose = GaussianPose(measured.T_frame_object, covariance).transformed(T_mount_frame)
        return GaussianPose(pose.T_a_b, invertible(pose.covariance))

    def _drift_gain(self, measured: PoseMeasurement) -> float:
        """Returns how large vision's drift is in a measurement, relative to the rig's.

        With a covariance of its own, it is larger or smaller by as much as that is than the rig's noise.
        """
        c, covariance = self.camera, measured.covariance
        if covariance is None:
            return 1.0
        usual = np.maximum([c.sigma_position, c.sigma_rotation], LEAST_SIGMA)
        return float(np.sqrt((covariance.diagonal() / np.repeat(usual, 3) ** 2).mean()))

    def _gated(
        self, smoother: PoseBiasSmoother, pose_mount_object: GaussianPose, T_mount_palm: Array, motion: Motion
    ) -> tuple["VisionUpdate", PoseBiasSmoother]:
        """Returns this and the smoother after a measured pose; one beyond the gate is rejected.

        After several rejected poses in a row the object must have moved: the smoother restarts with a wide pose.
        """
        T = self.model.nearest(pose_mount_object.T_a_b, smoother.expected(T_mount_palm))
        nearest = GaussianPose(T, pose_mount_object.covariance)
        chi2 = smoother.mahalanobis2(nearest, T_mount_palm, motion)
        after = replace(self, chi2=chi2, rejected_in_a_row=0)
        if chi2 > CHI2:
            in_a_row = self.rejected_in_a_row + 1
            after = replace(after, rejected=self.rejected + 1)
            if in_a_row < MAX_REJECTED:
                return replace(after, rejected_in_a_row=in_a_row), smoother
            smoother = smoother.restarted(smoother.now.inflated(UNINFORMATIVE))
        return after, smoother.updated(nearest, T_mount_palm, motion)


def invertible(covariance: Array) -> Array:
    """Returns a covariance (6, 6) with 1e-10 of its largest variance, or of 1, added to each variance.

    That is some 10 µm and 10 µrad: a pose that is known exactly, or far better in one direction than in another, then
    has an information matrix.
    """
    return np.asarray(covariance + 1e-10 * max(1.0, *covariance.diagonal().tolist()) * EYE_6)
