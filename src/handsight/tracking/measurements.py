"""What vision and a table measure of the object: each gated, and given to the smoother or its state."""

from typing import Literal, NamedTuple

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation, PoseMeasurement
from handsight.rig import MountedCamera, Rig, Table
from handsight.tracking.camera_from_palm import CameraFromPalm, HandView
from handsight.tracking.smoother import PoseAndBias, PoseBiasSmoother

Mount = Literal["world", "palm"]


class GateOptions(NamedTuple):
    """`GateOptions` say which measurements of the object's pose are wrong."""

    chi2: float = 27.9
    """Of six numbers, which one in ten thousand exceeds: such a measurement is wrong, or the object has moved."""
    table_chi2: float = 16.3
    """Of three numbers, which one in a thousand exceeds: beyond it the object does not stand there."""
    max_rejected: int = 5  # so many of them in a row say that the object has moved


GATES = GateOptions()

UNINFORMATIVE = np.array([0.3**2] * 3 + [1.0] * 3)
"""Variances of a pose before anything is known (δp [m²], δθ [rad²])."""


EYE, EYE_6 = np.eye(4), np.eye(6)


class VisionUpdate:
    """A `VisionUpdate` is a rig's camera as a sensor of poses, and what has become of its measurements.

    They are carried into the frame the camera is fixed to, its mount: there its bias is constant.
    """

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """`rig.camera` may be None: then poses come in the world or the palm."""
        self._rig, self._model = rig, model
        self.camera = c = rig.camera or MountedCamera()
        self._usual_covariance = invertible(np.diag([c.sigma_position**2] * 3 + [c.sigma_rotation**2] * 3))
        """Of a measurement that does not say its own."""
        self.mount: Mount | None = None
        """What vision's bias is constant in; known with the first measurement."""
        self.unplaced = self.rejected = 0
        """Measurements without a T_world_palm to place them, and those beyond the gate."""
        self.camera_from_palm = CameraFromPalm()
        """What the hand in its images says of the camera's constant error."""
        self._rejected_in_a_row = 0
        self._last: tuple[Array, Array, Array] | None = None
        """The last measurement and its covariance in the mount, and the palm there."""

    def update(
        self, observation: Observation, smoother: PoseBiasSmoother | None, T_world_palm: Array | None
    ) -> PoseBiasSmoother | None:
        """Returns the smoother after an observation; the same one (or None) where that has no pose, or none that can
        be.

        Raises InvalidInput where the pose is in the frame of a camera that the rig has not, or far from any hand.
        """
        measured = observation.vision
        if measured is None:
            return smoother
        mount = self._mount_of(measured)
        if self.mount is None:
            self.mount = mount
        T_mount_palm = EYE if mount == "palm" else T_world_palm
        if mount != self.mount or T_mount_palm is None:
            self.unplaced += 1
            return smoother
        T_mount_object, covariance = self._in_mount(measured)
        T_palm_object = se3.inverse(T_mount_palm) @ T_mount_object
        place = T_palm_object[:3, 3]
        if not np.abs(place).max() <= checks.MAX_DISTANCE:
            checks.position(place, "vision: the object's place in the palm", (3,))
        self._last = T_mount_object, covariance, T_mount_palm
        updated = None if smoother is None else self._gated(smoother, *self._last)
        # Else nothing is known, or nothing that this can be believed with.
        return updated if updated is not None and updated.is_near else self.afresh()

    def palm_detected(self, view: HandView, smoother: PoseBiasSmoother | None) -> PoseBiasSmoother | None:
        """Returns the smoother after the hand was seen; the same one where that says nothing new."""
        before, self.camera_from_palm = self.camera_from_palm, self.camera_from_palm.updated(view)
        new = self.camera_from_palm.believed[len(before.believed) :]
        if self.camera_from_palm.believed == before.believed or smoother is None:
            return smoother
        if self.camera_from_palm.believed[:-1] != before.believed:  # what it was taken for is wrong
            return self.afresh() or smoother
        return smoother.informed(*new[-1].bias(smoother.pivot))

    def afresh(self) -> PoseBiasSmoother | None:
        """Returns what the last measurement says on its own, in the palm of then; None where there was none."""
        if self._last is None:
            return None
        T_mount_object, _, T_mount_palm = self._last
        T_palm_object = se3.inverse(T_mount_palm) @ T_mount_object
        started = self.smoother_from(T_palm_object, np.diag(UNINFORMATIVE), T_mount_object[:3, 3])
        return self._gated(started, *self._last)

    def in_palm(self, observation: Observation | None, T_world_palm: Array | None) -> Array | None:
        """Returns (4, 4) the measured pose in the palm, its bias still in it; None where there is none or it has no
        place."""
        measured = None if observation is None else observation.vision
        if measured is None:
            return None
        T_mount_palm = np.eye(4) if self._mount_of(measured) == "palm" else T_world_palm
        return None if T_mount_palm is None else se3.inverse(T_mount_palm) @ self._in_mount(measured)[0]

    def smoother_from(self, T_palm_object: Array, covariance: Array, pivot: Array) -> PoseBiasSmoother:
        """Returns a smoother started at a pose with its covariance (6, 6), and vision's bias as uncertain as the
        camera says."""
        c = self.camera
        # A camera without a constant error has next to none: a covariance must be invertible.
        position, rotation = max(c.sigma_position_constant, 1e-6), max(c.sigma_rotation_constant, 1e-6)
        bias = np.diag([position**2] * 3 + [rotation**2] * 3)
        smoother = PoseBiasSmoother.from_prior(T_palm_object, invertible(covariance), bias, pivot)
        for measured in self.camera_from_palm.biases(pivot):
            smoother = smoother.informed(*measured)
        return smoother

    def _mount_of(self, measured: PoseMeasurement) -> Mount:
        if measured.frame == "camera":
            if self._rig.camera is None:
                raise InvalidInput(
                    "vision.frame: expected world or palm (the rig has no camera), got 'camera'"
                )
            return self._rig.camera.on
        return measured.frame

    def _in_mount(self, measured: PoseMeasurement) -> tuple[Array, Array]:
        """Returns the measured pose in the mount's frame, and its covariance (6, 6) along the mount's axes."""
        T_mount_frame = self.camera.T_mount_camera if measured.frame == "camera" else EYE
        if measured.covariance is None:
            return T_mount_frame @ measured.T_frame_object, self._usual_covariance
        covariance = se3.rotate_covariance(T_mount_frame[:3, :3], measured.covariance)
        return T_mount_frame @ measured.T_frame_object, invertible(covariance)

    def _gated(
        self, smoother: PoseBiasSmoother, T_mount_object: Array, covariance: Array, T_mount_palm: Array
    ) -> PoseBiasSmoother:
        """Returns the smoother after a measurement; beyond the gate it is left out, until several in a row are."""
        expected = smoother.expected(T_mount_palm)
        T = self._model.nearest(T_mount_object, expected)
        if smoother.mahalanobis2(T, covariance, T_mount_palm) > GATES.chi2:
            self._rejected_in_a_row += 1
            self.rejected += 1
            if self._rejected_in_a_row < GATES.max_rejected:
                return smoother
            smoother = smoother.restarted(smoother.now.inflated(UNINFORMATIVE))
        self._rejected_in_a_row = 0
        return smoother.updated(T, covariance, T_mount_palm)


