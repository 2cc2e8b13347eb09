"""A tracker with a tactile array, whose pressed taxels are contacts beside those of the fingertips."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.simulation import Scenario, model_of, rig_of
from handsight.tracking import SkinContacts, SkinSensors
from testbed.refusals import refused

SCENARIO = Scenario(object="can", seed=1, motion="grasp", rate=50, skin=True)
RIG = rig_of(SCENARIO)


@pytest.fixture(scope="module")
def grasp(simulated):
    return simulated(SCENARIO)


def followed(samples, rig=RIG):
    tracker = hs.Tracker(rig, model_of(SCENARIO))
    for sample in samples:
        tracker.update(sample.observation)
    return tracker


def test_a_tactile_array_improves_the_trackers_pose(grasp):
    """Without a table, contacts on the can's side do not measure its position along its axis."""
    rig, axis = replace(RIG, table=None), grasp[-1].T_palm_object[:3, 2]
    without = [replace(sample, observation=replace(sample.observation, skin={})) for sample in grasp]
    errors = []
    for samples in (without, grasp):
        tracker = followed(samples, rig)
        shift = tracker.estimate.T_palm_object[:3, 3] - grasp[-1].T_palm_object[:3, 3]
        errors.append(abs(shift @ axis))
        assert tracker.estimate.consistent
    assert errors[1] < 3e-3
    assert errors[1] < errors[0] / 3
    assert tracker.skin.pressed


def test_offsets_and_dead_taxels_are_learnt_before_the_first_touch():
    array, rng = RIG.skin["palm"], np.random.default_rng(0)
    sensors, offset = SkinSensors(RIG), rng.normal(size=array.shape)
    observation, skin = hs.Observation(0.0), SkinContacts()

    def observed(reading, *, touched):
        nonlocal skin
        skin = sensors.observed(replace(observation, skin={"palm": reading}), skin, touched=touched)
        return skin.touches["palm"][0]

    for _ in range(10):
        reading = offset + 0.001 * rng.normal(size=array.shape)
        reading[3, 3], reading[4, 4] = 0.0, array.full_scale  # one never changes, one is stuck
        observed(reading, touched=False)
    pressed = offset.copy()
    pressed[8:12, 5:9] += 0.1
    pressed[3, 3], pressed[4, 4] = 0.0, array.full_scale
    touch = observed(pressed, touched=True)
    assert touch.pressed.sum() == 16
    assert touch.pressed[8:12, 5:9].all()
    assert not touch.untouched[[3, 4], [3, 4]].any()
    assert touch.untouched.sum() == touch.untouched.size - 18


def test_an_array_on_a_finger_moves_with_it_and_is_as_uncertain_as_its_joints():
    array = replace(RIG.skin["palm"], frame="robot0:ffmiddle")
    sensors = SkinSensors(replace(RIG, skin={"palm": array}))
    reading = np.zeros(array.shape)
    reading[5:8, 5:8] = 1.0
    joints = dict.fromkeys(RIG.hand.joint_names, 0.3)
    observation = hs.Observation(0.0, joints, skin={"palm": reading})
    observed = sensors.observed(observation, touched=True)
    T = RIG.hand.link_poses(joints)["robot0:ffmiddle"]
    expected = array.touch(reading).contacts(T)
    np.testing.assert_allclose(observed.contacts().points_palm, expected.points_palm, atol=1e-12)
    fixed = SkinSensors(RIG).observed(observation, touched=True)
    assert (observed.evidence().sigmas > fixed.evidence().sigmas).any()
    assert not sensors.observed(replace(observation, joint_positions=None), touched=True).touches


def test_readings_of_another_shape_are_refused_and_change_nothing(grasp):
    tracker = followed(grasp[:60])
    known = tracker.skin
    wrong = replace(grasp[60].observation, skin={"palm": np.zeros((3, 3))})
    with refused(InvalidInput, "observation.skin['palm']"):
        tracker.update(wrong)
    assert tracker.skin is known
    assert tracker.refused == 1


def test_an_object_that_lies_on_the_skin_is_not_weighed(grasp):
    """The palm bears a part of it. Here the palm has risen, so that nothing else keeps it from being weighed."""
    risen = [
        replace(each, observation=replace(each.observation, T_world_palm=lifted))
        for k, each in enumerate(grasp)
        for lifted in [se3.compose(np.eye(3), np.array([0, 0, 1e-4 * k])) @ each.observation.T_world_palm]
    ]
    tracker = followed(risen, replace(RIG, table=None))
    assert tracker.track_state.belief.grasp.lifted
    assert tracker.weight is None
    assert tracker.unweighed == "a link beside the fingertips bears a part of it"
