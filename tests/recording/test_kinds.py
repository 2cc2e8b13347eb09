"""What rosbags' writers wrote is what comes out."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidFile, MissingExtra
from handsight.observation import Observation, PoseMeasurement
from handsight.recording import RecordingWriter, open_recording
from messages.ros import FINGERS, JOINTS, START, Messages, everything, rig, touched
from recording.bags import alone, read, save
from testbed.refusals import refused

KINDS = [
    ("mcap", None),
    ("mcap", "STORAGE"),
    ("mcap", "FILE"),
    ("mcap", "MESSAGE"),
    ("db3", None),
    ("db3", "FILE"),
    ("db3", "MESSAGE"),
    ("bag", None),
    ("bag", "BZ2"),
    ("bag", "LZ4"),
]


def check_all_is_there(rows, observations, report):
    """Each observation is the joints and the wrenches of its stamp."""
    assert len(observations) == sum(topic == "/joint_states" for topic, _, _ in rows)
    by_topic = {topic: [m for t, _, m in rows if t == topic] for topic, _, _ in rows}
    for i, seen in enumerate(observations):
        joints = by_topic["/joint_states"][i]
        assert seen.stamp == pytest.approx(START + i / 100, abs=1e-6)
        assert seen.joint_positions == dict(zip(joints.name, joints.position.tolist(), strict=True))
        for finger in FINGERS:
            told = by_topic[f"/{finger}/wrench"][i].wrench
            six = [*vars_of(told.force), *vars_of(told.torque)]
            np.testing.assert_array_equal(seen.wrenches[finger], six)
    assert report.sentences() == []
    assert all(topic.used == topic.messages == len(observations) for topic in report.topics.values())


def vars_of(vector):
    return vector.x, vector.y, vector.z


@pytest.mark.parametrize(("kind", "compression"), KINDS)
def test_each_kind_of_recording_gives_what_was_written(tmp_path, kind, compression):
    rows = touched(messages=Messages(1 if kind == "bag" else 2))
    observations, recording = read(save(tmp_path, rows, kind, compression=compression))
    check_all_is_there(rows, observations, recording.report)


@pytest.mark.parametrize(("kind", "ros"), [("mcap", 2), ("db3", 2), ("bag", 1)])
def test_images_and_poses_are_read_from_each_kind_of_recording(tmp_path, kind, ros):
    observations, recording = read(save(tmp_path, everything(Messages(ros)), kind))
    assert len(observations) == 10
    for field in ("vision", "color", "depth"):
        assert sum(getattr(seen, field) is not None for seen in observations) == 3
    assert all(seen.T_world_palm is not None for seen in observations)
    assert recording.report.sentences() == []


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_file_of_a_rosbag_2_opens_without_its_folder(tmp_path, kind):
    rows = touched()
    observations, recording = read(alone(save(tmp_path, rows, kind)))
    check_all_is_there(rows, observations, recording.report)


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_recording_that_was_split_is_one(tmp_path, kind):
    rows = touched(120)
    folder = tmp_path / "split"
    folder.mkdir()
    for i in range(12):  # the tenth comes after the ninth, not after the first
        part = save(tmp_path, rows[30 * i : 30 * i + 30], kind)
        (file,) = part.glob(f"*.{kind}")
        file.rename(folder / f"split_{i}.{kind}")
    observations, recording = read(folder)
    check_all_is_there(rows, observations, recording.report)


def test_mcap_with_messages_of_ros_1_is_read(tmp_path):
    """As `mcap convert` makes it of a bag: rewrite the channel's encoding and the messages."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    messages = Messages(1)
    rows = touched(messages=messages)
    path = tmp_path / "ros1"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, log, message in rows:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, name, msgdef="float64 x", rihs01="0", serialization_format="ros1"
                )
            data = messages.store.serialize_ros1(message, name)
            writer.write(connections[topic], round(log * 1e9), data)
    observations, recording = read(path)
    check_all_is_there(rows, observations, recording.report)


def test_chunks_that_overlap_in_time_are_put_in_order(tmp_path):
    rows = touched(400)
    by_topic = sorted(rows, key=lambda row: row[0])  # written one topic after the other
    observations, recording = read(save(tmp_path, by_topic))
    assert len(observations) == 400
    assert recording.report.topics["/joint_states"].late == 0


@pytest.fixture
def sample():
    rng = np.random.default_rng(3)
    depth = rng.uniform(0.3, 2.0, size=(24, 32)).astype(np.float32)
    depth[3:5, 7] = np.nan
    return Observation(
        stamp=12.345678901,
        joint_positions=dict(zip(JOINTS, rng.normal(size=3), strict=True)),
        wrenches={"ff": rng.normal(size=6)},
        vision=PoseMeasurement(se3.random(rng), "world", np.diag([1, 2, 3, 4, 5, 6.0])),
        T_world_palm=se3.random(rng),
        color=rng.integers(0, 255, size=(24, 32, 3), dtype=np.uint8),
        depth=depth,
    )


