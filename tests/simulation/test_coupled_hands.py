"""Hands with coupled joints in simulation: joints without a motor follow those that have one, and a recording of the
motors alone is tracked as well as one of all joints."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from cli.commands import called
from hand.hands import data_file
from handsight import se3
from handsight.errors import InvalidInput, InvalidObject
from handsight.recording import Recording
from handsight.simulation import Nuisances, Scenario, model_of, read_grasp, rig_of, simulate
from handsight.simulation.motion import Grasp
from handsight.simulation.scene import scene
from handsight.simulation.simulate import Sensors, samples
from handsight.simulation.world import World
from simulation.own_hands import written
from testbed.refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::handsight.hand.HandWarning")
INSPIRE = "hands/inspire_hand/inspire_hand_right.urdf"
KNUCKLES = ("one_knuckle", "two_knuckle", "three_knuckle")
IN_THE_AIR = Grasp(
    T_palm_middle=se3.compose(np.eye(3), np.array([0.0, 0.0, 0.4])),
    opening=dict.fromkeys(KNUCKLES, -0.2),
    closed=dict.fromkeys(KNUCKLES, 0.5),
    height=0.07,
)
"""The fingers bend in front of the object."""


@pytest.fixture(scope="module")
def claw(tmp_path_factory):
    return hs.Rig.from_file(written(tmp_path_factory.mktemp("claw"), follows=(0.8, 0.1)))


def bent(rig, **fields):
    """The samples of fingers that bend in the air, and by how much the coupled joints are off their laws in each."""
    scenario = Scenario(object="box", rig=rig, rate=50, **fields)
    found = list(simulate(scenario, grasp=IN_THE_AIR))
    places = scene("box", rig=rig).joints
    off = []
    for sample in found:
        true = {name: sample.configuration[place] for name, place in places.items()}
        expected = rig.hand.completed({name: true[name] for name in rig.hand.needed})
        off.append([true[name] - expected[name] for name in rig.hand.couplings.laws])
    return found, np.array(off)


def test_coupled_joints_have_no_motor_and_follow_the_driven_ones(claw):
    built = scene("box", rig=claw)
    driven = {built.model.joint(built.model.actuator(k).trnid[0]).name for k in range(built.model.nu)}
    assert driven == set(claw.hand.needed) == set(built.hand.grasping)
    found, off = bent(claw, nuisances=Nuisances.none())
    np.testing.assert_allclose(off, 0, atol=2e-3)
    first, last = (sample.observation.joint_positions for sample in (found[0], found[-1]))
    assert set(first) == set(claw.hand.needed)
    assert all(last[name] - first[name] > 0.5 for name in KNUCKLES)


def test_each_is_off_its_law_by_a_constant_that_the_seed_draws(claw):
    exact = Nuisances.none()
    _, off = bent(claw, nuisances=replace(exact, coupled_joint=0.05), seed=3)
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), atol=2e-3)
    assert np.abs(off[0]).min() > 0.001
    assert np.abs(off[0]).max() < 0.2


def test_all_joints_are_measured_where_the_scenario_says_so(claw):
    nuisances = replace(Nuisances.none(), joint_noise=0.01)
    measured, _ = bent(claw, nuisances=nuisances, joints="all")
    driven, _ = bent(claw, nuisances=nuisances)
    for one, other in zip(measured, driven, strict=True):
        assert set(one.observation.joint_positions) == set(claw.hand.moving)
        assert other.observation.joint_positions.items() <= one.observation.joint_positions.items()
    with refused(InvalidInput, "joints"):
        Scenario(object="box", rig=claw, joints="some")


def test_there_is_no_room_where_the_open_hands_tips_are_in_the_table(claw):
    """Fingers that point down, beside the object: their ends are 11 cm from the palm's middle."""
    for height, fits in ((0.1, False), (0.2, True)):
        beside = se3.compose(np.eye(3), np.array([0.0, 0.3, height - 0.07]))
        down = replace(IN_THE_AIR, T_palm_middle=beside, R_world_palm=np.diag([1.0, -1, -1]))
        with nullcontext() if fits else pytest.raises(InvalidObject):
            World(Scenario(object="box", rig=claw), down)


def test_a_law_that_mujoco_cannot_have_is_refused_with_the_joint(tmp_path):
    rig = written(tmp_path, follows=(1.0, 0.0))
    robot = hs.Rig.from_file(rig)
    law = robot.hand.couplings.laws["one_middle"][1]
    robot.hand.couplings.laws["one_middle"] = "one_knuckle", law**5
    with refused(InvalidInput, "hand.file"):
        scene("box", rig=robot)


def errors(tracker, observation, truth):
    estimate = tracker.update(observation)
    return np.nan if estimate is None else np.linalg.norm((estimate.T_palm_object - truth)[:3, 3])


def medians(rig, grasp, seed):
    """The median error [m] of a track by the motors' positions alone, and of one by those of all joints: one world."""
    usual = Nuisances(
        joint_offset=rig.sigma_joint_offset, joint_noise=rig.sigma_joint, coupled_joint=rig.sigma_coupled
    )
    driven = Scenario(object="box", rig=rig, seed=seed, rate=25, motion="weigh", nuisances=usual)
    both = driven, replace(driven, joints="all")
    world = World(driven, grasp)
    trackers = [hs.Tracker(rig_of(each), model_of(each)) for each in both]
    found = []
    for pair in samples(driven, world, [Sensors(each, world) for each in both]):
        if pair[0].phase != "close":
            given = zip(trackers, pair, strict=True)
            found.append([errors(tracker, s.observation, s.T_palm_object) for tracker, s in given])
    assert not world.dropped()
    return np.nanmedian(found, axis=0)


@pytest.mark.slow
def test_a_recording_of_the_motors_is_tracked_as_well_as_one_of_all_joints(tmp_path, monkeypatch, capsys):
    file = data_file(INSPIRE)
    assert called(monkeypatch, tmp_path, "rig", "new", str(file), "-o", "new.rig.yaml") == 0
    simulated = ("simulate", "box", "--rig", "new.rig.yaml", "--motion", "grasp", "-o", "box.mcap")
    assert called(monkeypatch, tmp_path, *simulated) == 0
    rig = hs.Rig.from_file(tmp_path / "box.rig.yaml")
    with Recording(tmp_path / "box.mcap", rig) as recording:
        assert not recording.lacks()
        observation = next(iter(recording.observations()))
    assert set(observation.joint_positions) == set(rig.hand.completed(observation.joint_positions))
    capsys.readouterr()
    assert called(monkeypatch, tmp_path, "rig", "check", "box.rig.yaml", "box.mcap", columns=200) == 0
    assert "has everything" in capsys.readouterr().out
    rig = hs.Rig.from_file(tmp_path / "new.rig.yaml")
    grasp = read_grasp(tmp_path / "box.grasp.json", rig.hand.needed)
    driven, everything = np.sum([medians(rig, grasp, seed) for seed in range(3)], axis=0)
    assert driven < 1.2 * everything
    assert everything < 3 * 0.008
