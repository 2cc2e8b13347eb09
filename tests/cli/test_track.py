"""Commands for robots: as a user runs them, and what they make of recordings that are bad."""

import csv
import dataclasses
import itertools
import json
import os
import pty
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from handsight import se3
from handsight.cli import main
from handsight.cli.simulate import nuisances
from handsight.cli.track import run, write
from handsight.errors import InvalidFile, InvalidInput
from handsight.rig import Rig
from handsight.rig.writing import write as write_rig
from handsight.tracking import TrackerSettings
from handsight.tracking.camera_calibration import calibrate_camera

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.recording import RecordingWriter, open_recording
from handsight.recording.writing import McapFile
from handsight.simulation import Nuisances, Scenario, rig_of, simulate
from handsight.simulation.camera import displacement

HANDSIGHT = [sys.executable, "-m", "handsight.cli"]
ENVIRONMENT = {**os.environ, "COLUMNS": "80"}


def command(*arguments, cwd, expect=0):
    """stdout and stderr of a command that ends as expected, and never with a traceback."""
    done = subprocess.run(
        [*HANDSIGHT, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=120,
        env=ENVIRONMENT,
    )
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == expect, done.stdout + done.stderr
    return done.stdout, done.stderr


def called(monkeypatch, folder, *arguments):
    """The exit code of a command that runs in this process."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "argv", ["handsight", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


def recorded(path, observations, rig, truths=()):
    with RecordingWriter(path, rig) as writer:
        for seen in observations:
            writer.write(seen)
        for stamp, T in truths:
            writer.write_truth(stamp, T)
    return path


@pytest.fixture(scope="session")
def grasp():
    """A short grasp of the can: its rig, and its samples."""
    scenario = Scenario(rate=20, motion="grasp")
    return rig_of(scenario), list(simulate(scenario))


@pytest.fixture(scope="session")
def simulated(tmp_path_factory):
    """A folder in which `handsight simulate` was run."""
    folder = tmp_path_factory.mktemp("simulated")
    out = command("simulate", "can", "--motion", "grasp", "--seed", "1", "--output", "can.mcap", cwd=folder)
    return folder, out


def track(path, rig, folder=None, **settings):
    """The run through a recording, and what is said of writing it."""
    model = rig.objects["can"].model()
    ended = run(path, rig, model, TrackerSettings(**settings), lambda *_: None)
    written = [] if folder is None else list(write(ended, rig, model, folder))
    return ended, written


def poses_of(folder):
    """Stamps and positions + quaternions in the three files of results."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    tum = np.loadtxt(folder / "track.tum", ndmin=2)
    with (folder / "track.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    table = np.array(
        [[float(row[k]) for k in ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")] for row in rows]
    )
    mcap = []
    with AnyReader([folder / "track.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        assert [c.topic for c in reader.connections] == ["/handsight/pose"]
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            p, q = message.pose.pose.position, message.pose.pose.orientation
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            mcap.append([stamp, p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    return tum, table, np.array(mcap), rows


def assert_results_agree(folder):
    tum, table, mcap, rows = poses_of(folder)
    summary = json.loads((folder / "summary.json").read_text())
    assert len(tum) == len(table) == len(mcap) == summary["poses"] > 0
    np.testing.assert_allclose(tum, table, atol=1e-9)
    np.testing.assert_allclose(mcap, table, atol=2e-9)
    assert {row["state"] for row in rows} <= {"tracking", "uncertain", "lost"}
    return summary


def test_simulate_writes_a_recording_and_the_rig_that_reads_it(simulated):
    folder, (_, said) = simulated
    assert re.search(r"wrote can\.mcap: \d+ observations, [\d.]+ MB \(synthetic\), and can\.rig\.yaml", said)
    assert sorted(path.name for path in folder.iterdir() if path.is_file()) == ["can.mcap", "can.rig.yaml"]
    assert list(Rig.from_file(folder / "can.rig.yaml").objects) == ["can"]


def test_rig_check_prints_the_rig_and_what_the_recording_lacks(simulated):
    folder, _ = simulated
    out, _ = command("rig", "check", "can.rig.yaml", "can.mcap", cwd=folder)
    assert out.startswith("can.rig.yaml: 5 fingers on robot0:palm, 24 joints\n")
    assert max(map(len, out.splitlines())) <= 80
    assert "th         robot0:thdistal  10.5 x 10.5 x 16" in out
    assert out.endswith("can.mcap has everything that this rig listens to.\n")


def test_what_a_recording_lacks_for_a_rig_is_listed(simulated, monkeypatch, capsys):
    folder, _ = simulated
    text = (folder / "can.rig.yaml").read_text()
    (folder / "six.yaml").write_text(text.replace('"th": "/th/wrench"', '"th": "/[mm]/wrench"'))
    assert called(monkeypatch, folder, "rig", "check", "six.yaml", "can.mcap") == 1
    out = capsys.readouterr().out
    assert "th      /[mm]/wrench" in out  # names are no markup
    assert "- finger th: no wrench on /[mm]/wrench; the nearest is '/th/wrench'" in out.splitlines()


def test_track_writes_results_that_agree_and_are_far_better_than_vision(simulated):
    folder, _ = simulated
    _, said = command("track", "can.mcap", cwd=folder)
    summary = assert_results_agree(folder / "can-track")
    assert (folder / "can-track" / "track.png").read_bytes().startswith(b"\x89PNG")
    errors = summary["errors_mm_deg"]
    assert errors["vision"]["base_mean"] > 20
    assert errors["tracked"]["base_last"] < 0.2 * errors["vision"]["base_last"]
    assert errors["tracked"]["count"] == summary["observations"] == summary["poses"]
    assert summary["refused"] == {}
    assert "wrote can-track: track.mcap, track.tum, track.csv, summary.json" in said
    assert f"{summary['poses']} poses of {summary['observations']} observations" in said


def test_track_takes_the_rig_and_the_object_it_is_told(simulated):
    folder, _ = simulated
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere" / "r.yaml").write_text((folder / "can.rig.yaml").read_text())
    arguments = ("--rig", "r.yaml", "--object", "can", "--output", "out", "--rate", "20")
    command("track", folder / "can.mcap", *arguments, cwd=folder / "elsewhere")
    assert_results_agree(folder / "elsewhere" / "out")


def test_ctrl_c_ends_tracking_early_and_what_was_tracked_is_written(grasp, tmp_path):
    rig, _ = grasp
    seen, many = observations(grasp), 3000
    # Long enough to be interrupted: held for minutes.
    held = [
        dataclasses.replace(seen[-1], stamp=seen[-1].stamp + (k + 1) / 20, seen=None) for k in range(many)
    ]
    recorded(tmp_path / "can.mcap", [*seen, *held], rig)
    write_rig(rig, tmp_path / "can.rig.yaml")
    terminal, its_end = pty.openpty()
    process = subprocess.Popen(
        [*HANDSIGHT, "track", "can.mcap", "--object", "can", "--rate", "20", "-o", "out"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=its_end,
        env=ENVIRONMENT,
    )
    os.close(its_end)
    said, interrupted = "", False
    while part := read_some(terminal):
        said += part
        if "corrections" in said and not interrupted:  # the live table is there
            process.send_signal(signal.SIGINT)
            interrupted = True
    os.close(terminal)
    assert process.wait(timeout=60) == 130, said
    assert "Traceback" not in said
    assert "wrote out: track.mcap" in said
    summary = assert_results_agree(tmp_path / "out")
    assert 0 < summary["poses"] < many


def read_some(terminal):
    """What comes next from a terminal; empty at its end."""
    try:
        return os.read(terminal, 4096).decode(errors="replace")
    except OSError:  # how Linux ends a terminal
        return ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("track", "can.mcap", "--object", "cna"), "--object: expected a name of can.rig.yaml or a mesh file, got 'cna'; the nearest valid one is 'can'"),
        (("track", "away.mcap"), "--rig: expected, got nothing, and there is neither away.rig.yaml nor rig.yaml beside away.mcap"),
        (("simulate", "can", "--nuisance", "joint_ofset=1"), "--nuisance: expected none or NAME=VALUE, got 'joint_ofset=1'"),
        (("simulate", "can", "--output", "can.bag"), "can.bag: expected a name that ends in .mcap"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_command_is_one_sentence(simulated, monkeypatch, capsys, arguments, said):
    assert called(monkeypatch, simulated[0], *arguments) == 2
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
        with pytest.raises(InvalidInput, match=re.escape(said)):
            nuisances([setting])


# Calibration


@pytest.fixture(scope="session")
def moved(tmp_path_factory):
    """A scenario in which the palm turns with the box, recorded, and its rig."""
    scenario = Scenario(object="box", rate=20, motion="manipulate")
    rig, folder = rig_of(scenario), tmp_path_factory.mktemp("moved")
    return scenario, rig, recorded(folder / "box.mcap", (s.observation for s in simulate(scenario)), rig)


def test_the_cameras_displacement_is_found_where_the_palm_turned(moved):
    scenario, rig, path = moved
    found = calibrate_camera(path, rig, rig.objects["box"].model())
    assert np.rad2deg(found.turned) > 60
    # What the camera sees is displaced, so the camera is where that takes it back from.
    back = se3.inverse(displacement(scenario.nuisances, scenario.seed))
    true = np.r_[se3.apply(back, found.pivot[None])[0] - found.pivot, se3.rotation_log(back[:3, :3])]
    sigma = np.sqrt(found.covariance.diagonal())
    assert np.linalg.norm(true[:3]) > 0.05
    assert np.abs((found.correction - true) / sigma).max() < 3
    assert np.linalg.norm(found.correction[:3] - true[:3]) < 0.15 * np.linalg.norm(true[:3])
    T = np.eye(4)
    T[:3, :3] = se3.rotation_exp(found.correction[3:])
    T[:3, 3] = found.pivot + found.correction[:3] - T[:3, :3] @ found.pivot
    np.testing.assert_allclose(T @ rig.camera.T_mount_camera, found.T_mount_camera, atol=1e-9)


def test_calibrate_camera_prints_what_the_rig_file_takes(moved, tmp_path):
    _, rig, path = moved
    write_rig(rig, tmp_path / "rig.yaml")
    out, err = command("calibrate", "camera", path, "--rig", "rig.yaml", "--object", "box", cwd=tmp_path)
    assert re.search(r"# known to ± \[[\d., ]+\] mm, \[[\d., ]+\]° \(one standard deviation\)", out)
    assert err == ""
    text = (tmp_path / "rig.yaml").read_text()
    pose = next(line for line in out.splitlines() if line.startswith("  pose: "))
    (tmp_path / "new.yaml").write_text(
        re.sub(r"(?m)(?<=fixed_to: world   # world or palm\n)  pose: .*$", pose, text)
    )
    expected = calibrate_camera(path, rig, rig.objects["box"].model()).T_mount_camera
    np.testing.assert_allclose(
        Rig.from_file(tmp_path / "new.yaml").camera.T_mount_camera, expected, atol=1e-3
    )


def test_a_camera_that_is_not_there_cannot_be_calibrated(moved, tmp_path):
    _, rig, path = moved
    model = rig.objects["box"].model()
    with pytest.raises(InvalidInput, match="^camera: expected one in the rig, got none"):
        calibrate_camera(path, dataclasses.replace(rig, camera=None), model)
    blind = recorded(
        tmp_path / "blind.mcap", (dataclasses.replace(s, seen=None) for s in seen_by(path, rig)[:40]), rig
    )
    with pytest.raises(InvalidInput, match="expected an object that is held and seen, got none"):
        calibrate_camera(blind, rig, model)


def seen_by(path, rig):
    with open_recording(path, rig) as recording:
        return list(recording.observations())


# Bad recordings: each gives a sentence, and what could be tracked is written.


def observations(grasp):
    return [sample.observation for sample in grasp[1]]


def assert_tracked(path, rig, folder, said, *, least=10):
    """The results were written, some pose was found, and one of the sentences is what is expected."""
    ended, written = track(path, rig, folder)
    assert any(re.search(said, sentence) for sentence in ended.said), ended.said
    assert written[0].startswith(f"wrote {folder}: track.mcap")
    assert assert_results_agree(folder)["poses"] >= least
    return ended


def test_a_good_recording_has_nothing_to_say(grasp, tmp_path):
    rig, samples = grasp
    path = recorded(
        tmp_path / "a.mcap",
        observations(grasp),
        rig,
        [(s.observation.stamp, s.T_palm_object) for s in samples],
    )
    ended, _ = track(path, rig, tmp_path / "out")
    assert ended.said == []
    assert ended.tracked.base[-1] < 0.004 < 0.03 < ended.vision.base[-1]
    assert len(ended.steps) == len(samples)


def test_without_joint_states_nothing_can_be_tracked_and_that_is_said(grasp, tmp_path):
    rig, _ = grasp
    path = recorded(
        tmp_path / "a.mcap", (dataclasses.replace(s, joint_positions=None) for s in observations(grasp)), rig
    )
    with pytest.raises(
        InvalidFile,
        match=r"a\.mcap: expected joint states on /joint_states, got none; topics there: /ff/wrench, ",
    ):
        track(path, rig)


def test_an_unknown_finger_is_named(grasp, tmp_path):
    rig, _ = grasp
    names = {**rig.topics.wrenches, "th": "/thumb/wrench"}
    strange = dataclasses.replace(rig, topics=dataclasses.replace(rig.topics, wrenches=names))
    path = recorded(tmp_path / "a.mcap", observations(grasp), strange)
    ended = assert_tracked(
        path, rig, tmp_path / "out", r"^finger th: no wrench on /th/wrench; the nearest is '/thumb/wrench'$"
    )
    assert "/thumb/wrench: wrenches of no finger of the rig; not used" in ended.said
    assert {finger for step in ended.steps for finger in step.fingers} == {"ff", "mf", "rf", "lf"}


def test_depth_in_the_wrong_unit_is_told(grasp, tmp_path, monkeypatch):
    rig, _ = grasp
    topics = dataclasses.replace(rig.topics, depth="/camera/depth")
    rig = dataclasses.replace(rig, topics=topics)
    depth = np.full((6, 8), 9.0, dtype=np.float32)  # is written as 9 000 mm
    with monkeypatch.context() as patch:
        patch.setattr("handsight.recording.writing._millimetres", lambda metres: metres.astype("<u2"))
        path = recorded(
            tmp_path / "a.mcap", (dataclasses.replace(s, depth=depth) for s in observations(grasp)), rig
        )
    said = r"^/camera/depth: 39 of 39 messages left out: expected depth in millimetres \(16UC1\), got a median of 9 \(another unit\?\)$"
    ended = assert_tracked(path, rig, tmp_path / "out", said)
    assert ended.tally.answered == 39


def test_a_file_that_is_cut_in_a_chunk_is_tracked_as_far_as_it_goes(grasp, tmp_path):
    rig, _ = grasp
    seen = observations(grasp)
    more = [dataclasses.replace(seen[-1], stamp=seen[-1].stamp + (k + 1) / 20) for k in range(800)]
    path = recorded(tmp_path / "a.mcap", [*seen, *more], rig)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    ended = assert_tracked(
        path, rig, tmp_path / "out", rf"a\.mcap: cut: the file ends at byte {len(data) // 2}"
    )
    assert len(ended.steps) < 839


def test_a_file_of_zero_length_is_told(grasp, tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(InvalidFile, match=r"a\.mcap: expected a recording .*, got an empty file"):
        track(tmp_path / "a.mcap", grasp[0])


def test_stamps_that_go_back_are_told_and_what_came_before_is_tracked(grasp, tmp_path, monkeypatch):
    rig, _ = grasp
    seen = observations(grasp)
    shift = 10 - seen[0].stamp
    looped = [dataclasses.replace(s, stamp=s.stamp + shift) for s in seen]
    logged, original = itertools.count(1), McapFile.write

    def write_in_turn(self, topic, kind, stamp, fields):
        original(self, topic, kind, next(logged) / 200, fields)

    with monkeypatch.context() as patch:  # when it was recorded goes on
        patch.setattr(McapFile, "write", write_in_turn)
        again = [dataclasses.replace(s, stamp=s.stamp - 5) for s in looped]
        path = recorded(tmp_path / "a.mcap", [*looped, *again], rig)
    ended = assert_tracked(
        path,
        rig,
        tmp_path / "out",
        r"^/joint_states: stamps go back by up to [\d.]+ s from [\d.]+ s on \(\d+ messages",
    )
    stamps = [step.stamp for step in ended.steps]
    assert stamps == sorted(stamps)


def test_a_wrench_that_is_stuck_at_full_scale_is_a_dead_sensor(grasp, tmp_path):
    rig, _ = grasp
    dead = np.array([0, 0, -50.0, 0, 0, 0])
    path = recorded(
        tmp_path / "a.mcap",
        (dataclasses.replace(s, wrenches={**s.wrenches, "th": dead}) for s in observations(grasp)),
        rig,
    )
    ended = assert_tracked(
        path,
        rig,
        tmp_path / "out",
        r"^finger th: reads full scale \(50 N, 0\.5 N m\) in 39 messages: a dead sensor\? left out$",
    )
    assert "th" not in {finger for step in ended.steps for finger in step.fingers}


def test_a_joint_that_is_not_a_number_is_named(grasp, tmp_path):
    rig, _ = grasp
    seen = observations(grasp)
    joint = rig.hand.moving[0]
    for k in range(20, 25):
        seen[k] = dataclasses.replace(
            seen[k], joint_positions={**seen[k].joint_positions, joint: float("nan")}
        )
    path = recorded(tmp_path / "a.mcap", seen, rig)
    ended = assert_tracked(
        path,
        rig,
        tmp_path / "out",
        rf"^/joint_states: 5 of 39 messages left out: joint {joint} is not a finite number$",
    )
    assert len(ended.steps) == 34


def test_a_hand_whose_joint_is_not_in_the_recording_says_so(grasp, tmp_path):
    rig, _ = grasp
    joint = "robot0:THJ0"
    less = (
        {name: value for name, value in s.joint_positions.items() if name != joint}
        for s in observations(grasp)
    )
    seen = [
        dataclasses.replace(s, joint_positions=joints)
        for s, joints in zip(observations(grasp), less, strict=True)
    ]
    ended, written = track(recorded(tmp_path / "a.mcap", seen, rig), rig, tmp_path / "out")
    assert any(
        said.startswith(f"joint {joint!r}: never on /joint_states; the nearest is 'robot0:THJ")
        for said in ended.said
    )
    assert any(
        sentence.startswith(
            f"39 observations left out: joint_positions: expected a position for {joint}; got "
        )
        for sentence in ended.sentences()
    )
    assert written[0].startswith("wrote ")
    assert written[1:] == ["no picture: there is no pose"]
    assert (tmp_path / "out" / "track.tum").read_text() == ""


def test_a_wrong_size_of_the_object_is_in_the_rig_beside_the_recording():
    from handsight.cli.simulate import _believed, nuisances
    from handsight.errors import InvalidInput
    from handsight.simulation import Scenario, rig_of

    for name, size in (("can", "cylinder"), ("box", "box")):
        scenario = Scenario(object=name, nuisances=nuisances(["object_scale=1.03"]))
        rig = rig_of(scenario)
        expected = 1.03 * np.array(getattr(rig.objects[name], size))
        np.testing.assert_allclose(getattr(_believed(scenario, rig), size), expected)
    with pytest.raises(
        InvalidInput, match="object_dent: expected one of the recording, got one of the object's model"
    ):
        nuisances(["object_dent=0.002"])