def test_what_the_writer_wrote_comes_back(tmp_path, sample):
    rng = np.random.default_rng(4)
    T_palm_object = se3.random(rng)
    with RecordingWriter(tmp_path / "a.mcap", rig()) as writer:
        writer.write(sample)
        writer.write_truth(sample.stamp, T_palm_object)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]
    (seen,), recording = read(tmp_path / "a.mcap")
    assert seen.stamp == pytest.approx(sample.stamp, abs=1e-9)
    assert seen.joint_positions == sample.joint_positions
    assert set(seen.wrenches) == {"ff"}
    np.testing.assert_array_equal(seen.wrenches["ff"], sample.wrenches["ff"])
    np.testing.assert_allclose(seen.T_world_palm, sample.T_world_palm, atol=1e-12)
    np.testing.assert_allclose(seen.vision.T_frame_object, sample.vision.T_frame_object, atol=1e-12)
    assert seen.vision.frame == "world"
    np.testing.assert_array_equal(seen.vision.covariance, sample.vision.covariance)
    np.testing.assert_array_equal(seen.color, sample.color)
    np.testing.assert_allclose(seen.depth, sample.depth, atol=0.00051)
    assert seen.depth.dtype == np.float32
    ((stamp, T),) = recording.truth
    assert stamp == seen.stamp
    np.testing.assert_allclose(T, T_palm_object, atol=1e-12)
    np.testing.assert_array_equal(recording.intrinsics.matrix, rig().camera.intrinsics)
    assert recording.intrinsics.size == (32, 24)
    assert len(recording.intrinsics.lens) == 0


def test_what_the_writer_wrote_rosbags_reads(tmp_path, sample):
    from rosbags.rosbag2.storage_mcap import McapReader

    with RecordingWriter(tmp_path / "a.mcap", rig()) as writer:
        writer.write(sample)
    reader = McapReader(tmp_path / "a.mcap")
    reader.open()
    found = {
        c.topic: Messages().store.deserialize_cdr(data, c.msgtype)
        for c, _, data in reader.messages(reader.connections)
    }
    reader.close()
    assert set(found) == {"/joint_states", "/ff/wrench", "/tf", "/vision/object", "/color", "/depth", "/info"}
    assert found["/vision/object"].header.frame_id == "world"
    assert found["/depth"].encoding == "16UC1"
    assert found["/depth"].data.view("<u2").reshape(24, 32)[3, 7] == 0


def test_a_stamp_of_today_survives_to_the_last_bit(tmp_path):
    stamps = START + np.random.default_rng(0).uniform(0, 1, size=50)
    with RecordingWriter(tmp_path / "a.mcap", rig()) as writer:
        for stamp in sorted(stamps.tolist()):
            writer.write(Observation(stamp, {"j0": 0.0}))
    observations, _ = read(tmp_path / "a.mcap")
    assert [seen.stamp for seen in observations] == sorted(stamps.tolist())


def test_a_missing_extra_names_the_install(tmp_path, monkeypatch):
    from handsight.messages import read

    path = save(tmp_path, everything(Messages()))
    read.typestore.cache_clear()
    for name in ("rosbags.typesys", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtra), open_recording(path, rig()) as recording:
        next(recording.observations())
    with pytest.raises(MissingExtra):
        RecordingWriter(tmp_path / "a.mcap", rig())


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_a_recording_without_joint_states_says_what_is_there(tmp_path, kind):
    messages = Messages(1 if kind == "bag" else 2)
    rows = [row for row in touched(messages=messages) if row[0] != "/joint_states"]
    path = save(tmp_path, rows, kind)
    with pytest.raises(InvalidFile) as error:
        open_recording(path, rig())
    assert str(error.value) == (
        f"{path}: expected joint states on /joint_states, got none; valid: /ff/wrench, /th/wrench"
    )


def test_a_topic_of_joint_states_without_messages_says_so_at_the_end(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer

    messages = Messages()
    with Writer(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        wrench = writer.add_connection(
            "/ff/wrench", "geometry_msgs/msg/WrenchStamped", typestore=messages.store
        )
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=messages.store)
        message = messages.wrench(START, np.ones(6))
        writer.write(wrench, int(START * 1e9), messages.store.serialize_cdr(message, message.__msgtype__))
    with open_recording(tmp_path / "a", rig()) as recording, refused(InvalidFile, "a"):
        list(recording.observations())


@pytest.mark.parametrize("count", [4, 5, 8])
def test_a_lens_that_was_written_is_read(tmp_path, sample, count):
    lens = np.linspace(-0.2, 0.3, count)
    robot = rig()
    robot = replace(robot, camera=replace(robot.camera, lens=lens))
    with RecordingWriter(tmp_path / "a.mcap", robot) as writer:
        writer.write(sample)
    _, recording = read(tmp_path / "a.mcap", robot)
    found = recording.intrinsics.lens
    np.testing.assert_array_equal(found[:count], lens)
    assert not found[count:].any()


def test_importing_brings_nothing_of_ros():
    code = "import sys, handsight.recording; sys.exit(bool({'rosbags', 'mcap'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
