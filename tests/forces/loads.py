"""Simulated loads on fingertips, within and on the friction cone."""

from types import SimpleNamespace

import numpy as np

from handsight.forces import FRICTION

RATE = 500.0
FINGERS = ("ff", "mf", "th")


def rig(sigma_force=0.01, fingers=FINGERS):
    """A rig with the fields that a slip detector reads."""
    part = SimpleNamespace(
        sigma_force=sigma_force,
        sigma_torque=sigma_force * FRICTION.torsion,
        friction=None,
        sigma_friction=0.1,
        frame="tip",
        T_frame_surface=np.eye(4),
        tip=SimpleNamespace(T_surface_sensor=None),
        calibration=None,
        sigma_gain=0.0,
        full_scale=None,
    )
    return SimpleNamespace(fingers=dict.fromkeys(fingers, part), skin={})


def load(ratio, normal=2.0, angle=0.0, twist=0.0):
    """(5,) of a contact with normal z: `ratio` of sideways to normal load, a share `twist` of it as torque."""
    along = ratio * normal * np.sqrt(1 - twist**2)
    return np.array(
        [along * np.cos(angle), along * np.sin(angle), 0.0, normal, ratio * normal * twist * FRICTION.torsion]
    )


def sliding(mu, seconds=1.0, turns=2.0, finger="th", others=0.3):
    """Yields loads (n, 5) of a closing hand, one of whose fingers slides along the cone while the others stick."""
    for k in range(round(seconds * RATE)):
        angle = 2 * np.pi * turns * k / (seconds * RATE)
        yield np.array(
            [load(mu if name == finger else others * mu, angle=angle, twist=0.3) for name in FINGERS]
        )


def steady(loads, seconds):
    """The same loads again and again."""
    for _ in range(round(seconds * RATE)):
        yield np.asarray(loads)


class Clock:
    """Gives a detector one array of loads after another."""

    def __init__(self, detector, fingers=FINGERS, rate=RATE):
        self.detector, self.fingers, self.rate, self.now = detector, fingers, rate, 0.0

    def run(self, arrays, rng=None, sigma=0.0):
        """Returns the detector's answer to each array of loads."""
        answers = []
        for loads in arrays:
            self.now += 1 / self.rate
            noise = (
                0.0 if rng is None else sigma * rng.normal(size=loads.shape) * [1, 1, 1, 1, FRICTION.torsion]
            )
            answers.append(self.detector.update(self.now, self.fingers, loads + noise))
        return answers


def push(mu, rng, noise=0.02, rate=250.0):
    """Loads (n, 5) of one finger that pushes an object, and whether it slides (n,).

    It sticks at several ratios, some near the cone, then slides straight along; its normal force and the friction vary,
    and readings have the noise of a force and torque sensor [N].
    """
    ratios, slides = [], []
    for _ in range(3):
        for level, seconds in ((rng.uniform(0.2, 0.6), 0.6), (rng.uniform(0.6, 0.85), 0.4), (1.0, 1.2)):
            n = round(seconds * rate)
            ratios.append(np.linspace(ratios[-1][-1] if ratios else 0.0, level, 10))
            ratios.append(level * (1 + 0.02 * _smooth(rng, n)))
            slides += [False] * 10 + [level == 1.0] * n
    ratio = mu * np.concatenate(ratios)
    normal = rng.uniform(2, 4) * np.exp(0.2 * _smooth(rng, len(ratio)))
    loads = np.zeros((len(ratio), 5))
    loads[:, 0] = ratio * normal
    loads[:, 3] = normal
    loads += noise * rng.normal(size=loads.shape) * [1, 1, 0, 1, FRICTION.torsion]
    return loads, np.array(slides)


def _smooth(rng, n, window=40):
    """(n,) of unit variance, each like those up to `window` samples away."""
    return np.convolve(rng.normal(size=n + window - 1), np.full(window, window**-0.5), "valid")
