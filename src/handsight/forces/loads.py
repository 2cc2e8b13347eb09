"""The loads on the fingertips over a short time: their sum with its uncertainty, and the sensors' biases.

The object's load (f, t) on each tip, at its sensor's origin s, adds up to F = Σ f and T = Σ (t + s × f) about the
palm's origin. Where the joints read δq too much, with J the tip's Jacobian at s, the tip seems turned by J_ω δq and
displaced by J_p δq, so F is wrong by -Σ [f]x J_ω δq and T by Σ (-[f]x J_p - [s]x [f]x J_ω - [t]x J_ω) δq.

A tip that moves through the air bears only its own weight. If the rest of its reading is constant in the tip's axes on
the way, it is the sensor's bias: the load of a touched object would change.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from handsight import se3
from handsight.checks import Array
from handsight.contact import calibrate_wrench, compensate
from handsight.errors import InvalidInput
from handsight.hand import HandPose
from handsight.observation import Observation
from handsight.rig import Rig


class LoadOptions(NamedTuple):
    """`LoadOptions` say how loads and accelerations are read, and when a tip is in the air."""

    order: int = 3  # of the polynomials that accelerations are read from (Savitzky and Golay 1964)
    span: float = 0.1  # length of a polynomial [s]
    min_instants: int = 5  # fewest instants of a polynomial
    saturated: float = 0.99  # a reading beyond this share of the sensor's full scale is not used
    min_travel: float = 0.005
    """A tip that moves this far in the palm during a window is in the air, not pressed against something [m]."""
    still: float = 0.3  # length of the means by which a sensor is calibrated [s]
    still_turn: float = np.deg2rad(0.5)  # a hand whose sensors turn less than this meanwhile is still [rad]
    max_bias: float = 0.5  # a larger reading in the air is a load, or a broken sensor [N]
    unsteady_p: float = 0.001
    """Readings vary by more than noise where noise would exceed their spread with less than this probability."""


LOADS = LoadOptions()


@dataclass(frozen=True, slots=True, eq=False)
class LoadSum:
    """A `LoadSum` is the sum of the loads on all t fingertips, averaged over a short time.

    It is along the palm's axes, about the palm's origin.
    """

    stamp: float
    """The middle of that time [s]."""
    wrench: Array
    """(6,) force [N] and torque [N m] of the object on the tips."""
    gravity: Array
    """(3,) gravity less the palm's acceleration [m/s²]: the weight of each kilogram."""
    R_palm_world: Array
    """(3, 3) rotation of the world in the palm."""
    by_joint: Array
    """(6, j) derivative of the wrench by the error of each joint."""
    by_bias: Array
    """(6, 6 t) derivative of the wrench by the force and torque of each tip's bias."""
    readings: Array
    """(6 t,) force [N] and torque [N m] that each sensor measures, with its tip's own weight, in its own axes."""
    noise: Array
    """(6, 6) covariance of the wrench due to errors that change from reading to reading."""
    acceleration: float
    """Root mean square of the palm's acceleration, per axis [m/s²]."""
    turning: float
    """Root mean square of the palm's angular acceleration, per axis [rad/s²]."""
    Ts_palm_tip: Array
    """(t, 4, 4) poses of the tips."""
    forces: Array
    """(t, 3) force of the object on each tip [N]."""
    touched: Mapping[int, tuple[Array, Array]]
    """By index of a tip that touches: the contact's point (3,) in the palm [m], and its normal (3,)."""

    @property
    def middle_palm(self) -> Array:
        """(3,) the mean of the tips, weighted by their forces [m]."""
        pressed = np.sqrt((self.forces**2).sum(axis=1)) + 1e-9
        return np.asarray(pressed @ self.Ts_palm_tip[:, :3, 3] / pressed.sum())

    def tangential(self, tip: int) -> Array:
        """Returns (3,) the tangential force on a tip that touches [N]."""
        force, normal = self.forces[tip], self.touched[tip][1]
        return np.asarray(force - (force @ normal) * normal)


def lacking(rig: Rig, observations: Sequence[Observation]) -> str:
    """Returns why the observations do not measure the loads on all fingertips; empty where they do."""
    alike = []
    for name, finger in rig.fingers.items():
        readings = np.array([o.wrenches.get(name, np.full(6, np.nan)) for o in observations])
        if not np.isfinite(readings).all():
            return f"{name} is silent"
        alike += [name] if (readings == readings[0]).all() else []
        if finger.full_scale is not None:
            ends = np.repeat(LOADS.saturated * np.array(finger.full_scale), 3)
            if (np.abs(readings) >= ends).any():
                return f"{name} is at the end of its sensor's scale"
    # If all of them read the same all the time, it is a simulation without noise.
    return f"{alike[0]} always reads the same" if 0 < len(alike) < len(rig.fingers) else ""


