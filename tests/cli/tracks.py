"""Simulated grasps, and what tracking makes of recordings of them."""

import csv
import json
import re

import numpy as np
import pytest

from handsight.cli.options import Run
from handsight.cli.track import tracked, write
from handsight.tracking import TrackerSettings

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.recording import RecordingWriter, open_recording
from handsight.recording.track_log import TrackLog


def recorded(path, observations, rig, truths=()):
    with RecordingWriter(path, rig) as writer:
        for seen in observations:
            writer.write(seen)
        for stamp, T in truths:
            writer.write_truth(stamp, T)
    return path


def track(path, rig, folder=None, **settings):
    """The run through a recording, and what is said of writing it."""
    model = rig.objects["can"].model()
    run = Run(path, rig, model, TrackerSettings(**settings))
    with TrackLog() as log:
        ended = tracked(run, lambda *_: None, log, folder)
        return ended, [] if folder is None else list(write(ended, run, folder, log))


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


def observations(grasp):
    return [sample.observation for sample in grasp[1]]


def assert_tracked(path, rig, folder, said, *, least=10):
    """The results were written, some pose was found, and one of the sentences is what is expected."""
    ended, written = track(path, rig, folder)
    assert any(re.search(said, sentence) for sentence in ended.messages), ended.messages
    assert written[0].startswith(f"wrote {folder}: track.mcap")
    assert assert_results_agree(folder)["poses"] >= least
    return ended


def recorded_observations(path, rig):
    with open_recording(path, rig) as recording:
        return list(recording.observations())
