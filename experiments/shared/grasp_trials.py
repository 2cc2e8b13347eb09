"""Simulated grasps as problems of one instant: what the robot knows at the end of a grasp, and the truth.

Contacts come from raw wrenches and joints, through the rig's own calibration; vision is the seen pose carried
into the palm, as uncertain as the rig says (its constant error and its noise). A grasp that dropped the object, or
touches it with no finger, is counted and told; nothing else is left out, and never for what a correction made
of it.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import count
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.simulation import Nuisances, Sample, Scenario, model_of, rig_of, simulate
from handsight.tracking import FingertipContacts, FingertipSensors, PoseBiasSmoother
from handsight.tracking.table import on_table
from testbed.report import Array
from testbed.touches import forces_object

OBJECTS = ("can", "box")
OUTSIDE = 500
"""Number of points of the hand's surface, shrunk by 1.5 mm, that cannot be inside the object."""
INSTANTS = 10.0
"""Observations per second of a grasp; only the last one is used."""


@dataclass(frozen=True)
class Trial:
    """A grasp at its last instant."""

    scenario: Scenario
    sample: Sample
    model: hs.ObjectModel
    """The robot's model of the object."""
    touch: FingertipContacts
    """The contacts of its fingertips, at least one."""
    vision: hs.PosePrior
    standing: hs.PosePrior
    """That prior, given that the object stands on the table."""
    outside: Array
    """Points (500, 3) of the hand in the palm [m]."""

    @property
    def contacts(self) -> hs.Contacts:
        """True pose (4, 4) in the palm."""
        assert self.touch.contacts is not None
        return self.touch.contacts


@cache
def rig() -> Any:
    """Returns the complete rig that the robot believes in, the same for both objects and all nuisances."""
    return rig_of(Scenario())


@cache
def fingertips() -> FingertipSensors:
    """Returns the sensors of the rig's fingertips."""
    return FingertipSensors(rig())


@cache
def surface() -> Any:
    """Returns the surface of its links without the tips, which touch the object."""
    return rig().hand.surface(OUTSIDE, without=[finger.frame for finger in rig().fingers.values()])


@lru_cache(maxsize=64)  # several experiments ask for the same grasp, and some for the same twice
def last_instant(scenario: Scenario) -> Sample:
    """Returns the sample at the end of a grasp."""
    *_, last = simulate(scenario)
    return last


def seen_in_palm(observation: Any) -> Array:
    """Returns T_palm_object (4, 4) as vision measures it."""
    T_world_object: Array = rig().camera.T_mount_camera @ observation.vision.T_frame_object
    T_palm_object: Array = se3.inverse(observation.T_world_palm) @ T_world_object
    return T_palm_object


def vision_prior(observation: Any) -> hs.PosePrior:
    """Returns vision's pose with the camera's constant error and noise as its covariance."""
    camera = rig().camera
    position = camera.sigma_position**2 + camera.sigma_position_constant**2
    rotation = camera.sigma_rotation**2 + camera.sigma_rotation_constant**2
    return hs.PosePrior(seen_in_palm(observation), np.diag([position] * 3 + [rotation] * 3))


def standing(prior: hs.PosePrior, model: hs.ObjectModel, T_world_palm: Array) -> hs.PosePrior:
    """Returns the prior given that the object stands on the table, or the same prior where that contradicts it."""
    no_bias = 1e-6 * np.eye(6)
    state = PoseBiasSmoother.from_prior(prior.T_palm_object, prior.covariance, no_bias, np.zeros(3)).now
    stood = on_table(state, model, rig().table, T_world_palm)
    return prior if stood is None else hs.PosePrior(stood.T_palm_object, stood.covariance[:6, :6])


def trial_of(scenario: Scenario, sample: Any, model: hs.ObjectModel | None = None) -> Trial | None:
    """Returns the problem of a sample; None where no finger touches. `model` is the robot's, if it is already built."""
    observation = sample.observation
    touch = fingertips().contacts(observation)
    if touch.contacts is None:
        return None
    model = model_of(scenario) if model is None else model
    vision = vision_prior(observation)
    stood = standing(vision, model, observation.T_world_palm)
    outside = surface().points_palm(observation.joint_positions)
    return Trial(scenario, sample, model, touch, vision, stood, outside)


@cache
def exact_model(name: str) -> hs.ObjectModel:
    """Returns the exact model of the object."""
    return model_of(Scenario(object=name))


def grasps(name: str, number: int, first: int, left_out: Any) -> Iterator[Trial]:
    """Returns `number` trials of an object with the usual nuisances, by seeds from `first` on.

    `left_out` counts why a seed gave none.
    """
    found = 0
    for seed in count(first):
        if found == number or seed - first > 3 * number:
            return
        scenario = Scenario(object=name, seed=seed, rate=INSTANTS)
        sample = last_instant(scenario)
        trial = None if sample.dropped else trial_of(scenario, sample, exact_model(name))
        if trial is None:
            left_out["dropped" if sample.dropped else "untouched"] += 1
            continue
        found += 1
        yield trial


def again(trial: Trial, **nuisances: Any) -> Trial | None:
    """Returns the same grasp with other nuisances; None where no finger touches."""
    changed = replace(trial.scenario, nuisances=replace(trial.scenario.nuisances, **nuisances))
    return trial_of(changed, last_instant(changed), trial.model)


def silent(trial: Trial) -> Counter[str]:
    """Returns how many fingers that truly touch have no contact, by reason."""
    pushed = forces_object(trial.sample)
    return Counter(reason for name, reason in trial.touch.reasons.items() if pushed.get(name, 0.0) > 0.1)


def sensing_errors(
    scenario: Scenario, draws: int, rng: np.random.Generator
) -> tuple[list[float], list[float]]:
    """Returns the errors of contacts [m]: without any noise, and with 10 mN and 0.05 mN m.

    Of tips that touch the object and nothing else, joints exact: sensing alone.
    """
    sample = last_instant(replace(scenario, nuisances=Nuisances.none()))
    usual = Nuisances()
    sigma = np.repeat([usual.force_noise, usual.torque_noise], 3)
    clean = _misplaced(sample, sample.observation)
    noisy = []
    for _ in range(draws):
        read = sample.observation.wrenches.items()
        wrenches = {name: wrench + sigma * rng.normal(size=6) for name, wrench in read}
        noisy += _misplaced(sample, replace(sample.observation, wrenches=wrenches))
    return clean, noisy


def _misplaced(sample: Any, observation: Any) -> list[float]:
    touch: Any = fingertips().contacts(observation)
    found = []
    for i, finger in enumerate(touch.fingers):
        truths = [t for t in sample.contacts_truth if t.finger == finger]
        if len(truths) == 1 and truths[0].other == "object":
            found.append(float(np.linalg.norm(touch.contacts.points_palm[i] - truths[0].point_palm)))
    return found