def load_sum(
    rig: Rig, observations: Sequence[Observation], touched: Mapping[str, tuple[Array, Array]], joints: Array
) -> LoadSum:
    """Returns the mean sum of loads over n observations, evenly spaced, of a grip that hardly changes.

    Nothing may be `lacking` in them. `touched`: by finger that touches, the contact's point in the palm [m], and its
    normal. `joints` (j,): the estimated offsets of the hand's moving joints, reading less true position [rad].
    """
    n, names = len(observations), tuple(rig.fingers)
    rows: list[Mapping[str, float]] = [o.joint_positions or {} for o in observations]
    offsets = zip(rig.hand.moving, joints.tolist(), strict=True)
    mean = {name: sum(row[name] for row in rows) / n - off for name, off in offsets}
    hand, tips, sensors = _sensors(rig, mean)
    places = sensors[:, :3, 3]
    middle = np.mean([point for point, _ in touched.values()] or places, axis=0)
    Ts_world_palm = np.array([o.T_world_palm for o in observations])
    step = (observations[-1].stamp - observations[0].stamp) / max(n - 1, 1)
    acceleration, turning = accelerations(Ts_world_palm, middle, step)
    gravity = np.einsum("nji,nj->i", Ts_world_palm[:, :3, :3], rig.gravity - acceleration) / n
    J = hand.jacobians(places, tips)
    wrench, by_joint, by_bias, readings, forces = _summed(rig, observations, gravity, sensors, J)
    B = by_bias * np.concatenate([[f.sigma_force] * 3 + [f.sigma_torque] * 3 for f in rig.fingers.values()])
    return LoadSum(
        stamp=(observations[0].stamp + observations[-1].stamp) / 2,
        wrench=wrench,
        gravity=gravity,
        R_palm_world=Ts_world_palm[n // 2, :3, :3].T,
        by_joint=by_joint,
        by_bias=by_bias,
        readings=readings,
        noise=(B @ B.T + rig.sigma_joint**2 * by_joint @ by_joint.T) / n,
        acceleration=float(np.sqrt((acceleration**2).mean())),
        turning=float(np.sqrt((turning**2).mean())),
        Ts_palm_tip=hand.Ts_palm_tip[tips],
        forces=forces,
        touched={i: touched[name] for i, name in enumerate(names) if name in touched},
    )


def accelerations(Ts_world_palm: Array, point_palm: Array, step: float) -> tuple[Array, Array]:
    """Returns the acceleration (n, 3) of a point of the palm [m/s²] and the angular acceleration (n, 3) [rad/s²].

    Both are along the world's axes, from polynomials over `LOADS.span` through poses (n, 4, 4) that are `step` apart
    [s]. They are zero if there are fewer than `LOADS.min_instants` poses.
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
    """Returns (n, n) the map from n samples at unit steps to their second derivatives, over windows of `length`.

    The windows at both ends are those of the samples there that are complete. It is what `scipy.signal.savgol_filter`
    makes of the identity, without loading `scipy.signal`, which takes as long as all else together.
    """
    derivative = np.zeros((n, n))
    for i in range(n):
        first = min(max(i - length // 2, 0), n - length)
        powers = np.vander(np.arange(first, first + length) - float(i), LOADS.order + 1, increasing=True)
        derivative[i, first : first + length] = 2 * np.linalg.pinv(powers)[2]
    return derivative


def _summed(
    rig: Rig, observations: Sequence[Observation], gravity: Array, sensors: Array, J: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Returns the sum of mean loads (6,), its derivatives by joints and biases, the readings, and the forces (t, 3).

    `gravity` is that of a `LoadSum`, `sensors` (t, 4, 4) are the sensors' poses in the palm, and `J` (t, 6, j) the
    Jacobians at their origins.
    """
    t = len(sensors)
    wrench, by_joint = np.zeros(6), np.zeros((6, J.shape[2]))
    by_bias, readings, forces = np.zeros((6, 6 * t)), np.zeros(6 * t), np.zeros((t, 3))
    for i, (name, finger) in enumerate(rig.fingers.items()):
        reading = np.mean([o.wrenches[name] for o in observations], axis=0)
        R, s = sensors[i, :3, :3], sensors[i, :3, 3]
        known, own = finger.calibration, R.T @ gravity * finger.calibration.mass
        load = np.concatenate(compensate(reading[:3], reading[3:], R.T @ gravity, known))
        readings[6 * i : 6 * i + 6] = load + np.concatenate([own, np.cross(known.center_of_mass, own)])
        f, m = R @ load[:3], R @ load[3:]
        # The reading turns with the tip, the tip's own weight does not.
        F, S, M = se3.skew(f + finger.calibration.mass * gravity), se3.skew(s), se3.skew(m)
        wrench += np.concatenate([f, m + S @ f])
        by_joint[:3] -= F @ J[i, 3:]
        by_joint[3:] -= se3.skew(f) @ J[i, :3] + (S @ F + M) @ J[i, 3:]
        by_bias[:3, 6 * i : 6 * i + 3] = R
        by_bias[3:, 6 * i : 6 * i + 3], by_bias[3:, 6 * i + 3 : 6 * i + 6] = S @ R, R
        forces[i] = f
    return wrench, by_joint, by_bias, readings, forces


def read_in_air(rig: Rig, observations: Sequence[Observation]) -> Array:
    """Returns (t, 6) the bias of each tip's sensor: its mean load in the air, in the sensor's frame [N, N m].

    It is NaN for a tip that may touch something: one that has hardly moved, or whose load has changed or is too large.
    `observations` are those of a short time, with joints and T_world_palm; nothing may be `lacking` in them.
    """
    first, last = (_sensors(rig, o.joint_positions)[2] for o in (observations[0], observations[-1]))
    far = np.linalg.norm(last[:, :3, 3] - first[:, :3, 3], axis=1) > LOADS.min_travel
    found = np.full((len(rig.fingers), 6), np.nan)
    R_palm_world = np.asarray(observations[-1].T_world_palm)[:3, :3].T
    limit = chdtri(3 * (len(observations) - 1), LOADS.unsteady_p)
    for i, (name, finger) in enumerate(rig.fingers.items()):
        if not far[i]:
            continue
        readings = np.array([o.wrenches[name] for o in observations])
        gravity = last[i, :3, :3].T @ R_palm_world @ rig.gravity
        loads = np.hstack(compensate(readings[:, :3], readings[:, 3:], gravity, finger.calibration))
        mean = loads.mean(axis=0)
        spread = ((loads[:, :3] - mean[:3]) ** 2).sum() / finger.sigma_force**2
        if spread < limit and np.linalg.norm(mean[:3]) < LOADS.max_bias:
            found[i] = mean
    return found


def calibrate_sensors(rig: Rig, observations: Iterable[Observation]) -> Rig:
    """Returns the rig with its sensors calibrated by a hand that touches nothing, still in several orientations.

    `calibrate_wrench` takes the means over `LOADS.still` seconds in which the sensors hardly turned. The fingers'
    sigmas become what it leaves, with the noise of single readings (`Finger.calibrated`). Raises InvalidInput, which
    names the finger, where there are too few orientations.
    """
    window, rows = list[Observation](), {name: list[Array]() for name in rig.fingers}
    for observation in observations:
        if observation.joint_positions is None or observation.T_world_palm is None:
            continue
        window.append(observation)
        if observation.stamp - window[0].stamp < LOADS.still:
            continue
        first, last = (
            np.array(o.T_world_palm) @ _sensors(rig, o.joint_positions)[2] for o in (window[0], window[-1])
        )
        readings, window = window, []
        turned = np.linalg.norm(se3.rotation_log(first[:, :3, :3].swapaxes(1, 2) @ last[:, :3, :3]), axis=1)
        if turned.max() > LOADS.still_turn or lacking(rig, readings):
            continue
        for R, (name, means) in zip(last[:, :3, :3], rows.items(), strict=True):
            wrenches = np.array([o.wrenches[name] for o in readings])
            means.append(np.hstack([wrenches.mean(axis=0), R.T @ rig.gravity, wrenches.var(axis=0, ddof=1)]))
    fingers = {}
    for name, finger in rig.fingers.items():
        F, M, G, v = np.split(np.array(rows[name]).reshape(-1, 15), [3, 6, 9], axis=1)
        try:
            found = calibrate_wrench(F, M, G, reading=finger.calibration.reading)
        except InvalidInput as error:
            raise InvalidInput(f"finger {name}: {error}") from None
        noise = np.sqrt([v[:, :3].mean(), v[:, 3:].mean()])
        fingers[name] = finger.calibrated(found, *np.maximum(noise, [1e-3, 5e-6]).tolist())
    return replace(rig, fingers=fingers)


def _sensors(rig: Rig, joint_positions: Mapping[str, float] | None) -> tuple[HandPose, list[int], Array]:
    """Returns the hand, the index of each finger's tip among its tips, and the pose of each sensor in the palm (t, 4,
    4)."""
    hand = rig.hand.kinematics(joint_positions or {})
    tips = [tuple(rig.hand.tips).index(name) for name in rig.fingers]
    at = ((f.T_frame_surface, f.tip.T_surface_sensor) for f in rig.fingers.values())
    Ts_tip_sensor = np.stack([T if T_sensor is None else T @ T_sensor for T, T_sensor in at])
    return hand, tips, hand.Ts_palm_tip[tips] @ Ts_tip_sensor
