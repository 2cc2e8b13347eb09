"""Commands for robots, as a user runs them: simulate, rig check, track."""

import dataclasses
import json
import os
import pty
import re
import signal
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cli.commands import INTERRUPTIBLE, called, read_some, run
from cli.tracks import assert_results_agree, observations, recorded
from handsight.cli.simulate import believed_object, nuisances
from handsight.cli.track import TrackResult
from handsight.errors import InvalidInput
from handsight.rig import Rig
from handsight.rig.save import write as write_rig
from handsight.simulation import Nuisances, Scenario, rig_of
from handsight.tracking import Tally
from testbed.refusals import refused


@pytest.fixture(scope="session")
def by_command(tmp_path_factory):
    """A folder in which `handsight simulate` was run."""
    folder = tmp_path_factory.mktemp("simulated")
    out = run(
        "simulate", "can", "--motion", "grasp", "--seed", "1", "--output", "can.mcap", cwd=folder, columns=80
    )
    return folder, out


def test_simulate_writes_a_recording_and_the_rig_that_reads_it(by_command):
    folder, (_, said) = by_command
    assert re.search(r"wrote can\.mcap: \d+ observations, [\d.]+ MB \(synthetic\), and can\.rig\.yaml", said)
    assert sorted(path.name for path in folder.iterdir() if path.is_file()) == ["can.mcap", "can.rig.yaml"]
    assert list(Rig.from_file(folder / "can.rig.yaml").objects) == ["can"]


def test_rig_check_prints_the_rig_and_what_the_recording_lacks(by_command, asked):
    folder, _ = by_command
    out, _ = asked("rig", "check", "can.rig.yaml", "can.mcap", cwd=folder, columns=80)
    assert out.startswith("can.rig.yaml: 5 fingers on robot0:palm, 24 joints\n")
    assert max(map(len, out.splitlines())) <= 80
    assert "th         robot0:thdistal" in out
    assert "640 x 480 pixels; depth by structured light" in out
    assert "can.mcap has everything that this rig listens to." in out


def test_what_a_recording_lacks_for_a_rig_is_listed(by_command, monkeypatch, capsys):
    folder, _ = by_command
    text = (folder / "can.rig.yaml").read_text()
    (folder / "six.yaml").write_text(text.replace('"th": "/th/wrench"', '"th": "/[mm]/wrench"'))
    assert called(monkeypatch, folder, "rig", "check", "six.yaml", "can.mcap") == 1
    out = capsys.readouterr().out
    # Names are no markup.
    assert "- finger th: no wrench on /[mm]/wrench; the nearest is '/th/wrench'" in out.splitlines()


def test_track_writes_results_that_agree_and_are_far_better_than_vision(by_command, asked):
    folder, _ = by_command
    _, said = asked("track", "can.mcap", cwd=folder, columns=80)
    summary = assert_results_agree(folder / "can-track")
    assert (folder / "can-track" / "track.png").read_bytes().startswith(b"\x89PNG")
    errors = summary["errors_mm_deg"]
    assert errors["vision"]["base_mean"] > 20
    assert errors["tracked"]["base_last"] < 0.2 * errors["vision"]["base_last"]
    assert errors["tracked"]["count"] == summary["observations"] == summary["poses"]
    assert summary["refused"] == {}
    assert "wrote can-track: track.mcap, track.tum, track.csv, summary.json" in said
    assert f"{summary['poses']} poses of {summary['observations']} observations" in said


def test_track_ends_with_what_it_estimated_beside_what_is_declared(by_command, asked):
    folder, _ = by_command
    out, _ = asked("track", "can.mcap", "--output-folder", "estimated", cwd=folder)
    rows = json.loads((folder / "estimated" / "summary.json").read_text())["estimates"]
    by_name = {row["name"]: row for row in rows}
    shift = by_name["camera shift y"]
    assert shift["declared"] == 0.0
    assert shift["sigma_estimated"] < 0.2 * shift["sigma_declared"]
    assert re.search(r"^camera shift y +mm +0 ± 64 ", out, re.MULTILINE)
    assert len(out.strip().splitlines()) == 1 + len(rows)


def test_track_says_that_one_grasp_does_not_confirm_the_size_of_the_object(by_command, asked):
    folder, _ = by_command
    _, said = asked("track", "can.mcap", "--output-folder", "size", cwd=folder)
    assert "object size: not confirmed: one grasp, and no depth image was fitted" in said
    assert json.loads((folder / "size" / "summary.json").read_text())["size_doubt"]


@pytest.mark.parametrize(
    ("grasps", "seen", "sigma", "said"),
    [(0, 0, None, "no grasp"), (1, 0, 0.03, "3 %"), (2, 0, None, ""), (1, 5, None, "")],
)
def test_depth_images_or_another_grasp_may_confirm_the_size(grasps, seen, sigma, said):
    tracker = SimpleNamespace(images={"object_seen": seen}, model=SimpleNamespace(sigma_scale=sigma))
    doubt = TrackResult("held", Tally(grasps=grasps), None, tracker).size_doubt
    assert said in doubt
    assert bool(doubt) == bool(said)


