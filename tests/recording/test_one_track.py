"""One recording has one track, whatever file it is in."""

from contextlib import closing
from types import SimpleNamespace

import pytest
from rosbags import rosbag1, rosbag2

from handsight.cli.demo import DATA
from handsight.messages.read import typestore
from handsight.messages.topics import rig_topics
from handsight.objects import ObjectModel
from handsight.recording import TrackRow, open_recording, write_track_csv
from handsight.recording.mcap import McapSource
from handsight.rig import Rig
from handsight.tracking import Tracker
from handsight.tracking.replay import Tally, replay

SECONDS = 1.5


@pytest.fixture(scope="module")
def demo():
    """The rig of the demo's recording, and the messages of its beginning."""
    rig = Rig.from_file(DATA / "can.rig.yaml")
    with closing(McapSource(DATA / "can.mcap")) as source:
        messages = list(source.messages(rig_topics(rig)))
    end = messages[0].log_time + SECONDS
    return SimpleNamespace(rig=rig, messages=[each for each in messages if each.log_time < end])


def saved(folder, messages, kind):
    """The path of the messages as a bag of ROS 1, as sqlite3, or as an MCAP with zstd chunks."""
    path, store = folder / kind, typestore("ros1" if kind == "bag" else "cdr")
    if kind == "bag":
        path = path.with_suffix(".bag")
        writer = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if kind == "mcap":
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for each in messages:
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(each.topic, each.type, typestore=store)
            data = typestore("cdr").cdr_to_ros1(each.data, each.type) if kind == "bag" else each.data
            writer.write(connections[each.topic], round(1e9 * each.log_time), data)
    return path


def track(path, rig, folder):
    """What `write_track_csv` writes of a recording's track."""
    tracker = Tracker(rig, ObjectModel.cylinder(0.033, 0.122))
    with open_recording(path, rig) as recording:
        steps = list(replay(recording.observations(), tracker, Tally()))
    assert len(steps) > 50
    rows = [
        TrackRow(each.stamp, each.estimate.T_palm_object, each.estimate.covariance, each.state, each.reason)
        for each in steps
    ]
    write_track_csv(folder / "track.csv", rows)
    return (folder / "track.csv").read_bytes()


def test_a_bag_sqlite3_and_a_zstd_mcap_of_one_recording_have_the_same_track(demo, tmp_path):
    tracks = {
        track(saved(tmp_path, demo.messages, kind), demo.rig, tmp_path) for kind in ("bag", "db3", "mcap")
    }
    assert len(tracks) == 1
