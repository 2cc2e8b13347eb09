"""Whatever ends a run through a recording early, what was found by then is written, and the exit code tells."""

import dataclasses
import json

import numpy as np
import pytest

from cli.commands import called
from cli.tracks import assert_results_agree, observations, recorded
from handsight.recording import Recording
from handsight.rig.save import write as write_rig
from handsight.tracking import Tracker


@pytest.fixture
def folder(grasp, tmp_path):
    """A recording of a grasp, with its rig."""
    rig, _ = grasp
    recorded(tmp_path / "can.mcap", observations(grasp), rig)
    write_rig(rig, tmp_path / "can.rig.yaml")
    return tmp_path


def fails_after(count, original, error):
    """A generator function, or an update, that raises in the middle."""
    calls = iter(range(10**9))

    def generator(self, *place):
        for observation in original(self, *place):
            if next(calls) == count:
                raise error
            yield observation

    def update(self, observation):
        if next(calls) == count:
            raise error
        return original(self, observation)

    return update if original is Tracker.update else generator


@pytest.mark.parametrize(
    "owner", [(Recording, "observations"), (Tracker, "update")], ids=["reader", "tracker"]
)
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (RuntimeError("a fault"), 1, "handsight: internal error: RuntimeError in test_ends_early"),
        (MemoryError(), 1, "handsight: internal error: MemoryError in test_ends_early.py"),
        (KeyboardInterrupt(), 130, ""),
    ],
    ids=["fault", "memory", "Ctrl-C"],
)  # fmt: skip
def test_track_writes_what_was_tracked(folder, monkeypatch, capsys, owner, error, code, said):
    kind, name = owner
    monkeypatch.setattr(kind, name, fails_after(25, getattr(kind, name), error))
    assert called(monkeypatch, folder, "track", "can.mcap", "--object", "can") == code
    err = capsys.readouterr().err
    assert said in err
    assert "wrote can-track: track.mcap, track.tum, track.csv, summary.json" in err
    assert assert_results_agree(folder / "can-track")["poses"] == 25


def test_results_that_cannot_be_written_do_not_keep_the_others_from_it(folder, monkeypatch, capsys):
    (folder / "can-track" / "track.mcap").mkdir(parents=True)
    assert called(monkeypatch, folder, "track", "can.mcap", "--object", "can") == 2
    err = capsys.readouterr().err
    assert err.count("handsight: can-track/track.mcap: expected a file to write, got a folder") == 1
    assert "wrote can-track: track.tum, track.csv, summary.json" in err


def test_calibrate_camera_prints_what_was_found(folder, monkeypatch, capsys):
    failing = fails_after(36, Recording.observations, RuntimeError("a fault"))
    monkeypatch.setattr(Recording, "observations", failing)
    assert called(monkeypatch, folder, "calibrate", "camera", "can.mcap", "--object", "can") == 1
    out, err = capsys.readouterr()
    assert "# known to ±" in out
    assert "handsight: internal error: RuntimeError" in err


def test_without_a_pose_the_exit_code_is_1_and_the_reason_is_printed(grasp, folder, monkeypatch, capsys):
    rig, _ = grasp
    seen = observations(grasp)
    for changes, said in (
        ({"vision": None}, "no pose: no pose yet: neither a start nor vision"),
        ({"T_world_palm": None}, "poses of vision came while the palm's pose in the world was not known"),
        ({"joint_positions": {"elbow": 0.0}}, "no pose: all observations were left out"),
    ):
        recorded(folder / "none.mcap", (dataclasses.replace(each, **changes) for each in seen), rig)
        arguments = ("track", "none.mcap", "--rig", "can.rig.yaml", "--object", "can")
        assert called(monkeypatch, folder, *arguments) == 1
        assert said in capsys.readouterr().err


def test_a_finger_that_never_touches_is_reported(grasp, folder, monkeypatch, capsys):
    rig, _ = grasp
    free = rig.fingers["lf"].calibration
    reading = np.concatenate([free.bias_force, free.bias_torque])
    seen = (
        dataclasses.replace(each, wrenches={**each.wrenches, "lf": reading}) for each in observations(grasp)
    )
    recorded(folder / "can.mcap", seen, rig)
    assert called(monkeypatch, folder, "track", "can.mcap", "--object", "can") == 0
    assert "finger lf: no contact in any observation (free in " in capsys.readouterr().err
    summary = json.loads((folder / "can-track" / "summary.json").read_text())
    assert list(summary["fingers_without_contact"]) == ["lf"]


def test_a_finger_that_the_others_contradict_is_reported(grasp, folder, monkeypatch, capsys):
    """As where one `reading` has the wrong sign."""
    rig = folder / "can.rig.yaml"
    rig.write_text(rig.read_text().replace("reading: on_tip", "reading: on_sensor", 1))
    first = next(iter(grasp[0].fingers))
    assert called(monkeypatch, folder, "track", "can.mcap", "--object", "can") == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "contradicts the others" in line]
    assert f"at the end: finger {first} contradicts the others" in told.pop(0)
    assert [line.split(":")[0] for line in told] == [f"finger {first}"]
    rejected = json.loads((folder / "can-track" / "summary.json").read_text())["fingers_rejected"]
    assert rejected[first] > 0.9
    assert all(part < 0.1 for finger, part in rejected.items() if finger != first)
