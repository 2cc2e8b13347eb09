"""What a recording tells of a rig's declared values: right ones agree, a wrong one is named, with its error."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handsight.observation import Observation
from handsight.rig import Rig
from handsight.simulation import Nuisances, Scenario, model_of, rig_of, simulate
from handsight.tracking import Diagnosed, diagnose
from handsight.tracking.verdicts import diagnosed

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics")

GRASPS = 8


@cache
def session() -> tuple[Observation, ...]:
    """Returns a recording in which a robot without errors grasps the can again and again."""
    observations: list[Observation] = []
    for seed in range(GRASPS):
        begin = observations[-1].stamp + 0.5 if observations else 0.0
        scenario = Scenario(object="can", seed=seed, rate=50.0, nuisances=Nuisances.none())
        observations += [
            replace(sample.observation, stamp=sample.observation.stamp + begin)
            for sample in simulate(scenario)
        ]
    return tuple(observations)


def declared(*, radius: float = 0.0, angle: float = 0.0) -> Rig:
    """Returns the rig of a hand with well known joints, whose middle finger's tip is declared too small by `radius`.

    The declared sigmas are 0.1° for joints and 0.3 mm for tips.
    """
    rig = rig_of(Scenario(object="can"))
    fingers = {name: replace(finger, sigma_point=3e-4) for name, finger in rig.fingers.items()}
    fingers["mf"] = replace(fingers["mf"], tip=fingers["mf"].tip.larger(-radius))
    return replace(rig, fingers=fingers, sigma_joint_offset=float(np.deg2rad(0.1)))


@cache
def found(radius: float) -> dict[str, Diagnosed]:
    """Returns the diagnosis of the session, by name, where a tip is declared too small by `radius`."""
    diagnosis = diagnose(session(), declared(radius=radius), model_of(Scenario(object="can")))
    assert diagnosis.instants >= 5
    assert {value.name for value in diagnosis.wrong} == {v.name for v in diagnosis.values if v.wrong}
    return {value.name: value for value in diagnosis.values}


def test_what_is_declared_rightly_is_not_called_wrong() -> None:
    assert not any(value.wrong for value in found(0.0).values())
    measured = [value for value in found(0.0).values() if value.name.startswith("tip") and value.measured]
    # The simulated tips are soft: they give way by up to 0.4 mm.
    assert len(measured) >= 3
    assert all(abs(value.estimated - value.declared) < 0.5 for value in measured)


@pytest.mark.parametrize("radius", [0.002, -0.002])
def test_a_tip_of_another_radius_is_named_with_its_error(radius: float) -> None:
    tip = found(radius)["tip mf radius"]
    assert tip.wrong
    assert abs(tip.estimated - tip.declared - 1e3 * radius) < 0.4
    assert ("larger" if radius > 0 else "smaller") in tip.verdict


@cache
def in_air(seed: int) -> list[Observation]:
    """Returns a recording of a box that is lifted and tilted by a robot without errors."""
    scenario = Scenario(object="box", seed=seed, motion="weigh", rate=50.0, nuisances=Nuisances.none())
    return [sample.observation for sample in simulate(scenario)]


@cache
def weighed(gain: float, shown: float = 0.02) -> dict[str, Diagnosed]:
    """Returns the diagnosis of a box in two grasps in the air, by name, where the thumb's sensor reads a share too
    much; each axis' gain is declared with the sigma `shown`."""
    rig = rig_of(Scenario(object="box"))
    fingers = {name: replace(finger, sigma_gain=shown) for name, finger in rig.fingers.items()}
    known = fingers["th"].calibration
    bias = np.concatenate([known.bias_force, known.bias_torque])
    observations: list[Observation] = []
    for seed in range(2):
        begin = observations[-1].stamp + 0.5 if observations else 0.0
        for seen in in_air(seed):
            louder = bias + (1 + gain) * (seen.wrenches["th"] - bias)
            observations.append(
                replace(seen, stamp=seen.stamp + begin, wrenches={**seen.wrenches, "th": louder})
            )
    diagnosis = diagnose(observations, replace(rig, fingers=fingers), model_of(Scenario(object="box")))
    return {value.name: value for value in diagnosis.values}


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.1, -0.1])
def test_a_sensor_with_a_wrong_gain_is_named_alone_and_right_ones_are_not(gain: float) -> None:
    right, values = weighed(0.0), weighed(gain)
    assert not any(value.wrong for value in right.values())
    assert {name for name, value in values.items() if value.wrong} == {"sensor th gain"}
    found = values["sensor th gain"]
    assert abs(found.estimated - 100 * (1 + gain / (1 + gain))) < 4 * found.sigma_estimated
    assert ("larger" if gain > 0 else "smaller") in found.verdict


@pytest.mark.slow
def test_a_gain_that_is_declared_exact_is_not_measured() -> None:
    assert not weighed(0.1, 0.0)["sensor th gain"].measured


def test_a_finger_that_never_touches_tells_nothing() -> None:
    rig = declared()
    without = [replace(o, wrenches={n: w for n, w in o.wrenches.items() if n != "lf"}) for o in session()]
    values = {v.name: v for v in diagnose(without, rig, model_of(Scenario(object="can"))).values}
    assert not values["tip lf radius"].measured
    assert values["tip lf radius"].verdict == "not measured by this recording"
    assert values["tip lf radius"].numbers()["estimated"] is None


def test_a_value_that_is_declared_exact_is_not_measured() -> None:
    value = diagnosed("camera shift x", "mm", 0.0, 0.0, 0.0, 0.0)
    assert not value.measured
    assert not value.wrong


def test_a_recording_without_touch_tells_nothing_of_the_hand() -> None:
    observations = [replace(o, wrenches={}) for o in session()[:100]]
    diagnosis = diagnose(observations, declared(), model_of(Scenario(object="can")))
    assert diagnosis.instants == 0
    assert not any(value.measured or value.wrong for value in diagnosis.values)


@pytest.mark.slow
def test_a_late_camera_and_a_wrong_mass_are_measured_from_one_manipulation() -> None:
    late = Nuisances(vision_delay=0.2)
    scenario = Scenario(object="can", seed=3, motion="manipulate", rate=50.0, nuisances=late)
    model = model_of(scenario).with_weight(mass=0.2, center_of_mass=np.zeros(3))  # it weighs 0.15 kg
    observations = [sample.observation for sample in simulate(scenario)]
    values = {v.name: v for v in diagnose(observations, rig_of(scenario), model).values}
    latency, mass, height = values["camera latency"], values["object mass"], values["table height"]
    assert latency.measured
    assert abs(latency.estimated - 200) < 4 * latency.sigma_estimated
    assert latency.sigma_estimated < 40
    assert mass.wrong
    assert abs(mass.estimated - 150) < 10
    assert "smaller than declared" in mass.verdict
    assert not height.wrong
