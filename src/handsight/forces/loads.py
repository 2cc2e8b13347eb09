"""The loads on the hand's links over a short time: their sum with its uncertainty, and the sensors' biases.

A link's load is measured by a fingertip's six-axis sensor or by three-axis taxels on any link: both are load sensors.

The object's load (f, t) on each tip, at its sensor's origin s, adds up to F = Σ f and T = Σ (t + s × f) about the
palm's origin. Where the joints read δq too much, with J the tip's Jacobian at s, the tip seems turned by J_ω δq and
displaced by J_p δq, so F is wrong by -Σ [f]x J_ω δq and T by Σ (-[f]x J_p - [s]x [f]x J_ω - [t]x J_ω) δq.

A tip that moves through the air bears only its own weight. If the rest of its reading is constant in the tip's axes on
the way, it is the sensor's bias: the load of a touched object would change.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import TactileSurface, WrenchCalibration, calibrate_wrench
from handsight.contact.calibration import compensated
from handsight.correction.modes import chi2_limit
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.hand.chains import Chains
from handsight.observation import Observation, seconds
from handsight.rig import Rig

ORDER = 3  # of the polynomials that accelerations are read from (Savitzky and Golay 1964)
SPAN = 0.1  # length of a polynomial [s]
MIN_INSTANTS = 5  # fewest instants of a polynomial
SATURATED = 0.99  # a reading beyond this share of the sensor's full scale is not used
MIN_TRAVEL = 0.005  # a tip that moves so far in the palm in a window is in the air [m]
STILL = 0.3  # length of the means by which a sensor is calibrated [s]
STILL_TURN = np.deg2rad(0.5)  # a hand whose sensors turn less than this meanwhile is still [rad]
MAX_BIAS = 0.5  # a larger reading in the air is a load, or a broken sensor [N]
MIN_READINGS = 3  # fewest of a sensor that is slower than the joints
PATCH = 10  # taxels whose noise adds up in the force of a patch
UNSTEADY_P = 0.001
"""Readings vary by more than noise where noise would exceed their spread with less than this probability."""


LINK_TAXELS = "the taxels of {}"  # name of the load sensor that a link's taxels are


class LoadSensor(NamedTuple):
    """What measures the load on one link: a fingertip's six-axis sensor, or the link's three-axis taxels.

    Taxels have no bias, as the tracker has subtracted it, and nothing hangs on them.
    """

    name: str  # of its readings among an observation's wrenches: the finger's, or `LINK_TAXELS` with the link
    frame: str  # the link
    T_frame_sensor: Array  # (4, 4)
    calibration: WrenchCalibration
    sigma: Array  # (6,) noise of a reading [N, N m]
    sigma_gain: float  # constant relative error of the readings
    full_scale: tuple[float, float] = (np.inf, np.inf)  # largest force [N] and torque [N m] that it can read
    taxels: bool = False

    def readings(self, observations: Sequence[Observation]) -> Array:
        """Returns its readings (n, 6) in its own frame, of those observations that have one."""
        name = self.name
        found = [o.wrenches[name] for o in observations if name in o.wrenches]
        rows = np.concatenate(found).reshape(-1, 6) if found else np.empty((0, 6))
        if self.taxels:  # theirs are about the link's origin
            rows[:, 3:] -= np.cross(self.T_frame_sensor[:3, 3], rows[:, :3])
        return rows


def load_sensors(rig: Rig, names: Collection[str] = ()) -> tuple[LoadSensor, ...]:
    """Returns what measures the load on each finger, given the names of readings that came.

    It is the finger's six-axis sensor, or, where only its taxels are among the names, they are.
    """
    surfaces = dict[str, list[TactileSurface]]()
    for surface in rig.skin.values():
        if LINK_TAXELS.format(surface.frame) in names:
            surfaces.setdefault(surface.frame, []).append(surface)
    found = list[LoadSensor]()
    for name, finger in rig.fingers.items():
        own = surfaces.pop(finger.frame, None)
        if own is not None and name not in names:
            found.append(_of_taxels(finger.frame, own))
            continue
        T = finger.T_frame_surface
        T_sensor = finger.tip.T_surface_sensor
        T = T if T_sensor is None else T @ T_sensor
        sigma = np.repeat([finger.sigma_force, finger.sigma_torque], 3)
        rest = sigma, finger.sigma_gain, finger.full_scale or (np.inf, np.inf)
        found.append(LoadSensor(name, finger.frame, T, finger.calibration, *rest))
    return tuple(found)


def _of_taxels(frame: str, surfaces: Sequence[TactileSurface]) -> LoadSensor:
    """Returns the sensor that a link's taxels are, about their middle; its gain is as uncertain as a taxel's.

    A threshold is six standard deviations of noise at least: of four, it would be passed once a second without a touch.
    """
    points = np.concatenate([surface.points for surface in surfaces])
    middle = points.mean(axis=0)
    zero = np.zeros(3)
    noise = np.sqrt(PATCH) * max(surface.threshold for surface in surfaces) / 6
    arm = np.sqrt(((points - middle) ** 2).sum(axis=1).mean())
    sigma = noise * np.repeat([1.0, arm], 3)
    gain = max(surface.noise for surface in surfaces)
    nothing = WrenchCalibration(zero, zero, 1e-9, zero)
    name = LINK_TAXELS.format(frame)
    return LoadSensor(name, frame, se3.compose(np.eye(3), middle), nothing, sigma, gain, taxels=True)


@dataclass(frozen=True, slots=True, eq=False)
class LoadSum:
    """The sum of the loads on all t sensors (`load_sensors`), averaged over a short time.

    It is along the palm's axes, about the palm's origin.
    """

    stamp: float  # the middle of that time [s]
    wrench: Array  # (6,) force [N] and torque [N m] of the object on the tips
    gravity: Array  # (3,) gravity less the palm's acceleration [m/s²]: the weight of each kilogram
    R_palm_world: Array  # (3, 3) rotation of the world in the palm
    by_joint: Array  # (6, j) derivative of the wrench by the error of each joint
    by_bias: Array  # (6, 6 t) derivative of the wrench by the force and torque of each sensor's bias
    readings: Array
    """(6 t,) force [N] and torque [N m] that each sensor measures, with its tip's own weight, in its own axes."""
    noise: Array  # (6, 6) covariance of the wrench due to errors that change from reading to reading
    acceleration: float  # root mean square of the palm's acceleration, per axis [m/s²]
    turning: float  # root mean square of the palm's angular acceleration, per axis [rad/s²]
    Ts_palm_tip: Array  # (t, 4, 4) poses of the tips; of taxels, of their middles
    forces: Array  # (t, 3) force of the object on each of them [N]
    touched: Mapping[int, tuple[Array, Array]]
    """By index of a tip that touches: the contact's point (3,) in the palm [m], and its normal (3,)."""

    @property
    def middle_palm(self) -> Array:
        """(3,) the mean of the tips, weighted by their forces [m]."""
        pressed = np.sqrt((self.forces**2).sum(axis=1)) + 1e-9
        return np.asarray(pressed @ self.Ts_palm_tip[:, :3, 3] / pressed.sum())


