"""A coupled joint that is measured elsewhere than its leader says is told, with both names and how far it is."""

from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight.live.live_tracker import LiveTracker
from handsight.rig.coupled_joints import CoupledJoints
from messages.ros import START, Messages, heard, raw
from simulation.own_hands import written


@pytest.fixture(scope="module")
def claw(tmp_path_factory):
    return hs.Rig.from_file(written(tmp_path_factory.mktemp("claw"), follows=(0.5, 0.1)))


def said(rig, off, outliers=0):
    """What is said where the middle joint of a finger is so far off its law [deg], and of the others a bit."""
    compared = CoupledJoints(rig)
    rng = np.random.default_rng(1)
    for k in range(1000):
        positions = dict(rig.hand.completed({name: rng.uniform(-0.8, 0.8) for name in rig.hand.needed}))
        positions["one_middle"] += np.deg2rad(off if k >= outliers else 90)
        positions["two_middle"] += np.deg2rad(3)
        compared.put(positions)
    return compared.sentences()


def test_a_joint_off_its_law_is_told_once_with_its_leader_and_by_how_much(claw):
    (sentence,) = said(claw, 9)
    assert "'one_middle'" in sentence
    assert "'one_knuckle'" in sentence
    assert "9.0°" in sentence


@pytest.mark.parametrize(("off", "outliers"), [(3, 0), (-3, 0), (0, 60)])
def test_what_sigmas_explain_and_outliers_are_not_told(claw, off, outliers):
    assert said(claw, off, outliers) == []


def test_the_rigs_sigma_decides(claw):
    assert len(said(replace(claw, sigma_coupled=np.deg2rad(0.2)), 3)) == 2
    assert said(replace(claw, sigma_coupled=np.deg2rad(4)), 9) == []


def test_joints_that_are_not_measured_are_not_told(claw):
    compared = CoupledJoints(claw)
    compared.put({"one_middle": 3.0, "two_knuckle": 0.1})
    assert compared.sentences() == []


def joint_states(rig, positions):
    """(topic, log, message) of twenty joint states."""
    topic = rig.topics.joint_states
    names, values = list(positions), list(positions.values())
    return [(topic, START + k / 100, Messages().joints(START + k / 100, names, values)) for k in range(20)]


def test_a_stream_and_a_live_tracker_complete_what_the_motors_say(claw):
    motors = dict.fromkeys(claw.hand.needed, 0.2)
    rows = joint_states(claw, motors)
    observations, stream = heard(rows, claw)
    every = claw.hand.completed(motors)
    assert all(observation.joint_positions == every for observation in observations)
    assert not [each for each in (*stream.lacks(), *stream.report.sentences()) if "joint" in each]
    live = LiveTracker(claw, hs.ObjectModel.box((0.06, 0.09, 0.14)), encoding="cdr", equal=True)
    seen = []
    live.show = lambda tracker: seen.append(tracker.processed)
    for row in rows:
        live.put(raw(*row))
    while not seen:
        live.step(0.1)
    assert all(observation.joint_positions == every for observation in seen)
    live.tracker.close()


def test_a_stream_tells_what_its_joint_states_contradict(claw):
    moved = {**claw.hand.completed(dict.fromkeys(claw.hand.needed, 0.2)), "one_middle": 0.9}
    _, stream = heard(joint_states(claw, moved), claw)
    (sentence,) = stream.report.coupled.sentences()
    assert "'one_middle'" in sentence
