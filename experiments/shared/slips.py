"""Pulls that make an object slip in the simulated hand, and which of its slips count as detected."""

import numpy as np

from handsight.simulation import Nuisances, Profile, Sample, Scenario
from testbed.report import Array, Row
from testbed.touches import forces_object

PRESSED = 0.2
"""Force on a tip below which it is ignored [N]."""
FAST, SLOW = 3e-3, 5e-4
"""The object slips if all tips slide faster than the first speed, and holds if one is slower than the second [m/s]."""
NEAR, JOINED, LEAST = 0.02, 0.1, 1e-3
"""Largest time between an alarm and its slip [s]; time below which two slips are one [s]; shortest slip [m]."""
MOTIONS: tuple[Profile, ...] = ("ramp", "steps", "sine", "creep", "jerks")
FORCES, TORQUES = {"box": (3.0, 9.0), "can": (6.0, 16.0)}, {"box": (0.02, 0.08), "can": (0.04, 0.16)}
"""Ranges of the pulls' forces [N] and torques [N m]."""


def scenario(name: str, seed: int, rate: float) -> Scenario:
    """Returns a pull drawn by the seed; every second one has a torque, and jerks are half as strong again."""
    rng, motion = np.random.default_rng((seed, 99)), MOTIONS[seed % len(MOTIONS)]
    friction, force, torque = rng.uniform(0.3, 0.8), rng.uniform(*FORCES[name]), rng.uniform(*TORQUES[name])
    force *= 1.5 if motion == "jerks" else 1.0
    nuisances = Nuisances(friction=friction, pull_force=force, pull_torque=torque if seed % 2 else 0.0)
    return Scenario(object=name, seed=seed, motion=motion, rate=rate, nuisances=nuisances)


def speed(sample: Sample) -> float:
    """Returns the smallest slip speed among the tips that press the object [m/s]; 0 where none does."""
    forces = forces_object(sample)
    return min((t.speed for finger, t in sample.touches.items() if forces[finger] > PRESSED), default=0.0)


def counted(alarms: Array, speeds: Array, period: float) -> Row:
    """Returns how many samples had an alarm, a right one, a strictly right one, and how many slipped.

    `found` counts those that slipped and had an alarm.
    """
    around = np.ones(2 * round(NEAR / period) + 1)
    right, strictly = (np.convolve(speeds > least, around, "same") > 0 for least in (SLOW, FAST))
    slipped = speeds > FAST
    numbers = {
        "alarmed": alarms, "right": alarms & right, "strict": alarms & strictly, "slipped": slipped,
        "found": alarms & slipped,
    }  # fmt: skip
    return {name: int(flags.sum()) for name, flags in numbers.items()}


def delays(alarms: Array, speeds: Array, stamps: Array) -> list[float | None]:
    """Returns the delay of each slip's alarm [s], negative if it began before the slip; None if there was none."""
    found: list[float | None] = []
    period = float(stamps[1] - stamps[0])
    ringing = runs(alarms, 0.0, period)
    for begin, end in runs(speeds > FAST, JOINED, period):
        if speeds[begin:end].sum() * period < LEAST:
            continue
        mine = [first for first, last in ringing if first < end and last > begin - round(NEAR / period)]
        found.append(float(stamps[mine[0]] - stamps[begin]) if mine else None)
    return found


def runs(flags: Array, joined: float, period: float) -> list[tuple[int, int]]:
    """Returns begin and end of each time that flags are set; those less than `joined` [s] apart are one."""
    edges = np.diff(np.r_[0, flags.astype(int), 0])
    found: list[tuple[int, int]] = []
    for begin, end in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        if found and (begin - found[-1][1]) * period < joined:
            found[-1] = found[-1][0], int(end)
        else:
            found.append((int(begin), int(end)))
    return found
