"""A track that ended early goes on, and its results are those of a run from end to end."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from cli.commands import called
from cli.tracks import observations, poses_of, recorded
from handsight.cli import track
from handsight.recording import TrackRow
from handsight.recording.track_log import TrackLog
from handsight.rig.save import write as write_rig
from handsight.tracking import Tracker


def results(folder):
    """All that is in the results, but for the time that they took."""
    summary = json.loads((folder / "summary.json").read_text())
    texts = [(folder / name).read_text() for name in ("track.csv", "track.tum")]
    taken = {"seconds_taken", "real_time_factor"}
    return texts, poses_of(folder)[2].tolist(), {k: v for k, v in summary.items() if k not in taken}


def as_sqlite(path):
    """The same messages in a rosbag 2 of sqlite."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer

    folder = path.parent / "bag"
    with AnyReader([path]) as reader, Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        topics = {
            c.id: bag.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
            for c in reader.connections
        }
        for connection, stamp, data in reader.messages():
            bag.write(topics[connection.id], stamp, data)
    return folder


@pytest.mark.parametrize("ending", [".mcap", ".db3"])
def test_a_track_that_was_interrupted_and_killed_has_the_results_of_one_that_was_not(
    grasp, tmp_path, monkeypatch, capsys, ending
):
    rig, samples = grasp
    truths = [(s.observation.stamp, s.T_palm_object) for s in samples]
    name = recorded(tmp_path / "can.mcap", observations(grasp), rig, truths).name
    if ending == ".db3":
        name = as_sqlite(tmp_path / name).name
    write_rig(rig, tmp_path / "can.rig.yaml")
    arguments = ("track", name, "--rig", "can.rig.yaml", "--object", "can", "--output-folder")
    assert called(monkeypatch, tmp_path, *arguments, "at once") == 0
    monkeypatch.setattr(track, "CHECKPOINT_PERIOD", 0.0)
    update = Tracker.update
    for count in (20, 9):
        calls = iter(range(10**9))

        def ends_early(self, observation, calls=calls, count=count):
            if next(calls) == count:
                shutil.copytree(
                    "in parts/track.part", f"killed {count}/track.part"
                )  # as it is at this instant
                raise KeyboardInterrupt
            return update(self, observation)

        monkeypatch.setattr(Tracker, "update", ends_early)
        assert called(monkeypatch, tmp_path, *arguments, "in parts") == 130
    monkeypatch.setattr(Tracker, "update", update)
    capsys.readouterr()
    assert called(monkeypatch, tmp_path, *arguments, "killed 9") == 0
    assert "killed 9/track.part: goes on after 29 poses" in capsys.readouterr().err
    assert results(tmp_path / "killed 9") == results(tmp_path / "at once")
    assert not (tmp_path / "killed 9" / "track.part").exists()


def opened(folder, seal):
    """The state and the stamps of a log, which stays as it is."""
    log = TrackLog(folder, seal)
    found = log.state, [row.stamp for row in log.rows()]
    log.close(resumable=True)
    return found


def test_a_checkpoint_that_somebody_else_has_written_is_not_read(tmp_path):
    row = TrackRow(0.0, np.eye(4), np.eye(6), "tracking", "", np.eye(6))
    for changed in ("", "checkpoint", "rows"):
        log = TrackLog(tmp_path / changed, "seal")
        log.append(row)
        log.save("mine")
        log.append(replace(row, stamp=1.0))
        log.close(resumable=True)
        if changed:
            file = tmp_path / changed / "track.part" / changed
            content = bytearray(file.read_bytes())
            content[45] ^= 1
            file.write_bytes(content)
        assert opened(tmp_path / changed, "seal") == ((None, []) if changed else ("mine", [0.0]))
    log = TrackLog(tmp_path / "other", "seal")
    log.append(row)
    log.save("mine")
    log.close(resumable=True)
    assert opened(tmp_path / "other", "another seal") == (None, [])
