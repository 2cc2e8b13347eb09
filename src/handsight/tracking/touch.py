"""Joints and raw wrenches to contacts in the palm, with everything that is uncertain about them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handsight._kernels import placing
from handsight._kernels import tips as tips_kernel
from handsight.checks import Array
from handsight.contact import Contact, Contacts, contact_from_wrench
from handsight.hand import HandPose
from handsight.observation import Observation
from handsight.rig import Rig

NEAR_TIP = 0.003
"""A tip closer than this to another may touch it as well [m]: one degree of each joint is 1.6 mm at the tips."""


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What the fingertips feel at one instant."""

    fingers: tuple[str, ...]
    """The fingers that touch, in the contacts' order."""
    contacts: Contacts | None
    """In the palm frame; None where no finger touches. Their covariance holds the sensor's noise, the finger's sigmas
    and the joints' errors through the hand's Jacobian."""
    pressed: tuple[str, ...]
    """The fingers that something presses, also those whose reading is not trusted as one contact."""
    reasons: Mapping[str, str]
    """Why each of the other fingers has no contact: silent (no reading), near_tip, or a `Reason` of its wrench."""


class Skin:
    """A rig's fingertips, laid out for use at every instant."""

    def __init__(self, rig: Rig) -> None:
        """The rig's hand must have a tip for every finger."""
        self.rig, self.names = rig, tuple(rig.fingers)
        self.frames = tuple(finger.frame for finger in rig.fingers.values())
        fingers = [rig.fingers[name] for name in self.names]
        order = list(rig.hand.tips)
        self._tips = np.array([order.index(name) for name in self.names])
        self._Ts_tip_surface = np.array([finger.T_frame_surface for finger in fingers])
        self._Rs_surface_sensor = np.array(
            [_sensor(finger.tip.T_surface_sensor)[:3, :3] for finger in fingers]
        )
        known = [finger.calibration for finger in fingers]
        self._sign = np.array([1.0 if c.reading == "on_sensor" else -1.0 for c in known])[:, None]
        self._bias = np.array([np.concatenate([c.bias_force, c.bias_torque]) for c in known])
        self._mass = np.array([c.mass for c in known])[:, None]
        self._center = np.array([c.center_of_mass for c in known])
        self._semi_axes = np.array([finger.tip.semi_axes for finger in fingers])
        self._variance = rig.sigma_joint_offset**2 + rig.sigma_joint**2
        self._own = np.array([[finger.sigma_point**2, finger.sigma_normal**2] for finger in fingers])
        self._silent = np.full(6, np.nan)

    def touch(self, observation: Observation) -> Touch:
        """What is felt; nothing where joints are missing. Raises InvalidInput for joints that are wrong."""
        if observation.joint_positions is None:
            return Touch((), None, (), dict.fromkeys(self.names, "no joint positions"))
        pose = self.rig.hand.kinematics(observation.joint_positions)
        Ts_palm_surface = pose.Ts_palm_tip[self._tips] @ self._Ts_tip_surface
        forces, torques = self._loads(observation, Ts_palm_surface)
        felt: list[tuple[int, Contact]] = []
        reasons: dict[str, str] = {}
        for i, name in enumerate(self.names):
            if not np.isfinite(forces[i]).all() or not np.isfinite(torques[i]).all():
                reasons[name] = "silent"
                continue
            finger = self.rig.fingers[name]
            found = contact_from_wrench(
                forces[i], torques[i], finger.tip,
                sigma_force=finger.sigma_force, sigma_torque=finger.sigma_torque,
            )  # fmt: skip
            if isinstance(found, Contact):
                felt.append((i, found))
            else:
                reasons[name] = found.reason
        pressed = tuple(self.names[i] for i, _ in felt)
        if felt:
            felt = self._apart(felt, Ts_palm_surface, reasons)
        if not felt:
            return Touch((), None, pressed, reasons)
        rows = [i for i, _ in felt]
        return Touch(
            tuple(self.names[i] for i in rows), self._placed(felt, Ts_palm_surface, pose), pressed, reasons
        )

    def _loads(self, observation: Observation, Ts_palm_surface: Array) -> tuple[Array, Array]:
        """What the object exerts on each tip, (n, 3) each, in its sensor's frame; NaN where a sensor is silent.

        As `handsight.compensate`, for all tips at once. Without T_world_palm gravity's direction is not known, and the
        tips' weight (some 40 mN) stays in.
        """
        raw = np.array([observation.wrenches.get(name, self._silent) for name in self.names])
        load = self._sign * (raw - self._bias)
        T = observation.T_world_palm
        if T is None:
            return load[:, :3], load[:, 3:]
        gravity_palm = T[:3, :3].T @ self.rig.gravity
        R = Ts_palm_surface[:, :3, :3] @ self._Rs_surface_sensor
        weight = self._mass * (gravity_palm @ R)
        return load[:, :3] - weight, load[:, 3:] - np.cross(self._center, weight)

    def _apart(
        self, felt: list[tuple[int, Contact]], Ts_palm_surface: Array, reasons: dict[str, str]
    ) -> list[tuple[int, Contact]]:
        """Those of the tips that no other tip can be touching: two contacts at once are none that can be told."""
        gaps = tips_kernel.gaps(np.ascontiguousarray(Ts_palm_surface), self._semi_axes)
        kept = []
        for i, contact in felt:
            if gaps[i] < NEAR_TIP:
                reasons[self.names[i]] = "near_tip"
            else:
                kept.append((i, contact))
        return kept

    def _placed(self, felt: list[tuple[int, Contact]], Ts_palm_surface: Array, pose: HandPose) -> Contacts:
        """The contacts in the palm frame, with all that is uncertain about them."""
        rows = np.array([i for i, _ in felt])
        points, normals = np.array([c.point for _, c in felt]), np.array([c.normal for _, c in felt])
        covariance, Ts = np.array([c.covariance for _, c in felt]), Ts_palm_surface[rows]
        points_palm = (Ts[:, :3, :3] @ points[..., None])[..., 0] + Ts[:, :3, 3]
        by_joint = pose.jacobians(points_palm, self._tips[rows])
        placing.place(points, normals, covariance, Ts, self._own[rows], by_joint, self._variance)
        return Contacts.trusted(points, normals, covariance)


def _sensor(T_surface_sensor: Array | None) -> Array:
    return np.eye(4) if T_surface_sensor is None else T_surface_sensor
