"""`handsight simulate MESH`: the grasp that was searched is said, kept and used again."""

import dataclasses
import json

import numpy as np
import trimesh

from cli.commands import called
from handsight.recording import Recording
from handsight.rig import Rig
from handsight.simulation import (
    GraspSearchResult,
    Nuisances,
    Scenario,
    constant_errors,
    grasp_search,
    read_grasp,
)
from handsight.simulation.motion import CAN


def bottle(folder):
    mesh = trimesh.creation.cylinder(radius=0.03, height=0.13, sections=24)
    mesh.export(folder / "bottle.stl")
    return "bottle.stl"


def test_a_grasp_is_searched_said_kept_and_used_again(tmp_path, monkeypatch, capsys):
    name = bottle(tmp_path)
    arguments = ("simulate", name, "--motion", "grasp", "--seed", "2")
    assert called(monkeypatch, tmp_path, *arguments, "-o", "one.mcap", columns=200) == 0
    said = capsys.readouterr().err
    assert "wrote one.grasp.json: th against ff, mf" in said
    assert "the last one holds" in said
    assert "slipped out" not in said
    assert {path.name for path in tmp_path.iterdir()} == {name, "one.mcap", "one.rig.yaml", "one.grasp.json"}
    searched = []
    monkeypatch.setattr("handsight.simulation.find_grasp", lambda *_: searched.append(1))
    again = ("--grasp", "one.grasp.json", "-o", "two.mcap")
    assert called(monkeypatch, tmp_path, *arguments, *again) == 0
    assert not searched
    assert abs((tmp_path / "two.mcap").stat().st_size / (tmp_path / "one.mcap").stat().st_size - 1) < 0.05
    assert called(monkeypatch, tmp_path, *arguments, "--grasp", name) == 2
    assert f"{name}: " in capsys.readouterr().err


def test_where_no_grasp_holds_what_was_tried_is_said(tmp_path, monkeypatch, capsys):
    name = bottle(tmp_path)
    found = GraspSearchResult(
        CAN, False, 24, "thumb against ff, mf", "slipped when lifted: 20, slipped when turned: 4"
    )
    monkeypatch.setattr("handsight.simulation.find_grasp", lambda *_: found)
    assert (
        called(monkeypatch, tmp_path, "simulate", name, "--motion", "grasp", "-o", "b.mcap", columns=200) == 0
    )
    said = capsys.readouterr().err
    assert (
        "wrote b.grasp.json: thumb against ff, mf; of 24 grasps tried none holds, this one did longest "
        "(slipped when lifted: 20, slipped when turned: 4)" in said
    )
    assert read_grasp(tmp_path / "b.grasp.json").height == CAN.height
    assert grasp_search.MAX_TRIALS == 24


def test_a_harsh_world_says_what_it_has_drawn_and_its_rig_does_not_know(tmp_path, monkeypatch, capsys):
    arguments = ("simulate", "box", "--motion", "grasp", "--seed", "5", "-o", "box.mcap", "--world")
    assert called(monkeypatch, tmp_path, *arguments, "hard") == 2
    assert capsys.readouterr().err == "handsight: --world: expected usual or harsh, got 'hard'\n"
    changed = ("--nuisance", "force_backlash=0.02", "--nuisance", "message_loss=0.3")
    assert called(monkeypatch, tmp_path, *arguments, "harsh", *changed, columns=200) == 0
    assert "wrote box.world.json: what is wrong in this world" in capsys.readouterr().err
    told = json.loads((tmp_path / "box.world.json").read_text(encoding="utf-8"))
    nuisances = dataclasses.replace(Nuisances.harsh(5), force_backlash=0.02, message_loss=0.3)
    assert told["nuisances"] == dataclasses.asdict(nuisances)
    drawn = constant_errors(Scenario(object="box", nuisances=nuisances, seed=5))
    for field in dataclasses.fields(drawn):
        np.testing.assert_allclose(told["drawn"][field.name], getattr(drawn, field.name))
    rig = Rig.from_file(tmp_path / "box.rig.yaml")
    np.testing.assert_allclose(rig.objects["box"].mass, nuisances.declared_mass * nuisances.object_mass)
    np.testing.assert_allclose(rig.objects["box"].box, nuisances.object_scale * np.array([0.06, 0.09, 0.14]))
    assert rig.sigma_joint_offset < nuisances.joint_offset
    with Recording(tmp_path / "box.mcap", rig) as recording:
        assert 100 < sum(1 for _ in recording.observations()) < 170  # of 191, three tenths are lost
