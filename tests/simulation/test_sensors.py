"""Taxels of the simulated hand: their forces are the contacts', their errors those that the nuisances name."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.commands import called
from handsight import se3
from handsight.errors import InvalidInput
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.simulation import Scenario, rig_of, simulate
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.scene import PALM, tip_shape
from handsight.simulation.tables import tables
from handsight.simulation.taxels import ElasticSkin, Solid, TaxelSensors, surfaces
from handsight.simulation.world import World
from simulation.simulated import only
from testbed.refusals import refused

KINDS = ("xela", "paxini", "inspire")
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def grasped():
    """A world in which the box is held by three fingertips."""
    world = World(Scenario(object="box", nuisances=only()), grasp_for("box", 0))
    while world.time < 1.5:
        world.step()
    world.refresh()
    return world


def sensors(kind, seed=0, **nuisances):
    return TaxelSensors(Scenario(object="box", seed=seed, sensors=kind, nuisances=only(**nuisances)))


@pytest.mark.parametrize("kind", KINDS)
def test_places_are_on_the_tip_a_pitch_from_each_other(kind):
    for name, surface in surfaces(kind, False).items():
        finger, pads = name[:2], tables()["taxels"][kind]["pads"]
        semi_axes, center_z = tip_shape(finger)
        pad = pads[name[2:]]
        local = surface.points - [0, 0, 0.002 + center_z]
        np.testing.assert_allclose(((local / semi_axes) ** 2).sum(axis=1), 1, atol=1e-9)
        distance = np.linalg.norm(local[:, None] - local, axis=2) + np.diag(np.full(len(local), np.inf))
        assert len(local) == pad["number"]
        assert distance.min() >= 0.97 * pad["pitch"]
        assert np.median(distance.min(axis=1)) < 1.1 * pad["pitch"]
        outward = local / semi_axes**2
        assert ((outward * surface.normals).sum(axis=1) > 0.99 * np.linalg.norm(outward, axis=1)).all()


@settings(max_examples=30)
@given(seeds)
def test_the_forces_of_a_skin_are_the_force_on_it(seed):
    """Of any convex body, from any side, with any friction."""
    rng = np.random.default_rng(seed)
    surface = surfaces("paxini", False)["ff"]
    semi_axes, center_z = tip_shape("ff")
    T = se3.compose(np.eye(3), np.array([0, 0, 0.002 + center_z]))
    reach = np.full(len(surface.points), 0.85 * surface.pitch)
    skin = ElasticSkin.ellipsoid(semi_axes, T, surface.points, reach)
    i = rng.integers(len(surface.points))
    push = -surface.normals[i]
    solid = Solid.hull(0.03 * rng.normal(size=(30, 3)))
    R = se3.rotation_exp(rng.normal(size=3))
    # The body touches the tip at that taxel, with the point of it that is farthest that way.
    start = surface.points[i] - push * 0.5
    T_solid = se3.compose(R, start)
    gap = solid.distances((surface.points[i : i + 1] - start) @ R, -push @ R)
    assert np.isfinite(gap).all()
    T_solid[:3, 3] -= gap[0] * -push
    side = np.cross(push, rng.normal(size=3))
    force = rng.uniform(0.1, 5) * (push + rng.uniform(0, 0.5) * side / np.linalg.norm(side))
    found = skin.forces(solid, T_solid, force, push)
    np.testing.assert_allclose(found.sum(axis=0), force, atol=1e-9)
    # Its torque about the push is borne too, by forces that add up to none.
    springs = replace(skin, taxels=np.arange(len(skin.points)), places=skin.points)
    twisted, plain = (springs.forces(solid, T_solid, force, push, torque=each) for each in (0.01, 0.0))
    np.testing.assert_allclose((twisted - plain).sum(axis=0), 0, atol=1e-9)
    if (np.linalg.norm(plain[:-1], axis=1) > 1e-3).sum() > 2:  # one spring has no arm
        moment = np.cross(skin.points, (twisted - plain)[:-1]).sum(axis=0) @ push
        assert moment == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_each_tips_taxels_measure_the_simulators_contact(kind, grasped):
    """Force and centre of pressure, but for what skin without taxels bears; a tip that touches nothing reads nothing."""
    sensor = sensors(kind)
    forces = sensor.forces(grasped)
    contacts = [each for each in grasped.tip_contacts() if each.other == "object"]
    assert len(contacts) == 3
    touching = {each.finger for each in contacts}
    assert all(not forces[name].any() for name in forces if name[:2] not in touching)
    for contact in contacts:
        mine = [name for name in forces if name[:2] == contact.finger]
        T_palm_frame = se3.inverse(grasped.pose(PALM)) @ grasped.pose(sensor.surfaces[mine[0]].frame)
        total = T_palm_frame[:3, :3] @ sum(forces[name].sum(axis=0) for name in mine)
        size = np.linalg.norm(contact.force_palm)
        assert np.linalg.norm(total - contact.force_palm) < 0.03 * size
        points = np.concatenate([sensor.surfaces[name].points for name in mine])
        pressure = np.linalg.norm(np.concatenate([forces[name] for name in mine]), axis=1)
        middle = se3.apply(T_palm_frame, (pressure @ points / pressure.sum())[None])[0]
        arm = middle - contact.point_palm
        assert np.linalg.norm(arm - arm @ contact.normal_palm * contact.normal_palm) < 1e-3


def test_readings_are_those_of_the_seed():
    def readings(seed):
        scenario = Scenario(object="box", seed=seed, motion="grasp", rate=5.0, sensors="xela")
        return [sample.observation.skin for sample in simulate(scenario)]

    first, again, other = readings(3), readings(3), readings(4)
    for one, two in zip(first, again, strict=True):
        assert all((one[name] == two[name]).all() for name in one)
    assert any((one[name] != two[name]).any() for one, two in zip(first, other, strict=True) for name in one)


def test_a_hand_of_taxels_has_no_wrenches(simulated):
    samples = simulated(Scenario(object="box", motion="grasp", rate=100.0, sensors="inspire"))
    assert not any(sample.observation.wrenches for sample in samples)
    assert max(values.max() for values in samples[-1].observation.skin.values()) > 0.05


def test_sensors_of_no_maker_are_refused_with_the_makers():
    with refused(InvalidInput, "sensors"):
        Scenario(sensors="gel")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """`recorded(kind)`: the folder of a grasp with those sensors by the command, which is run once, and its samples."""
    done = {}

    def folder(kind):
        if kind not in done:
            place, samples = tmp_path_factory.mktemp(kind), []

            def kept(*given):
                for sample in simulate(*given):
                    samples.append(sample)
                    yield sample

            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("handsight.simulation.simulate", kept)
                grasp = ("simulate", "can", "--motion", "grasp", "--seed", "1", "--output", "can.mcap")
                assert called(patch, place, *grasp, "--skin", "--sensors", kind) == 0
            done[kind] = place, samples
        return done[kind]

    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_simulate_track_and_rig_check_of_each_maker_as_a_user_runs_them(kind, recorded, monkeypatch, capsys):
    """The base's centre within 5 mm at the end of the grasp, where vision's is off by more than 90."""
    folder, _ = recorded(kind)
    assert called(monkeypatch, folder, "rig", "check", "can.rig.yaml", "can.mcap", columns=100) == 0
    assert "can.mcap has everything that this rig listens to." in capsys.readouterr().out
    assert called(monkeypatch, folder, "track", "can.mcap", "--output-folder", "out") == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert not summary["refused"]
    assert summary["poses"] == summary["observations"] == 191
    errors = summary["errors_mm_deg"]
    assert errors["vision"]["base_last"] > 90
    assert errors["tracked"]["base_last"] < 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_recorded_taxels_are_read_as_they_were_measured(kind, recorded):
    folder, simulated = recorded(kind)
    scenario = Scenario(object="can", motion="grasp", seed=1, sensors=kind, skin=True)
    samples = {round(100 * sample.observation.stamp): sample.observation for sample in simulated}
    rig = Rig.from_file(folder / "can.rig.yaml")
    for name, surface in rig_of(scenario).skin.items():
        np.testing.assert_allclose(rig.skin[name].points, surface.points, atol=1e-9)
    with open_recording(folder / "can.mcap", rig) as recording:
        for k, observation in enumerate(recording.observations()):
            assert observation.skin.keys() == rig.skin.keys()
            for name, values in observation.skin.items():
                expected = samples[k].skin[name]
                np.testing.assert_allclose(values.reshape(expected.shape), expected, atol=1e-6)
    assert not recording.lacks()
