"""A simulated hand that searches what stands on a table: its touches, what it finds, and what follows."""

import dataclasses
import json

import numpy as np
import pytest

import handsight as hs
from cli.commands import called
from handsight import se3
from handsight.errors import InvalidInput
from handsight.search import Sweep
from handsight.simulation import Nuisances, Scenario, model_of
from handsight.simulation.touch_search import TABLE_PROBES, start_search
from simulation.simulated import NONE
from testbed.refusals import refused


def towards(probe, aside=0.0):
    """A sweep of 0.2 m along y, so far beside the middle of the object that its middle is met, or not."""
    T, height = probe.T_world_object, probe.heights[0]
    return Sweep(T[:3, 3] * [1, 1, 0] + [aside, -0.15, height], np.array([0.0, 1.0, 0.0]), 0.25)


def test_a_contact_is_on_the_object_and_the_free_positions_are_outside():
    """Without nuisances: within the simulator's own softness, and the object hardly moves."""
    for name, seed in (("can", 0), ("box", 1)):
        scenario = Scenario(object=name, seed=seed, nuisances=NONE)
        model = model_of(scenario)
        probe, belief = start_search(scenario, model)
        assert belief.area.table.height == pytest.approx(0.0, abs=1e-3)
        before = probe.T_world_object
        assert (np.abs(se3.apply(before, model.vertices)[:, :2].mean(axis=0)) < 0.15).all()
        touch = probe.touch(towards(probe))
        T_object_world = se3.inverse(probe.T_world_object)
        (point,) = se3.apply(T_object_world, touch.contact_world.points_palm)
        felt = model.evaluate(point[None])
        assert abs(felt.distance[0]) < 5e-4
        normal = probe.T_world_object[:3, :3] @ felt.gradient[0]
        assert normal @ touch.contact_world.normals_palm[0] > np.cos(np.deg2rad(3))
        free = model.evaluate(se3.apply(T_object_world, touch.free_world)).distance
        assert free.min() > touch.radius - 1e-3
        assert np.linalg.norm(probe.T_world_object[:3, 3] - before[:3, 3]) < 2e-3
        passed = probe.touch(towards(probe, aside=0.09))
        assert passed.contact_world is None
        assert len(passed.free_world) > 40
        assert np.ptp(passed.free_world[:, 2]) < 1e-3


def test_the_tables_height_is_measured_without_contacts_at_its_edge(monkeypatch):
    scenario = Scenario(object="can", seed=1, nuisances=NONE)
    probe, _ = start_search(scenario, model_of(scenario))
    # Beside the table's edge the finger's side meets it, the tip being lower.
    T = probe.T_world_object
    at_edge = (T[:3, :3] @ [-0.083, 0.15, 0.0] + T[:3, 3])[:2]
    assert probe.measure_table(at_edge)[0] < -0.01
    monkeypatch.setattr("handsight.simulation.touch_search.TABLE_UNEVENNESS", 0.005)
    height, R_world_table = probe.measure_table([*TABLE_PROBES, at_edge, *TABLE_PROBES])
    assert height == pytest.approx(0.0, abs=1e-3)
    assert pytest.approx(np.eye(3), abs=5e-3) == R_world_table
    with refused(InvalidInput, "places"):
        probe.measure_table([3.0, 3.0])


def test_a_seed_says_where_the_object_is_and_what_is_felt_and_the_tables_tilt_is_measured():
    """Within half a degree, with all usual nuisances and the table 2.3° off; another size of one moves no object."""
    felt, placed = [], []
    for nuisances in (Nuisances(), Nuisances(), dataclasses.replace(Nuisances(), force_noise=0.02)):
        scenario = Scenario(object="can", seed=0, nuisances=nuisances)
        probe, belief = start_search(scenario, model_of(scenario))
        placed.append(probe.T_world_object)
        felt.append(probe.touch(towards(probe)).contact_world.points_palm)
        upright, measured = placed[0][:3, 2], belief.area.R_world_table[:, 2]
        assert upright[2] < np.cos(np.deg2rad(2))
        assert upright @ measured > np.cos(np.deg2rad(0.5))
    assert (placed[0] == placed[1]).all()
    assert (placed[0] == placed[2]).all()
    assert (felt[0] == felt[1]).all()


def test_an_object_larger_than_the_searched_area_is_rejected():
    scenario = Scenario(object="can")
    with refused(InvalidInput, "object"):
        start_search(scenario, hs.ObjectModel.box([0.4, 0.4, 0.1]))


BLIND = ("simulate", "can", "--blind", "--motion", "grasp", "-o", "can.mcap")


@pytest.mark.slow
def test_a_blind_recording_tells_its_touches_and_is_tracked_without_a_camera(tmp_path, monkeypatch, capsys):
    assert called(monkeypatch, tmp_path, *BLIND) == 0
    told = capsys.readouterr().err
    assert "touch 1: " in told
    assert "found by" in told
    assert called(monkeypatch, tmp_path, "track", "can.mcap", "--output-folder", "out") == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["poses"] > 150
    assert set(summary["seconds_in_state"]) <= {"search", "tracking", "uncertain"}
    assert summary["seconds_in_state"]["search"] > 10
    assert summary["errors_mm_deg"]["tracked"]["base_last"] < 5


def test_a_search_tells_what_is_open_where_its_touches_are_too_few(tmp_path, monkeypatch, capsys):
    assert called(monkeypatch, tmp_path, *BLIND, "--images") == 2
    assert "--images: expected none with --blind" in capsys.readouterr().err
    monkeypatch.setattr("handsight.simulation.touch_search.MAX_TOUCHES", 0)
    assert called(monkeypatch, tmp_path, *BLIND) == 1
    message = "the object was not found by 0 touches: "
    assert message in capsys.readouterr().err
