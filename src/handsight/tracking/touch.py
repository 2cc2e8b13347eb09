"""Joints and raw wrenches to contacts in the palm, with everything that is uncertain about them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight._kernels import placing
from handsight._kernels import tips as tips_kernel
from handsight.checks import Array, Indices
from handsight.contact import Contacts
from handsight.contact.several import Sensed, Several
from handsight.hand import HandPose
from handsight.observation import Observation
from handsight.rig import Rig

NEAR_TIP = 0.003
"""A tip closer than this to another may touch it as well, by one chance in twenty or more [m].

One degree of each joint is 1.3 mm per axis at each of two tips.
"""
LIKELY_ALONE = 0.05
GAP_SCALE = 1.645 / (math.sqrt(2.0) * NEAR_TIP)
"""To what `erfc` takes [1/m]: a gap of NEAR_TIP is 1.645 standard deviations of it."""
TWO_AT_ONCE = np.array([0.002, np.deg2rad(12.0)]) ** 2
"""Variances per axis of point [m²] and normal [rad²] of what one contact is taken for that is two."""


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What the fingertips feel at one instant."""

    fingers: tuple[str, ...]
    """The fingers that touch, in the contacts' order."""
    contacts: Contacts | None
    """In the palm frame; None where no finger touches. Their covariance holds the sensor's noise, the finger's sigmas
    and the joints' errors through the hand's Jacobian."""
    reasons: Mapping[str, str]
    """Why each of the other fingers has no contact: silent (no reading) or a `Reason` of its wrench."""
    near: tuple[str, ...] = ()
    """Of those that touch, the ones within `NEAR_TIP` of another tip, whose contact is the less certain for it."""


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
        self._by_weight = se3.skew(np.array([c.center_of_mass for c in known]))
        self._semi_axes = np.array([finger.tip.semi_axes for finger in fingers])
        self._variance = rig.sigma_joint_offset**2 + rig.sigma_joint**2
        self._own = np.array([[finger.sigma_point**2, finger.sigma_normal**2] for finger in fingers])
        sigmas = np.array([[finger.sigma_force] * 3 + [finger.sigma_torque] * 3 for finger in fingers])
        self._sensing = Several([finger.tip for finger in fingers], sigmas)
        self._silent = np.full(6, np.nan)

    def touch(self, observation: Observation) -> Touch:
        """What is felt; nothing where joints are missing. Raises InvalidInput for joints that are wrong."""
        if observation.joint_positions is None:
            return Touch((), None, dict.fromkeys(self.names, "no joint positions"))
        pose = self.rig.hand.kinematics(observation.joint_positions)
        Ts_palm_surface = pose.Ts_palm_tip[self._tips] @ self._Ts_tip_surface
        loads = self._loads(observation, Ts_palm_surface)
        sensed = self._sensing.sense(loads)
        reasons = {
            name: "silent" if reason == "invalid" else reason
            for name, reason in zip(self.names, sensed.reasons, strict=True)
            if reason != "contact"
        }
        rows = np.array([i for i, reason in enumerate(sensed.reasons) if reason == "contact"], dtype=np.int64)
        if not len(rows):
            return Touch((), None, reasons)
        doubt = self._doubt(Ts_palm_surface)
        near = tuple(self.names[i] for i in rows if doubt[i] > LIKELY_ALONE)
        contacts = self._placed(sensed, rows, doubt, Ts_palm_surface, pose)
        return Touch(tuple(self.names[i] for i in rows), contacts, reasons, near)

    def _loads(self, observation: Observation, Ts_palm_surface: Array) -> Array:
        """(n, 6) force and torque of the object on each tip, in its sensor's frame; NaN where a sensor is silent.

        As `handsight.compensate`, for all tips at once. Without T_world_palm gravity's direction is not known, and the
        tips' weight (some 40 mN) stays in.
        """
        raw = np.array([observation.wrenches.get(name, self._silent) for name in self.names])
        load: Array = self._sign * (raw - self._bias)
        T = observation.T_world_palm
        if T is not None:
            gravity_palm = T[:3, :3].T @ self.rig.gravity
            weight = self._mass * (gravity_palm @ (Ts_palm_surface[:, :3, :3] @ self._Rs_surface_sensor))
            load[:, :3] -= weight
            load[:, 3:] -= (self._by_weight @ weight[..., None])[..., 0]
        return load

    def _doubt(self, Ts_palm_surface: Array) -> Array:
        """(n,) the chance that a tip touches another one: its sensor then feels the sum of two contacts."""
        gaps = tips_kernel.gaps(np.ascontiguousarray(Ts_palm_surface), self._semi_axes)
        return np.array([0.5 * math.erfc(GAP_SCALE * gap) for gap in gaps.tolist()])

    def _placed(
        self, sensed: Sensed, rows: Indices, doubt: Array, Ts_palm_surface: Array, pose: HandPose
    ) -> Contacts:
        """The contacts in the palm frame, with all that is uncertain about them."""
        points, normals, covariance = sensed.points[rows], sensed.normals[rows], sensed.covariances[rows]
        Ts = Ts_palm_surface[rows]
        points_palm = (Ts[:, :3, :3] @ points[..., None])[..., 0] + Ts[:, :3, 3]
        by_joint = pose.jacobians(points_palm, self._tips[rows].tolist())
        own = self._own[rows] + doubt[rows, None] * TWO_AT_ONCE
        placing.place(points, normals, covariance, Ts, own, by_joint, self._variance)
        return Contacts.trusted(points, normals, covariance)


def _sensor(T_surface_sensor: Array | None) -> Array:
    return np.eye(4) if T_surface_sensor is None else T_surface_sensor
