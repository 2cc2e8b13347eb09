"""A tracker weighs the object in the air: a known centre of mass measures the pose, an unknown one is estimated."""

import re
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight.objects import Symmetries
from handsight.simulation import Scenario, model_of, rig_of
from handsight.tracking import best_weight

SCENARIO = Scenario(object="box", seed=2, motion="weigh", rate=50)


@pytest.fixture(scope="module")
def lifted(simulated):
    """A box that is lifted and tilted, up to the third orientation; vision sees it for two seconds."""
    samples = [sample for sample in simulated(SCENARIO) if sample.observation.stamp < 6.95]
    return [
        replace(
            sample.observation, vision=sample.observation.vision if sample.observation.stamp < 2 else None
        )
        for sample in samples
    ], samples


def middle_error(tracker, sample):
    T, T_true = tracker.estimate.T_palm_object, sample.T_palm_object
    return np.linalg.norm(T[:3, 3] - T_true[:3, 3])


def follow(tracker, observations):
    for observation in observations:
        tracker.update(observation)
    return tracker


@pytest.mark.slow
def test_the_weight_of_an_object_with_a_known_centre_of_mass_measures_its_pose(lifted):
    observations, samples = lifted
    rig, model = rig_of(SCENARIO), model_of(SCENARIO)
    without = follow(hs.Tracker(rig, model), observations)
    tracker = follow(hs.Tracker(rig, model.with_weight(center_of_mass=np.zeros(3))), observations)
    assert middle_error(tracker, samples[-1]) < 0.004
    assert middle_error(tracker, samples[-1]) < middle_error(without, samples[-1])
    assert tracker.sigma < without.sigma
    assert tracker.estimate.weight_fits is True
    assert tracker.weight.reason == ""
    assert abs(tracker.weight.mass - 0.15) < 3 * tracker.weight.sigma_mass


@pytest.mark.slow
@pytest.mark.parametrize("off", [-0.015, 0.015])
def test_a_table_that_is_elsewhere_is_found_by_the_weight_or_said(lifted, off):
    """The table is believed five sigmas off. Fingers hold the box at its sides, vision has a constant error: nothing but
    the weight, in three directions, says how high the box is in the hand."""
    observations, samples = lifted
    rig, model = rig_of(SCENARIO), model_of(SCENARIO)
    wrong = replace(rig, table=replace(rig.table, height=rig.table.height + off))
    without = follow(hs.Tracker(wrong, model), observations)
    tracker = follow(hs.Tracker(wrong, model.with_weight(center_of_mass=np.zeros(3))), observations)
    assert middle_error(without, samples[-1]) > 0.01
    near = middle_error(tracker, samples[-1]) < 0.006
    assert near or (tracker.state == "uncertain" and tracker.reason)
    assert near == (tracker.estimate.weight_fits is True)


@pytest.mark.slow
def test_an_unknown_centre_of_mass_is_estimated(lifted):
    observations, samples = lifted
    tracker = follow(hs.Tracker(rig_of(SCENARIO), model_of(SCENARIO)), observations)
    found, T = tracker.weight, samples[-1].T_palm_object
    assert tracker.estimate.weight_fits is None
    assert found.directions >= 3
    off = found.center_palm - T[:3, 3]
    assert off @ np.linalg.solve(found.covariance_palm, off) < 16.3
    assert np.linalg.norm(off) < 0.004
    off = found.center_object
    assert off @ np.linalg.solve(found.covariance, off) < 16.3


@pytest.mark.slow
def test_a_wrong_mass_is_reported_and_the_pose_is_no_worse(lifted):
    observations, _ = lifted
    rig, model = rig_of(SCENARIO), model_of(SCENARIO)
    wrong = follow(hs.Tracker(rig, model.with_weight(mass=0.3, center_of_mass=np.zeros(3))), observations)
    without = follow(hs.Tracker(rig, model), observations)
    assert wrong.weight.reason.startswith("it weighs ")
    assert wrong.estimate.weight_fits is None
    np.testing.assert_allclose(wrong.estimate.T_palm_object, without.estimate.T_palm_object, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "declared", "is_other"),
    [
        (0.094, {"mass": 0.19}, True),
        (0.086, {"mass": 0.12}, True),
        (0.09, {"mass": 0.19}, True),
        (0.09, {"mass": 0.19, "sigma_mass": 0.03}, False),
        (0.09, {"mass": 0.15}, False),
        (0.09, {"mass": 0.157}, False),
    ],
)
def test_an_object_that_touch_cannot_tell_from_the_model_is_told_by_its_mass(
    lifted, width, declared, is_other
):
    """A box of another width fits the same fingertips. One that is as heavy as declared is never doubted."""
    observations, _ = lifted
    rig, model = rig_of(SCENARIO), hs.ObjectModel.box((0.06, width, 0.14)).with_weight(**declared)
    tracker, said = hs.Tracker(rig, model), []
    for observation in observations:
        tracker.update(observation)
        said.append("another object" in tracker.reason)
    assert any(said) == is_other
    assert (tracker.state == "uncertain" and said[-1]) == is_other


@pytest.mark.slow
def test_gravity_of_the_wrong_sign_is_reported_and_the_pose_uncertain(lifted):
    """It makes the tips' own weight wrong in every contact."""
    observations, _ = lifted
    rig = rig_of(SCENARIO)
    tracker = follow(hs.Tracker(replace(rig, gravity=-rig.gravity), model_of(SCENARIO)), observations)
    assert tracker.weight.reason.endswith("does gravity point the other way?")
    assert tracker.state == "uncertain"
    assert tracker.reason == tracker.weight.reason


@pytest.mark.slow
def test_a_weight_that_fits_in_three_directions_makes_what_contradicts_it_uncertain(lifted):
    """Which of them is wrong is not known: here it is the declared centre of mass."""
    seen = [sample.observation for sample in lifted[1]]
    model = replace(model_of(SCENARIO), symmetries=Symmetries())
    wrong = model.with_weight(center_of_mass=np.array([0.0, 0.02, 0.0]))
    tracker = follow(hs.Tracker(rig_of(SCENARIO), wrong), seen)
    assert tracker.estimate.weight_fits is False
    assert re.match(
        r"the weight has contradicted the rest by \d+ sigma: contacts, vision and the table have the centre of mass \d+ mm from where",
        tracker.reason,
    )
    assert tracker.state == "uncertain"


@pytest.mark.slow
def test_the_best_weighing_of_a_recording_is_found(lifted):
    observations, _ = lifted
    found, reason = best_weight(iter(observations), hs.Tracker(rig_of(SCENARIO), model_of(SCENARIO)))
    assert reason == ""
    assert abs(found.mass - 0.15) < 3 * found.sigma_mass
    on_table = [observation for observation in observations if observation.stamp < 1.9]
    none, reason = best_weight(iter(on_table), hs.Tracker(rig_of(SCENARIO), model_of(SCENARIO)))
    assert none is None
    assert reason == "the object was never in the air"
    assert len(on_table) > 10


def test_an_object_that_stands_on_the_table_is_not_weighed(can):
    """The palm has not risen since the grasp."""
    tracker = follow(hs.Tracker(can.rig, can.model.with_weight(center_of_mass=np.zeros(3))), can.observations)
    assert tracker.weight is None
    assert tracker.unweighed == "the palm has not risen since the grasp"
    assert tracker.estimate.weight_fits is None
