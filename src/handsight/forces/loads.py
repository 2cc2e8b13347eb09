"""What all fingertips of a hand bear together over a short while, and what makes that sum uncertain.

A tip's load (f, t), of the object on it at its sensor's origin s, comes to F = Σ f and T = Σ (t + s × f) about the
palm's origin. Where the joints read δq too much, with J the tip's Jacobian at s, the tip seems turned by J_ω δq and
displaced by J_p δq, so that F seems more by -Σ [f]x J_ω δq and T by Σ (-[f]x J_p - [s]x [f]x J_ω - [t]x J_ω) δq.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from handsight import se3
from handsight.checks import Array
from handsight.contact import compensate
from handsight.observation import Observation
from handsight.rig import Rig


class LoadOptions(NamedTuple):
    """`LoadOptions` say how loads and accelerations are read."""

    order: int = 3  # of the polynomials that accelerations are read from (Savitzky and Golay 1964)
    span: float = 0.1  # their length [s]
    min_instants: int = 5  # instants of one at least
    saturated: float = 0.99  # parts of a sensor's full scale from which on a reading is none


LOADS = LoadOptions()

SILENT = np.full(6, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class LoadSum:
    """A `LoadSum` is all fingertips' loads together, mean of a short while; in the palm's axes, about its origin."""

    stamp: float
    """In the middle of it [s]."""
    wrench: Array
    """(6,) force [N] and torque [N m] of the object on the tips."""
    gravity: Array
    """(3,) less the acceleration [m/s²]: what each kilogram weighs."""
    R_palm_world: Array
    """(3, 3)"""
    by_joint: Array
    """(6, j) how the wrench is off by an error of each joint."""
    by_bias: Array
    """(6, 6 t) how it is off by each tip's bias, its force and its torque."""
    noise: Array
    """(6, 6) its covariance by what changes from reading to reading."""
    acceleration: float
    """Root mean square, per axis [m/s²]."""
    turning: float
    """The same of how the palm's turning changes [rad/s²]."""
    Ts_palm_tip: Array
    """(t, 4, 4)"""
    forces: Array
    """(t, 3) of the object on each tip [N]."""
    touched: Mapping[int, tuple[Array, Array]]
    """By tip that is touched: (3,) where in the palm [m], and the normal (3,) there."""

    @property
    def middle_palm(self) -> Array:
        """(3,) between the tips that bear the load [m]."""
        pressed = np.sqrt((self.forces**2).sum(axis=1)) + 1e-9
        return np.asarray(pressed @ self.Ts_palm_tip[:, :3, 3] / pressed.sum())

    def tangential(self, tip: int) -> Array:
        """Returns (3,) of the force on a tip that is touched: what is along the surface [N]."""
        force, normal = self.forces[tip], self.touched[tip][1]
        return np.asarray(force - (force @ normal) * normal)


def lacking(rig: Rig, observations: Sequence[Observation]) -> str:
    """Returns why observations do not say what all fingertips bear; empty where they do."""
    alike = []
    for name, finger in rig.fingers.items():
        readings = np.array([o.wrenches.get(name, SILENT) for o in observations])
        if not np.isfinite(readings).all():
            return f"{name} is silent"
        alike += [name] if (readings == readings[0]).all() else []
        if finger.full_scale is not None:
            ends = np.repeat(LOADS.saturated * np.array(finger.full_scale), 3)
            if (np.abs(readings) >= ends).any():
                return f"{name} is at the end of its sensor's scale"
    # Where all do, nothing has noise.
    return f"{alike[0]} reads the same for ever" if 0 < len(alike) < len(rig.fingers) else ""


