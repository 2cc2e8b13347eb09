"""Any hand of a rig grasps in simulation: its scene, its sensors, its grasps, and what is said where there is none."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import handsight as hs
from cli.commands import called
from handsight import se3
from handsight.errors import InvalidInput
from handsight.recording import Recording
from handsight.simulation import Nuisances, Scenario, find_grasp, rig_of, simulate
from handsight.simulation.grasp_fit import HandFit
from handsight.simulation.grasped_body import body_of
from handsight.simulation.scene import convex_hull, mujoco_module, scene
from handsight.simulation.world import World
from simulation.own_hands import ARM, FILES, real, written
from testbed.refusals import refused

NONE = Nuisances.none()


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def claw(tmp_path_factory):
    return hs.Rig.from_file(written(tmp_path_factory.mktemp("claw")))


@pytest.fixture(scope="module")
def grasp(claw, made_once):
    found = made_once("the claw's grasp of the box", lambda: find_grasp(Scenario(object="box", rig=claw)))
    assert found.succeeded
    return found.grasp


def pose(data, body):
    return se3.compose(data.body(body).xmat.reshape(3, 3), data.body(body).xpos)


def assert_tips_are_where_the_hand_has_them(rig, rng):
    built, mujoco = scene("box", rig=rig), mujoco_module()
    data = mujoco.MjData(built.model)
    joints = {name: rng.uniform(-0.5, 0.5) for name in rig.hand.joint_names}
    for name, place in built.joints.items():
        data.qpos[place] = joints[name]
    mujoco.mj_kinematics(built.model, data)
    T_palm_world = se3.inverse(pose(data, built.hand.palm))
    np.testing.assert_allclose(
        pose(data, built.hand.mount) @ built.hand.T_mount_palm, se3.inverse(T_palm_world), atol=1e-12
    )
    for finger, T_palm_frame in zip(rig.hand.tips, rig.hand.Ts_palm_tip(joints), strict=True):
        own = rig.fingers[finger]
        expected = T_palm_frame @ own.T_frame_surface @ own.tip.T_surface_sensor
        np.testing.assert_allclose(T_palm_world @ pose(data, f"{finger}_tip"), expected, atol=1e-9)
        geom = data.geom(f"{finger}_tip")
        center = se3.apply(T_palm_world, geom.xpos[None])[0]
        np.testing.assert_allclose(center, (T_palm_frame @ own.T_frame_surface)[:3, 3], atol=1e-9)


def test_the_scenes_tips_are_where_the_hands_file_and_rig_have_them(claw, rng):
    assert_tips_are_where_the_hand_has_them(claw, rng)


@pytest.mark.parametrize("name", FILES)
def test_a_real_hands_tips_are_where_its_file_and_rig_have_them(name, monkeypatch, rng):
    assert_tips_are_where_the_hand_has_them(real(name, monkeypatch), rng)


def test_an_arm_in_the_hands_file_is_left_out(tmp_path, rng):
    rig = hs.Rig.from_file(written(tmp_path, arm=ARM))
    assert "wrist" in rig.hand.joint_names
    assert set(scene("box", rig=rig).joints) == set(rig.hand.moving)
    assert_tips_are_where_the_hand_has_them(rig, rng)


def test_of_a_tip_on_a_link_without_shapes_the_link_that_carries_it_does_not_collide(tmp_path):
    rig = written(tmp_path)
    rig.write_text(rig.read_text().replace("frame: one_end", "frame: one_tip"))
    urdf = tmp_path / "claw.urdf"
    fixed = '<joint name="glue" type="fixed"><parent link="one_end"/><child link="one_tip"/></joint>'
    urdf.write_text(urdf.read_text().replace("</robot>", f'<link name="one_tip"/>{fixed}</robot>'))
    model = scene("box", rig=hs.Rig.from_file(rig)).model
    colliding = {model.body(model.geom_bodyid[k]).name for k in np.flatnonzero(model.geom_contype & 1)}
    assert {"hand/one_low", "hand/two_low", "one_tip", "two_tip"} <= colliding
    assert colliding.isdisjoint({"hand/one_end", "hand/two_end"})


@pytest.mark.parametrize("reading", ["on_tip", "on_sensor"])
def test_an_untouched_tips_reading_is_its_bias_and_weight_by_the_rigs_own_calibration(
    reading, tmp_path, grasp
):
    rig = hs.Rig.from_file(written(tmp_path, reading=reading))
    sample = next(simulate(Scenario(object="box", rig=rig, nuisances=NONE), grasp=grasp))
    assert not sample.contacts_truth
    gravity_palm = sample.observation.T_world_palm[:3, :3].T @ rig.gravity
    for name, T in zip(rig.hand.tips, rig.hand.Ts_palm_tip(sample.observation.joint_positions), strict=True):
        finger = rig.fingers[name]
        R = (T @ finger.T_frame_surface @ finger.tip.T_surface_sensor)[:3, :3]
        raw = sample.observation.wrenches[name]
        force, torque = hs.contact.compensate(raw[:3], raw[3:], R.T @ gravity_palm, finger.calibration)
        assert np.linalg.norm(force) < 0.01
        assert np.linalg.norm(torque) < 2e-4


def test_contacts_sensed_from_the_rigs_wrenches_are_the_simulators(claw, grasp):
    scenario = Scenario(object="box", rig=claw, nuisances=NONE, rate=20)
    rig = rig_of(scenario)
    tracker = hs.Tracker(rig, hs.ObjectModel.box((0.06, 0.09, 0.14)))
    for sample in simulate(scenario, grasp=grasp):
        tracker.update(sample.observation)
    assert not sample.dropped
    touch = tracker.fingertips
    truth = sample.touches
    assert set(touch.fingers) == set(truth)
    for finger, point in zip(touch.fingers, touch.contacts.points_palm, strict=True):
        assert np.linalg.norm(point - truth[finger].point_palm) < 5e-4


def test_fitted_postures_press_tips_on_the_object_from_opposite_sides(claw):
    fit = HandFit(scene("box", rig=claw), body_of(convex_hull("box")[0]), 0)
    found = [(grasp, name) for (grasp, _, name), _ in zip(fit.grasps(), range(8), strict=False) if grasp]
    assert found
    for grasp, name in found:
        one, _, others = name.partition(" against ")
        assert one in claw.fingers
        assert set(others.split(", ")) <= set(claw.fingers) - {one}
        # Tips of the open hand are off the box.
        half = np.array([0.03, 0.045, 0.07])
        for T, finger in zip(claw.hand.Ts_palm_tip(grasp.opening), claw.hand.tips, strict=True):
            center = (T @ claw.fingers[finger].T_frame_surface)[:3, 3]
            box = se3.apply(se3.inverse(grasp.T_palm_middle), center[None])[0]
            outside = np.maximum(np.abs(box) - half, 0)
            assert np.linalg.norm(outside) > 0.01


@pytest.mark.slow
def test_a_gripper_whose_jaws_slide_grasps_too(tmp_path):
    rig = written(tmp_path)
    text = (
        (tmp_path / "claw.urdf")
        .read_text()
        .replace('_knuckle" type="revolute"', '_knuckle" type="prismatic"')
    )
    text = text.replace(
        '<axis xyz="0 1 0"/><limit lower="-0.9" upper="0.9"',
        '<axis xyz="1 0 0"/><limit lower="-0.03" upper="0.03"',
    )
    (tmp_path / "claw.urdf").write_text(text)
    # The box, for two seeds of four; a can slides away on the table between jaws, for two seeds of three.
    found = find_grasp(Scenario(object="box", rig=hs.Rig.from_file(rig)))
    assert found.succeeded
    # Jaws aim beyond where they touch, by millimetres: a slide is as stiff as a hinge on an arm of 5 cm.
    assert max(abs(aim) for joint, aim in found.grasp.closed.items() if "knuckle" in joint) < 0.05


def test_a_rig_without_wrenches_is_refused_with_the_finger_that_has_none(claw):
    rig = replace(claw, topics=replace(claw.topics, wrenches={"one": "/claw/one"}))
    with refused(InvalidInput, "topics.wrenches"):
        find_grasp(Scenario(object="box", rig=rig))
    with refused(InvalidInput, "sensors"):
        Scenario(object="box", rig=claw, sensors="xela")


def test_the_command_records_the_hand_of_a_rig_and_track_runs_on_it(tmp_path, monkeypatch, capsys):
    rig = written(tmp_path)
    arguments = ("simulate", "box", "--rig", rig.name, "--motion", "weigh", "--output", "b.mcap")
    assert called(monkeypatch, tmp_path, *arguments, columns=200) == 0
    assert "the last one holds" in capsys.readouterr().err
    again = hs.Rig.from_file(tmp_path / "b.rig.yaml")
    assert again.topics.wrenches["two"] == "/claw/two"
    assert again.topics.truth
    with Recording(tmp_path / "b.mcap", again) as recording:
        assert set(next(iter(recording.observations())).wrenches) == {"one", "two", "three"}
    kept = json.loads((tmp_path / "b.grasp.json").read_text(encoding="utf-8"))
    assert set(kept["closed"]) == set(again.hand.moving)
    short = ("--motion", "grasp", "--grasp", "b.grasp.json", "--output", "c.mcap")
    assert called(monkeypatch, tmp_path, *arguments[:4], *short) == 0
    assert called(monkeypatch, tmp_path, "track", "b.mcap") == 0
    summary = json.loads((tmp_path / "b-track" / "summary.json").read_text(encoding="utf-8"))
    assert summary["corrections"] > 100
    assert called(monkeypatch, tmp_path, *arguments[:4], "--blind") == 2


def test_of_an_object_too_wide_for_the_hand_the_command_ends_with_1_and_both_sizes(
    tmp_path, monkeypatch, capsys
):
    rig = written(tmp_path)
    trimesh.creation.box((0.4, 0.4, 0.4)).export(tmp_path / "crate.stl")
    assert called(monkeypatch, tmp_path, "simulate", "crate.stl", "--rig", rig.name, columns=200) == 1
    said = capsys.readouterr().err
    assert re.search(r"got 400 x 400 x 400 mm \(fingertips open to \d+ mm; .*: \d+", said)
    assert not list(tmp_path.glob("*.mcap"))


def test_an_object_of_the_library_is_simulated_by_its_name(tmp_path, monkeypatch):
    trimesh.creation.cylinder(0.03, 0.13, sections=24).export(tmp_path / "bottle.stl")
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    added = ("objects", "add", "bottle.stl", "--name", "flask")
    assert called(monkeypatch, tmp_path, *added) == 0
    command = ("simulate", "flask", "--motion", "grasp", "--seed", "2")
    assert called(monkeypatch, tmp_path, *command) == 0
    rig = hs.Rig.from_file(tmp_path / "flask-2.rig.yaml")
    assert rig.objects["flask"].name == "flask"
    again = ("--grasp", "flask-2.grasp.json", "--nuisance", "object_scale=1.1")
    assert called(monkeypatch, tmp_path, *command, *again) == 0
    wider = hs.Rig.from_file(tmp_path / "flask-2.rig.yaml").objects["flask"].model()
    np.testing.assert_allclose(wider.diameter, 1.1 * rig.objects["flask"].model().diameter, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "thing"), [("allegro", "can"), ("leap_xela", "box"), ("dg5f", "can"), ("allegro", "box")]
)
def test_a_real_hand_grasps_lifts_and_tilts_can_and_box(name, thing, monkeypatch):
    rig = real(name, monkeypatch)
    scenario = Scenario(object=thing, rig=rig, motion="weigh", rate=20)
    found = find_grasp(scenario)
    assert found.succeeded
    world = World(scenario, found.grasp)
    while world.time < world.duration:
        world.step()
    assert not world.dropped()
    assert {contact.other for contact in world.tip_contacts()} >= {"object"}
