"""An object that is pulled slips, and how it does is known."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import shared
from handsight import se3
from handsight.cli.simulate import write_slips
from handsight.recording import RecordingWriter, open_recording
from handsight.simulation import Nuisances, Scenario, rig_of, simulate
from handsight.simulation.scenario import TORSION_ARM
from handsight.simulation.world import PULL_BEGIN, PULL_DURATION, Pull, pull_share
from simulation.simulated import only, sensed

FRICTION = 0.6
PULLED = only(friction=FRICTION, pull_force=8.0, pull_torque=0.03)
ACROSS = np.array([[0.0, 1, 0], [0, -1, 0], [0, -1, 0]])
"""Contact normals of a grip along y."""


def pull(motion="ramp", seed=0, **strength):
    return Pull(Scenario(motion=motion, seed=seed, nuisances=Nuisances(**strength)), ACROSS)


@pytest.mark.parametrize("motion", ["ramp", "steps", "sine"])
def test_a_pull_grows_to_its_greatest_force_and_is_zero_before_and_after(motion):
    times = np.arange(0, PULL_DURATION, 0.001)
    heights = np.array([pull_share(motion, t) for t in times])
    assert heights.min() >= 0
    assert 0.9 < heights.max() <= 1
    assert np.abs(np.diff(heights)).max() < 0.01
    run = pull(motion, pull_force=6.0, pull_torque=0.05)
    forces = np.array([run.wrench(PULL_BEGIN + t, 0.0, 0.0) for t in times])
    np.testing.assert_allclose(np.linalg.norm(forces[:, :3], axis=1), 6 * heights, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(forces[:, 3:], axis=1), 0.05 * heights, atol=1e-12)
    assert not run.wrench(PULL_BEGIN - 0.01, 0.0, 0.0).any()
    assert not run.wrench(PULL_BEGIN + PULL_DURATION + 0.01, 0.0, 0.0).any()


def test_a_pull_is_along_the_surfaces_that_the_tips_press_on():
    directions = np.array(
        [
            pull(seed=seed, pull_force=1.0).wrench(PULL_BEGIN + 0.999 * PULL_DURATION, 0, 0)[:3]
            for seed in range(200)
        ]
    )
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 0.999, atol=1e-9)
    across = np.abs(directions[:, 1])
    assert np.median(across) < 0.2
    assert np.abs(directions.mean(axis=0)).max() < 0.2


@functools.cache
def pulled():
    """A box that slips under a ramp, 250 samples a second."""
    return tuple(
        shared.simulated(Scenario(object="box", seed=4, motion="ramp", rate=250.0, nuisances=PULLED))
    )


@pytest.mark.slow
def test_a_pulled_object_slips_and_then_stays():
    run = pulled()
    assert {s.phase for s in run} == {"close", "hold", "move", "pull"}
    speeds = [min((c.speed for c in s.touches.values()), default=0.0) for s in run if s.phase == "pull"]
    assert 0.004 < np.sum(speeds) / 250.0 < 0.03
    assert max(c.speed for c in run[-1].touches.values()) < 0.003
    assert len(run[-1].touches) >= 2


@pytest.mark.slow
def test_slip_speeds_are_the_objects_speed_along_the_tips():
    """By the tips' and the object's places themselves: a contact's velocity joins two instants."""
    run = [s for s in pulled() if s.phase == "pull"]
    hand, moved, said = rig_of(Scenario()).hand, [], []
    tips = [hand.Ts_palm_tip(s.observation.joint_positions) for s in run]
    for k in range(1, len(run) - 1):
        T_object = run[k + 1].T_palm_object @ se3.inverse(run[k - 1].T_palm_object)
        for finger, contact in run[k].touches.items():
            i, p = list(hand.tips).index(finger), contact.point_palm[None]
            T_tip = tips[k + 1][i] @ se3.inverse(tips[k - 1][i])
            if contact.speed > 0.01:
                moved.append((se3.apply(T_object, p) - se3.apply(T_tip, p))[0] * 125.0)
                said.append(contact.velocity_palm[:3])
    off = np.linalg.norm(np.subtract(moved, said), axis=1) / np.linalg.norm(said, axis=1)
    assert len(off) > 50
    assert np.median(off) < 0.3  # within the eight milliseconds speeds go up and down


@pytest.mark.slow
def test_slipping_contacts_are_on_the_friction_cone_and_none_is_outside():
    ratios, sliding = [], []
    for sample in pulled()[400:]:
        for finger, contact in sample.touches.items():
            only_touch = sum(c.finger == finger for c in sample.contacts_truth) == 1
            normal = contact.force_palm @ contact.normal_palm
            if normal < 0.5 or not only_touch:
                continue
            along = np.linalg.norm(contact.force_palm - normal * contact.normal_palm)
            ratios.append(along / normal)
            turns = TORSION_ARM * abs(contact.velocity_palm[3:] @ contact.normal_palm)
            if contact.speed > 0.01 and turns < 0.1 * contact.speed:
                sliding.append(along / normal)
    assert max(ratios) < 1.02 * FRICTION
    assert len(sliding) > 20
    np.testing.assert_allclose(np.median(sliding), FRICTION, rtol=0.02)


@pytest.mark.slow
def test_the_pull_is_measured_by_the_fingertips():
    """The tips carry weight and pull together, as long as the object hardly moves."""
    totals = []
    for sample in pulled():
        if sample.phase == "pull":
            force = sum(force for _, force in sensed(sample.observation).values())
            totals.append(sample.observation.T_world_palm[:3, :3] @ force)
    totals = np.array(totals)
    np.testing.assert_allclose(totals[0], [0, 0, -0.15 * 9.81], atol=0.05)
    assert np.linalg.norm(totals - totals[0], axis=1).max() > 1.5


def test_the_velocities_are_on_topics_of_their_own(tmp_path):
    rig, path = rig_of(Scenario()), tmp_path / "slips.mcap"
    *_, run = simulate(Scenario(object="box", rate=2.0))
    with RecordingWriter(path, rig) as writer:
        writer.write(replace(run.observation, stamp=1000.0))
        writer.write_truth(1000.0, run.T_palm_object)
        write_slips(writer, 1000.0, run, rig)
    rosbags = pytest.importorskip("rosbags.highlevel")
    with rosbags.AnyReader([path]) as reader:
        there = {c.topic: c for c in reader.connections if "/slip/" in c.topic}
        assert set(there) == {f"/truth/object/slip/{finger}" for finger in run.touches}
        topic = there["/truth/object/slip/th"]
        ((_, stamp, data),) = reader.messages([topic])
        message = reader.deserialize(data, topic.msgtype)
    assert stamp == 1000 * 10**9
    assert message.header.frame_id == rig.frames["palm"]
    linear, angular = message.twist.linear, message.twist.angular
    said = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    np.testing.assert_allclose(said, run.touches["th"].velocity_palm)
    with open_recording(path, rig) as recording:
        assert len(list(recording.observations())) == len(recording.truth) == 1