@pytest.mark.filterwarnings("ignore:big.stl")  # which says the same of the unit
@pytest.mark.parametrize("command", [("track",), ("calibrate", "camera"), ("rig", "check", "big.yaml")])
def test_an_object_that_no_hand_holds_is_refused(by_command, monkeypatch, capsys, command):
    """A mesh in millimetres, as if they were metres."""
    folder, _ = by_command
    text = (folder / "can.rig.yaml").read_text()
    trimesh.creation.box((60, 90, 140)).export(folder / "big.stl")
    known = text[: text.index("\nobjects:")]
    (folder / "big.yaml").write_text(f'{known}\nobjects: {{"big": {{mesh: big.stl}}}}\n')
    options = () if command[0] == "rig" else ("--rig", "big.yaml")
    code = called(monkeypatch, folder, *command, "can.mcap", *options, columns=200)
    assert code == (1 if command[0] == "rig" else 2)
    said = "".join(capsys.readouterr())
    assert "object 'big': expected an object of at most " in said
    assert "poses of" not in said


def test_track_takes_the_rig_and_the_object_of_its_options(by_command, asked):
    folder, _ = by_command
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere" / "r.yaml").write_text((folder / "can.rig.yaml").read_text())
    arguments = ("--rig", "r.yaml", "--object", "can", "--output-folder", "out", "--no-images")
    asked("track", folder / "can.mcap", *arguments, cwd=folder / "elsewhere")
    assert_results_agree(folder / "elsewhere" / "out")


def test_ctrl_c_ends_tracking_early_and_what_was_tracked_is_written(grasp, tmp_path):
    rig, _ = grasp
    seen, many = observations(grasp), 3000
    # Long enough to be interrupted: held for minutes.
    held = [
        dataclasses.replace(seen[-1], stamp=seen[-1].stamp + (k + 1) / 20, vision=None) for k in range(many)
    ]
    recorded(tmp_path / "can.mcap", [*seen, *held], rig)
    write_rig(rig, tmp_path / "can.rig.yaml")
    terminal, its_end = pty.openpty()
    process = subprocess.Popen(
        [*INTERRUPTIBLE, "track", "can.mcap", "--object", "can", "--output-folder", "out"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=its_end,
        env={**os.environ, "COLUMNS": "80", "TERM": "xterm"},
    )
    os.close(its_end)
    said, interrupted = "", False
    while part := read_some(terminal):
        said += part
        if "corrections" in said and not interrupted:  # the progress bar is there
            process.send_signal(signal.SIGINT)
            interrupted = True
    os.close(terminal)
    assert process.wait(timeout=60) == 130, said
    assert "Traceback" not in said
    assert "wrote out: track.mcap" in said
    summary = assert_results_agree(tmp_path / "out")
    assert 0 < summary["poses"] < many


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("track", "can.mcap", "--object", "cna"), "--object: expected a name of can.rig.yaml or a mesh file, got 'cna'; the nearest valid one is 'can'"),
        (("track", "away.mcap"), "--rig: expected a rig file, got nothing, and there is neither away.rig.yaml nor rig.yaml beside away.mcap"),
        (("simulate", "can", "--nuisance", "joint_ofset=1"), "--nuisance: expected none or NAME=VALUE, got 'joint_ofset=1'"),
        (("simulate", "can", "--output", "can.bag"), "can.bag: expected a name that ends in .mcap"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_command_is_one_sentence(by_command, monkeypatch, capsys, arguments, said):
    assert called(monkeypatch, by_command[0], *arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"handsight: {said}")


def test_nuisances_are_set_by_name():
    assert nuisances([]) == Nuisances()
    assert nuisances(["none", "joint_offset=0.01"]) == dataclasses.replace(
        Nuisances.none(), joint_offset=0.01
    )
    for setting, said in (
        ("joint_ofset=1", "--nuisance: expected none or NAME=VALUE, got 'joint_ofset=1'; the nearest valid one is 'joint_offset'"),
        ("joint_offset", "--nuisance: expected none or NAME=VALUE, got 'joint_offset'"),
        ("joint_offset=a", "--nuisance joint_offset: expected a number, got 'a'"),
        ("joint_offset=-1", "--nuisance joint_offset: expected a number of at least 0, got -1"),
    ):  # fmt: skip
        with refused(InvalidInput, said.partition(":")[0]):
            nuisances([setting])


def test_a_wrong_size_of_the_object_is_in_the_rig_beside_the_recording():
    for name, size in (("can", "cylinder"), ("box", "box")):
        scenario = Scenario(object=name, nuisances=nuisances(["object_scale=1.03"]))
        rig = rig_of(scenario)
        expected = 1.03 * np.array(getattr(rig.objects[name], size))
        np.testing.assert_allclose(getattr(believed_object(scenario, rig), size), expected)