def lacking(sensors: Sequence[LoadSensor], observations: Sequence[Observation]) -> str:
    """Returns why the observations do not measure the loads of all sensors; empty where they do."""
    alike = []
    six_axis = [sensor for sensor in sensors if not sensor.taxels]
    for sensor in sensors:
        readings = sensor.readings(observations)
        largest = np.abs(readings).max(axis=0, initial=0.0).reshape(2, 3).max(axis=1)
        if len(readings) < MIN_READINGS or not np.isfinite(largest).all():
            why = "measure no force: pressure alone, or full scale" if sensor.taxels else "is silent"
            return f"{sensor.name} {why}"
        alike += [sensor.name] if not sensor.taxels and (readings == readings[0]).all() else []
        if (largest >= SATURATED * np.array(sensor.full_scale)).any():
            return f"{sensor.name} is at the end of its sensor's scale"
    # If all of them read the same all the time, it is a simulation without noise.
    return f"{alike[0]} always reads the same" if 0 < len(alike) < len(six_axis) else ""


def load_sum(
    rig: Rig,
    observations: Sequence[Observation],
    touched: Mapping[str, tuple[Array, Array]],
    joints: Array,
    sensors: Sequence[LoadSensor] | None = None,
) -> LoadSum:
    """Returns the mean sum of loads over n observations, evenly spaced, of a grip that hardly changes.

    Nothing may be `lacking` in them. `touched`: by finger that touches, the contact's point in the palm [m], and its
    normal. `joints` (j,): the estimated offsets of the hand's moving joints, reading less true position [rad].
    `sensors`: what measures the loads; None: the fingers' six-axis sensors.
    """
    n = len(observations)
    sensors = load_sensors(rig) if sensors is None else sensors
    chains, learnt = _chains(rig.hand, tuple(sensor.frame for sensor in sensors))
    Ts_palm_link, axes = chains.poses(_mean_joints(rig.hand, chains, observations, joints))
    Ts_palm_sensor = Ts_palm_link @ np.array([sensor.T_frame_sensor for sensor in sensors])
    places = Ts_palm_sensor[:, :3, 3]
    middle = np.array([point for point, _ in touched.values()] or places).mean(axis=0)
    Ts_world_palm = np.array([o.T_world_palm for o in observations])
    step = (observations[-1].stamp - observations[0].stamp) / max(n - 1, 1)
    acceleration, turning = accelerations(Ts_world_palm, middle, step)
    gravity = np.einsum("nji,nj->i", Ts_world_palm[:, :3, :3], rig.gravity - acceleration) / n
    J = chains.jacobians(places.copy(), np.arange(len(sensors)), axes, learnt)
    wrench, by_joint, by_bias, readings, forces = _summed(sensors, observations, gravity, Ts_palm_sensor, J)
    by_encoder = rig.sigma_joint * by_joint @ rig.hand.couplings.changes(rig.hand.moving, {})
    taxels = np.array([sensor.taxels for sensor in sensors])
    index = {name: i for i, name in enumerate(rig.fingers)}
    return LoadSum(
        stamp=(observations[0].stamp + observations[-1].stamp) / 2,
        wrench=wrench,
        gravity=gravity,
        R_palm_world=Ts_world_palm[n // 2, :3, :3].T,
        by_joint=by_joint,
        by_bias=by_bias,
        readings=readings,
        noise=by_encoder @ by_encoder.T / n + _noise_of_sensors(sensors, by_bias, forces, n),
        acceleration=float(np.sqrt((acceleration**2).mean())),
        turning=float(np.sqrt((turning**2).mean())),
        Ts_palm_tip=np.where(taxels[:, None, None], Ts_palm_sensor, Ts_palm_link),
        forces=forces,
        touched={index[name]: contact for name, contact in touched.items()},
    )


def _mean_joints(
    hand: Hand, chains: Chains, observations: Sequence[Observation], joints: Array
) -> dict[str, float]:
    """Returns the mean position of each joint of chains less its estimated offset; `joints` (j,) are the offsets."""
    offsets = dict(zip(hand.moving, joints.tolist(), strict=True))
    rows: list[Mapping[str, float]] = [o.joint_positions or {} for o in observations]
    # In plain floats: NumPy takes longer to read so many from dicts than to add them up.
    return {
        name: sum([row[name] for row in rows]) / len(rows) - offsets.get(name, 0.0) for name in chains.joints
    }


def _noise_of_sensors(sensors: Sequence[LoadSensor], by_bias: Array, forces: Array, n: int) -> Array:
    """Returns the covariance (6, 6) of a sum of loads, each a mean of n readings, due to the readings' noise."""
    sigmas = np.array([sensor.sigma for sensor in sensors])
    passing = by_bias * sigmas.ravel()
    # Errors in proportion to a load, as of hysteresis, last longer than a mean.
    gains = np.array([sensor.taxels * sensor.sigma_gain for sensor in sensors]) / np.sqrt(PATCH)
    shares = gains * np.linalg.norm(forces, axis=1) / sigmas[:, 0]
    lasting = by_bias * (shares[:, None] * sigmas).ravel()
    return np.asarray(passing @ passing.T / n + lasting @ lasting.T)


def accelerations(Ts_world_palm: Array, point_palm: Array, step: float) -> tuple[Array, Array]:
    """Returns the acceleration (n, 3) of a point of the palm [m/s²] and the angular acceleration (n, 3) [rad/s²].

    Both are along the world's axes, from polynomials over `SPAN` through poses (n, 4, 4) that are `step` apart
    [s]. They are zero if there are fewer than `MIN_INSTANTS` poses.
    """
    n = len(Ts_world_palm)
    if n < MIN_INSTANTS or step <= 0:
        return np.zeros((n, 3)), np.zeros((n, 3))
    length = min(max(2 * round(SPAN / step / 2) + 1, MIN_INSTANTS), n - 1 + n % 2)
    turns = se3.rotation_log(Ts_world_palm[:, :3, :3] @ Ts_world_palm[n // 2, :3, :3].T)
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
    steps = np.arange(length)
    samples = np.arange(n)
    powers = np.vander(steps - length / 2, ORDER + 1, increasing=True)
    orders = np.arange(2, ORDER + 1)
    rows = (orders * (orders - 1) * powers[:, :-2]) @ np.linalg.pinv(powers)[2:]  # by step of the window
    first = np.clip(samples - length // 2, 0, n - length)
    derivative[samples[:, None], first[:, None] + steps] = rows[samples - first]
    return derivative


def _summed(
    sensors: Sequence[LoadSensor],
    observations: Sequence[Observation],
    gravity: Array,
    Ts_palm_sensor: Array,
    J: Array,
) -> tuple[Array, Array, Array, Array, Array]:
    """Returns the sum of mean loads (6,), its derivatives by joints and biases, the readings, and the forces (t, 3).
    `gravity` is that of a `LoadSum`, and `J` (t, 6, j) the Jacobians at the sensors' origins."""
    R = Ts_palm_sensor[:, :3, :3]
    s = Ts_palm_sensor[:, :3, 3]
    known = [each.calibration for each in sensors]
    means = [sensor.readings(observations).mean(axis=0) for sensor in sensors]
    measured = [compensated(x[:3], x[3:], np.zeros(3), one) for x, one in zip(means, known, strict=True)]
    readings = np.array(measured)  # (t, 2, 3), with the tips' own weight
    weights = np.array([[one.mass] for one in known]) * gravity
    centers = R @ np.array([one.center_of_mass for one in known])[:, :, None]
    F, M = (readings @ R.swapaxes(1, 2)).swapaxes(0, 1)
    f = F - weights
    m = M + (se3.skew(weights) @ centers)[:, :, 0]
    # The reading turns with the tip, the tip's own weight does not.
    S, by_force, turned = se3.skew(s), se3.skew(f), se3.skew(F)
    by_torque = by_force @ J[:, :3] + (S @ turned + se3.skew(m)) @ J[:, 3:]
    by_joint = -np.concatenate([turned @ J[:, 3:], by_torque], axis=1).sum(axis=0)
    by_bias = np.zeros((6, len(sensors), 6))
    by_bias[:3, :, :3] = by_bias[3:, :, 3:] = R.swapaxes(0, 1)
    by_bias[3:, :, :3] = (S @ R).swapaxes(0, 1)
    wrench = np.concatenate([f.sum(axis=0), (m + (S @ f[:, :, None])[:, :, 0]).sum(axis=0)])
    return wrench, by_joint, by_bias.reshape(6, -1), readings.ravel(), f


def read_in_air(
    rig: Rig, observations: Sequence[Observation], sensors: Sequence[LoadSensor] | None = None
) -> Array:
    """Returns (t, 6) the bias of each sensor (`load_sum`): its mean load in the air, in the sensor's frame [N, N m].

    It is NaN for one that may touch something: one that has hardly moved, or whose load has changed or is too large.
    `observations` are those of a short time, with joints and T_world_palm; nothing may be `lacking` in them.
    """
    sensors = load_sensors(rig) if sensors is None else sensors
    first, last = (_placed(rig, sensors, o) for o in (observations[0], observations[-1]))
    travel = np.linalg.norm(last[:, :3, 3] - first[:, :3, 3], axis=1)
    found = np.full((len(sensors), 6), np.nan)
    R_palm_world = np.asarray(observations[-1].T_world_palm)[:3, :3].T
    for i in np.flatnonzero(travel > MIN_TRAVEL).tolist():
        sensor = sensors[i]
        readings = sensors[i].readings(observations)
        gravity = last[i, :3, :3].T @ R_palm_world @ rig.gravity
        loads = np.hstack(compensated(readings[:, :3], readings[:, 3:], gravity, sensor.calibration))
        mean = loads.mean(axis=0)
        spread = ((loads[:, :3] - mean[:3]) ** 2).sum() / sensor.sigma[0] ** 2
        limit = chi2_limit(3 * (len(readings) - 1), UNSTEADY_P)
        if spread < limit and np.linalg.norm(mean[:3]) < MAX_BIAS:
            found[i] = mean
    return found


def calibrate_sensors(rig: Rig, observations: Iterable[Observation]) -> Rig:
    """Returns the rig with its sensors calibrated by a hand that touches nothing, still in several orientations.

    `calibrate_wrench` takes the means over `STILL` seconds in which the sensors hardly turned. The fingers'
    sigmas become what it leaves, with the noise of single readings (`Finger.calibrated`). Raises InvalidInput, which
    names the finger, where there are too few orientations.
    """
    window = list[Observation]()
    rows = {name: list[Array]() for name in rig.fingers}
    sensors = load_sensors(rig)
    for observation in observations:
        if observation.joint_positions is None or observation.T_world_palm is None:
            continue
        window.append(observation)
        if seconds(observation.stamp, window[0].stamp) < STILL:
            continue
        first, last = (np.array(o.T_world_palm) @ _placed(rig, sensors, o) for o in (window[0], window[-1]))
        readings = window
        window = []
        turned = np.linalg.norm(se3.rotation_log(first[:, :3, :3].swapaxes(1, 2) @ last[:, :3, :3]), axis=1)
        if turned.max() > STILL_TURN or lacking(sensors, readings):
            continue
        for R, (name, means) in zip(last[:, :3, :3], rows.items(), strict=True):
            wrenches = np.array([o.wrenches[name] for o in readings if name in o.wrenches])
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


def _placed(rig: Rig, sensors: Sequence[LoadSensor], observation: Observation) -> Array:
    """Returns the pose of each sensor in the palm (t, 4, 4)."""
    chains, _ = _chains(rig.hand, tuple(sensor.frame for sensor in sensors))
    Ts_frame_sensor = np.array([sensor.T_frame_sensor for sensor in sensors])
    return np.asarray(chains.poses(observation.joint_positions or {})[0] @ Ts_frame_sensor)


@lru_cache(maxsize=32)
def _chains(hand: Hand, frames: tuple[str, ...]) -> tuple[Chains, Array]:
    """Returns how the links of load sensors move in the palm, and which of the joints (k,) between are which of the
    hand's (j,) whose offsets are learnt, as a matrix (k, j); others are taken to be exact."""
    chains = hand.chains_to({frame: frame for frame in frames})
    return chains, np.equal.outer(chains.joints, hand.moving).astype(float)
