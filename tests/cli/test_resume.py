"""A track that ended early goes on, and its results are those of a run from end to end."""

import json

import pytest

from cli.commands import called
from cli.tracks import observations, poses_of, recorded
from handsight.cli import track
from handsight.rig.save import write as write_rig
from handsight.tracking import Tracker


class Killed(BaseException):
    """Ends a process without any handler."""


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
    for count, error in ((20, KeyboardInterrupt()), (9, Killed())):
        calls = iter(range(10**9))

        def fails(self, observation, calls=calls, count=count, error=error):
            if next(calls) == count:
                raise error
            return update(self, observation)

        monkeypatch.setattr(Tracker, "update", fails)
        if isinstance(error, Killed):
            with pytest.raises(Killed):
                called(monkeypatch, tmp_path, *arguments, "in parts")
        else:
            assert called(monkeypatch, tmp_path, *arguments, "in parts") == 130
    monkeypatch.setattr(Tracker, "update", update)
    capsys.readouterr()
    assert called(monkeypatch, tmp_path, *arguments, "in parts") == 0
    assert "in parts/track.part: goes on after 29 poses" in capsys.readouterr().err
    assert results(tmp_path / "in parts") == results(tmp_path / "at once")
    assert not (tmp_path / "in parts" / "track.part").exists()
