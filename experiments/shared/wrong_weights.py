"""Causes of a wrong weight, and how a tracker copes: whether it reports the cause, and the error of its pose.

Vision stays on, as errors of the camera are told from those of the pose only while the palm tilts.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

import numpy as np

import handsight as hs
from experiments.shared.grasp_trials import exact_model, rig
from handsight.objects import Symmetries
from handsight.simulation import Nuisances, Scenario, simulate
from testbed.report import Array, Row

MASS, OFF, FULL_SCALE = 0.15, 0.02, 80.0
"""Masses of the objects [kg], errors of a declared centre of mass [m], forces that no sensor measures [N]."""
USUAL = ("nothing is", "the palm has not risen", "a finger is on the table", "the object slips")
"""Beginnings of the reasons for not weighing that do not report an error."""


@dataclass(frozen=True)
class Wrong:
    """An error of the simulation, of the readings, or of what the robot believes."""

    nuisances: Mapping[str, float] = field(default_factory=dict)
    change: Callable[[Any], Any] = lambda observation: observation
    robot: Any = None
    mass: float = MASS
    center: Array = field(default_factory=lambda: np.zeros(3))


def ways(name: str, seed: int) -> dict[str, Wrong]:
    """Returns the causes by name, those of one object and seed."""
    direction = np.random.default_rng(seed).normal(size=3)
    bare = "lf" if name == "can" else "mf"
    sensed = {finger: known for finger, known in rig().fingers.items() if finger != bare}
    return {
        "nothing": Wrong(),
        "centre 20 mm off": Wrong(center=OFF * direction / np.linalg.norm(direction)),
        "mass 1.5 times": Wrong(mass=1.5 * MASS),
        "mass 1.2 times": Wrong(mass=1.2 * MASS),
        "mass 1.1 times": Wrong(mass=1.1 * MASS),
        "mass 0.9 times": Wrong(mass=0.9 * MASS),
        "gravity's sign": Wrong(robot=replace(rig(), gravity=-rig().gravity)),
        "dead thumb": Wrong(change=lambda o: _read(o, "th", np.full(6, np.nan))),
        "saturated thumb": Wrong(change=lambda o: _read(o, "th", np.full(6, FULL_SCALE))),
        "tip biased by 0.1 N": Wrong({"tip_bias": 0.1}),
        "0.1 N pressed unfelt": Wrong({"unsensed_force": 0.1}),
        "0.2 N pressed unfelt": Wrong({"unsensed_force": 0.2}),
        "finger without sensor": Wrong(robot=replace(rig(), fingers=sensed)),
        "0.2 N borne by a hand": Wrong({"support_force": 0.2}),
        "half borne by a table": Wrong({"support_force": MASS * 9.81 / 2}),
    }


def rows(name: str, seed: int, until: float) -> Iterator[Row]:
    """Yields a row for each cause for which the object was not dropped, by observations until then [s]."""
    simulated: dict[tuple[tuple[str, float], ...], list[Any]] = {}
    for what, wrong in ways(name, seed).items():
        key = tuple(wrong.nuisances.items())
        if key not in simulated:
            simulated[key] = _samples(name, seed, wrong.nuisances, until)
        samples, model = simulated[key], exact_model(name)
        if samples[-1].dropped:
            continue
        robot = wrong.robot or rig()
        _, _, without = _followed(hs.Tracker(robot, model), samples, wrong)
        # What is heavier on one side is not symmetric.
        own = replace(model, symmetries=Symmetries()) if wrong.center.any() else model
        known = own.with_weight(mass=wrong.mass, center_of_mass=wrong.center)
        ever, now, pose = _followed(hs.Tracker(robot, known), samples, wrong)
        yield {"what": what, "ever": ever, "now": now, "pose": pose, "without": without}


def _samples(name: str, seed: int, nuisances: Mapping[str, float], until: float) -> list[Any]:
    scenario = Scenario(object=name, seed=seed, motion="weigh", nuisances=replace(Nuisances(), **nuisances))
    return list(takewhile(lambda sample: sample.observation.stamp <= until, simulate(scenario)))


def _followed(tracker: Any, samples: list[Any], wrong: Wrong) -> tuple[float, float, float]:
    """Returns whether an error is reported, ever and at the end, and the error of the object's middle [mm]."""
    ever = now = False
    for sample in samples:
        estimate = tracker.update(wrong.change(sample.observation))
        now = _says(tracker)
        ever = ever or now
    T, T_true = tracker.model.nearest(estimate.T_palm_object, sample.T_palm_object), sample.T_palm_object
    return float(ever), float(now), 1e3 * float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))


def _says(tracker: Any) -> bool:
    weight = tracker.weight
    if weight is None:
        return not tracker.unweighed.startswith(USUAL)
    return bool(weight.reason or weight.biased or weight.assumed)


def _read(observation: Any, finger: str, wrench: Array) -> Any:
    return replace(observation, wrenches={**observation.wrenches, finger: wrench})