def invertible(covariance: Array) -> Array:
    """Returns a covariance (6, 6) of what is known exactly, or in some direction far better than in others, is of
    what is known well: to 10 µm, 10 µrad and a hundred-thousandth of the widest."""
    return np.asarray(covariance + 1e-10 * max(1.0, *covariance.diagonal().tolist()) * EYE_6)


def on_table(state: PoseAndBias, model: ObjectModel, table: Table, T_world_palm: Array) -> PoseAndBias | None:
    """Returns the state given that the object stands on the table; None where that is beyond the gate.

    It stands along the one of its six axes' directions that points up most.
    """
    R, T = T_world_palm[:3, :3], T_world_palm @ state.T_palm_object
    up = int(np.argmax(np.abs(T[2, :3])))
    sign = 1.0 if T[2, up] > 0 else -1.0
    axis = sign * T[:3, up]
    base = model.bounds_object[0, up] if sign > 0 else -model.bounds_object[1, up]
    # The swing about the world's x and y that brings the axis upright; about z it says nothing.
    swing = np.array([axis[1], -axis[0]])
    sine = float(np.linalg.norm(swing))
    if sine > 1e-9:
        swing = swing / sine * np.arctan2(sine, axis[2])
    H = np.zeros((3, 12))
    H[0, :3], H[1:, 3:6] = R[2], R[:2]
    innovation = np.concatenate([[table.height - base - T[2, 3]], swing])
    noise = np.diag([table.sigma_height**2, table.sigma_tilt**2, table.sigma_tilt**2])
    S = H @ state.covariance @ H.T + noise
    if innovation @ np.linalg.solve(S, innovation) > GATES.table_chi2:
        return None
    return state.updated(H, innovation, noise)
