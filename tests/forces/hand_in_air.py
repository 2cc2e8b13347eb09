"""Hands that hold an object in the air, and the readings of their fingertips' sensors, exact or with given errors."""

import functools
from dataclasses import dataclass, field

import numpy as np

from handsight import se3
from handsight.contact import Contacts
from handsight.observation import Observation
from handsight.simulation import Scenario, rig_of

MASS, CENTER = 0.15, np.array([-0.01, -0.085, 0.095])
TILTS = [
    np.zeros(3),
    np.array([0.35, 0, 0]),
    np.array([0, 0.35, 0]),
    np.array([-0.35, 0, 0]),
    np.array([0, -0.35, 0]),
]
STEP, INSTANTS = 0.01, 21
UPRIGHT = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])


@functools.cache
def rig():
    return rig_of(Scenario())


@dataclass
class Held:
    """An object in a hand whose joints, sensors and gravity may differ from the robot's model of them."""

    mass: float = MASS
    center_palm: np.ndarray = field(default_factory=lambda: CENTER)
    offsets: np.ndarray = None
    """By how much the joints read too much."""
    biases: np.ndarray = None
    """(t, 6)"""
    gains: np.ndarray = None
    """(t, 6) by which share the sensors read too much."""
    plumb: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) rotation vector by which gravity is turned in the world [rad]."""
    extra_palm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) force on the object at its centre of mass, fixed in the palm, beside those of the tips [N]."""
    empty: bool = False
    """Whether the tips touch nothing."""
    noise: float = 0.0
    """Noise of the readings, in sigmas of the sensors."""
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    shift_palm: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def joints(self, bend=0.0):
        names = rig().hand.moving
        rng = np.random.default_rng(3)
        low, high = np.clip(rig().hand.limits, -1, 1).T
        at = dict(
            zip(rig().hand.joint_names, low + rng.uniform(0.2, 0.6, len(low)) * (high - low), strict=True)
        )
        return {name: at[name] + bend for name in names}

    def observations(self, turn, start=0.0, acceleration=(0, 0, 0), bend=0.0, count=INSTANTS):
        """`count` of them with the palm turned in the world, and accelerated there [m/s²]."""
        R = se3.rotation_exp(np.asarray(turn, float)) @ UPRIGHT
        a = np.asarray(acceleration, float)
        gravity_palm = R.T @ (se3.rotation_exp(self.plumb) @ rig().gravity - a)
        wrenches, joints = self._read(gravity_palm, bend)
        found = []
        for k in range(count):
            t = k * STEP
            read = {
                name: row + self.noise * self._sigma() * self.rng.normal(size=6)
                for name, row in wrenches.items()
            }
            T = se3.compose(R, 0.5 * a * t * t)
            found.append(Observation(start + t, joints, read, None, T))
        return found

    def _sigma(self):
        finger = rig().fingers["ff"]
        return np.repeat([finger.sigma_force, finger.sigma_torque], 3)

    def _read(self, gravity_palm, bend):
        hand, names = rig().hand, list(rig().fingers)
        true = self.joints(bend)
        offsets = np.zeros(len(true)) if self.offsets is None else self.offsets
        read = {name: angle + off for (name, angle), off in zip(true.items(), offsets, strict=True)}
        Ts = [
            T @ sensor_frame(rig().fingers[name])
            for name, T in zip(names, hand.Ts_palm_tip(true), strict=True)
        ]
        rng = np.random.default_rng(5)  # a grip of its own, the same in all orientations
        loads = np.hstack([rng.normal(0, 1.5, (len(names), 3)), np.zeros((len(names), 3))])
        loads[2:4] = 0  # which touch nothing
        weight = self.mass * gravity_palm + self.extra_palm
        total = np.concatenate([weight, np.cross(self.center_palm, weight)])
        A = np.hstack([np.vstack([np.eye(3), se3.skew(T[:3, 3])]) for T in Ts])
        lacking = total - A @ loads[:, :3].ravel()
        weights = np.repeat([1.0, 1, 1e-6, 1e-6, 1], 3)
        loads[:, :3] += (weights * (A.T @ np.linalg.solve((A * weights) @ A.T, lacking))).reshape(-1, 3)
        loads *= not self.empty
        wrenches = {}
        for i, (name, T) in enumerate(zip(names, Ts, strict=True)):
            known, R = rig().fingers[name].calibration, T[:3, :3]
            f, g = R.T @ loads[i, :3], R.T @ gravity_palm
            sign = 1.0 if known.reading == "on_sensor" else -1.0
            read_load = np.concatenate([f + known.mass * g, np.cross(known.center_of_mass, known.mass * g)])
            if self.gains is not None:
                read_load = (1 + self.gains[i]) * read_load
            wrenches[name] = np.concatenate([known.bias_force, known.bias_torque]) + sign * read_load
            if self.biases is not None:
                wrenches[name] = wrenches[name] + sign * self.biases[i]
        return wrenches, read


def sensor_frame(finger):
    return finger.T_frame_surface @ finger.tip.T_surface_sensor


def touched(held, bend=0.0):
    """Returns, by finger that touches, the contact's point and normal at the joint positions that are read."""
    true = held.joints(bend)
    offsets = np.zeros(len(true)) if held.offsets is None else held.offsets
    read = {name: angle + off for (name, angle), off in zip(true.items(), offsets, strict=True)}
    found = {}
    for name, T in zip(rig().fingers, rig().hand.Ts_palm_tip(read), strict=True):
        if name in ("ff", "mf", "th"):
            frame = T @ rig().fingers[name].T_frame_surface
            found[name] = frame[:3, 3], frame[:3, 2]
    return found


def contacts(held, bend=0.0):
    """Returns the fingers that touch, and their contacts."""
    found = touched(held, bend)
    points, normals = (np.array(part) for part in zip(*found.values(), strict=True))
    return tuple(found), Contacts(points, normals)