def load_sum(
    rig: Rig, observations: Sequence[Observation], touched: Mapping[str, tuple[Array, Array]], joints: Array
) -> LoadSum:
    """Returns the mean of n observations that nothing is `lacking` in, evenly spaced, of a grip that hardly changes.

    `touched`: by finger that is touched, where in the palm [m], and the normal there. `joints` (j,): by how much the
    hand's moving joints read too much, as far as that is known [rad].
    """
    names, tips = tuple(rig.fingers), _tips(rig)
    hand = rig.hand.kinematics(_mean_joints(rig, observations, joints))
    Ts_palm_tip = hand.Ts_palm_tip[tips]
    sensors = Ts_palm_tip @ _Ts_tip_sensor(rig)
    places = sensors[:, :3, 3]
    middle = np.mean([point for point, _ in touched.values()] or places, axis=0)
    Ts_world_palm = np.array([o.T_world_palm for o in observations])
    step = (observations[-1].stamp - observations[0].stamp) / max(len(observations) - 1, 1)
    acceleration, turning = accelerations(Ts_world_palm, middle, step)
    gravity = np.einsum("nji,nj->i", Ts_world_palm[:, :3, :3], rig.gravity - acceleration) / len(observations)
    wrench, by_joint, by_bias, forces = _summed(
        rig, observations, gravity, sensors, hand.jacobians(places, tips)
    )
    B = by_bias * np.concatenate([[f.sigma_force] * 3 + [f.sigma_torque] * 3 for f in rig.fingers.values()])
    return LoadSum(
        stamp=(observations[0].stamp + observations[-1].stamp) / 2,
        wrench=wrench,
        gravity=gravity,
        R_palm_world=Ts_world_palm[len(observations) // 2, :3, :3].T,
        by_joint=by_joint,
        by_bias=by_bias,
        noise=(B @ B.T + rig.sigma_joint**2 * by_joint @ by_joint.T) / len(observations),
        acceleration=_rms(acceleration),
        turning=_rms(turning),
        Ts_palm_tip=Ts_palm_tip,
        forces=forces,
        touched={i: touched[name] for i, name in enumerate(names) if name in touched},
    )


def accelerations(Ts_world_palm: Array, point_palm: Array, step: float) -> tuple[Array, Array]:
    """Returns (n, 3) acceleration of a point of the palm [m/s²] and (n, 3) of its turning [rad/s²], in the world's
    axes.

    By polynomials over `LOADS.span` through poses (n, 4, 4) that are `step` apart [s]; zeros of fewer than
    `LOADS.min_instants`.
    """
    n = len(Ts_world_palm)
    if n < LOADS.min_instants or step <= 0:
        return np.zeros((n, 3)), np.zeros((n, 3))
    length = min(max(2 * round(LOADS.span / step / 2) + 1, LOADS.min_instants), n - 1 + n % 2)
    R_middle = Ts_world_palm[n // 2, :3, :3]
    turns = se3.rotation_log(Ts_world_palm[:, :3, :3] @ R_middle.T)
    rows = np.hstack([Ts_world_palm[:, :3, :3] @ point_palm + Ts_world_palm[:, :3, 3], turns])
    second = _second_derivative(n, length) @ rows / step**2
    return second[:, :3], second[:, 3:]


@lru_cache(maxsize=32)
def _second_derivative(n: int, length: int) -> Array:
    """Returns (n, n) what takes n numbers, one apart, to their second derivatives by polynomials over `length` of
    them."""
    return np.asarray(savgol_filter(np.eye(n), length, LOADS.order, deriv=2, axis=0))


def _mean_joints(rig: Rig, observations: Sequence[Observation], joints: Array) -> dict[str, float]:
    offsets = dict(zip(rig.hand.moving, joints.tolist(), strict=True))
    rows: list[Mapping[str, float]] = [o.joint_positions or {} for o in observations]
    return {name: sum(row[name] for row in rows) / len(rows) - off for name, off in offsets.items()}


def _summed(
    rig: Rig, observations: Sequence[Observation], gravity: Array, sensors: Array, J: Array
) -> tuple[Array, Array, Array, Array]:
    """Returns the sum of mean loads (6,), what errors of joints (6, j) and biases (6, 6 t) make of it, and the forces
    (t, 3); `sensors` (t, 4, 4) in the palm, `J` (t, 6, j): Jacobians there."""
    t = len(sensors)
    wrench, by_joint = np.zeros(6), np.zeros((6, J.shape[2]))
    by_bias, forces = np.zeros((6, 6 * t)), np.zeros((t, 3))
    for i, (name, finger) in enumerate(rig.fingers.items()):
        reading = np.mean([o.wrenches[name] for o in observations], axis=0)
        R, s = sensors[i, :3, :3], sensors[i, :3, 3]
        f, m = (R @ part for part in compensate(reading[:3], reading[3:], R.T @ gravity, finger.calibration))
        # What is read turns with the tip, the tip's own weight does not.
        F, S, M = se3.skew(f + finger.calibration.mass * gravity), se3.skew(s), se3.skew(m)
        wrench += np.concatenate([f, m + S @ f])
        by_joint[:3] -= F @ J[i, 3:]
        by_joint[3:] -= se3.skew(f) @ J[i, :3] + (S @ F + M) @ J[i, 3:]
        by_bias[:3, 6 * i : 6 * i + 3] = R
        by_bias[3:, 6 * i : 6 * i + 3], by_bias[3:, 6 * i + 3 : 6 * i + 6] = S @ R, R
        forces[i] = f
    return wrench, by_joint, by_bias, forces


def Ts_palm_sensor(rig: Rig, joint_positions: Mapping[str, float]) -> Array:
    """Returns (t, 4, 4) the fingers' sensors in the palm."""
    tips: Array = rig.hand.kinematics(joint_positions).Ts_palm_tip[_tips(rig)]
    return np.asarray(tips @ _Ts_tip_sensor(rig))


def _tips(rig: Rig) -> list[int]:
    """Returns which of the hand's tips the fingers are."""
    return [tuple(rig.hand.tips).index(name) for name in rig.fingers]


def _Ts_tip_sensor(rig: Rig) -> Array:
    """Returns (t, 4, 4) each sensor's frame in that of the body that its tip moves with."""
    fingers = rig.fingers.values()
    at = ((f.T_frame_surface, f.tip.T_surface_sensor) for f in fingers)
    return np.stack([T if T_sensor is None else T @ T_sensor for T, T_sensor in at])


def _rms(rows: Array) -> float:
    return float(np.sqrt((rows**2).mean()))
