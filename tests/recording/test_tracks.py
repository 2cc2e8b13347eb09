"""What was tracked, in three formats that others read."""

import csv

import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapReader
from scipy.spatial.transform import Rotation

from handsight import se3
from handsight.errors import InvalidFile, InvalidInput, NotWritten
from handsight.observation import Observation, PoseMeasurement
from handsight.recording import RecordingWriter, TrackRow, write_track_csv, write_track_mcap, write_track_tum
from messages.ros import START, Messages, rig
from testbed.refusals import refused

RNG = np.random.default_rng(0)
SIGMAS = np.array([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03])
ROWS = [
    TrackRow(START, None, None, "lost", "no first pose"),
    TrackRow(START + 0.01, se3.random(RNG), np.diag(SIGMAS**2), "tracking"),
    TrackRow(START + 0.02, se3.random(RNG), None, "uncertain", "two contacts, no sight"),
]


def check_poses(numbers):
    """Rows of x y z qx qy qz qw are those of ROWS, by SciPy's reading of the quaternion."""
    for row, values in zip(ROWS[1:], numbers, strict=True):
        np.testing.assert_allclose(values[:3], row.T_palm_object[:3, 3], atol=1e-9)
        np.testing.assert_allclose(
            Rotation.from_quat(values[3:]).as_matrix(), row.T_palm_object[:3, :3], atol=1e-8
        )


def test_tum(tmp_path):
    write_track_tum(tmp_path / "a.txt", ROWS)
    table = np.loadtxt(tmp_path / "a.txt")
    np.testing.assert_allclose(table[:, 0], [START + 0.01, START + 0.02], atol=1e-6)
    check_poses(table[:, 1:])


def test_csv(tmp_path):
    write_track_csv(tmp_path / "a.csv", ROWS)
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["lost", "tracking", "uncertain"]
    assert [row["reason"] for row in rows] == ["no first pose", "", "two contacts, no sight"]
    assert rows[0]["x"] == ""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    check_poses([[float(row[name]) for name in names] for row in rows[1:]])
    sigmas = [float(rows[1][f"sigma_{name}"]) for name in ("x", "y", "z", "rx", "ry", "rz")]
    np.testing.assert_allclose(sigmas, SIGMAS, rtol=1e-5)
    assert rows[2]["sigma_x"] == ""


def test_mcap(tmp_path):
    write_track_mcap(tmp_path / "a.mcap", ROWS, frame="hand_palm")
    reader = McapReader(tmp_path / "a.mcap")
    reader.open()
    (connection,) = reader.connections
    assert (connection.topic, connection.msgtype) == (
        "/handsight/pose",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
    )
    found = [
        Messages().store.deserialize_cdr(data, c.msgtype) for c, _, data in reader.messages([connection])
    ]
    reader.close()
    assert {message.header.frame_id for message in found} == {"hand_palm"}
    poses = [message.pose.pose for message in found]
    check_poses(
        [
            [
                p.position.x,
                p.position.y,
                p.position.z,
                p.orientation.x,
                p.orientation.y,
                p.orientation.z,
                p.orientation.w,
            ]
            for p in poses
        ]
    )
    np.testing.assert_allclose(found[0].pose.covariance.reshape(6, 6), np.diag(SIGMAS**2))
    nothing_known = np.diag([1.0] * 3 + [np.pi**2 / 3] * 3)
    np.testing.assert_allclose(found[1].pose.covariance.reshape(6, 6), nothing_known, rtol=1e-12)


@pytest.mark.parametrize("write", [write_track_mcap, write_track_tum, write_track_csv])
def test_a_missing_folder_is_an_error_in_a_sentence(tmp_path, write):
    with refused(InvalidFile, "a"):
        write(tmp_path / "none" / "a", ROWS)


@pytest.mark.parametrize("write", [write_track_mcap, write_track_tum, write_track_csv])
def test_no_rows_are_a_file_too(tmp_path, write):
    write(tmp_path / "a", [])
    assert (tmp_path / "a").is_file()


@pytest.mark.parametrize(
    ("observation", "field"),
    [
        (Observation(-1.0), "stamp"),
        (Observation(np.nan), "stamp"),
        (Observation(1.0, wrenches={"lf": np.zeros(6)}), "topics.wrenches.lf"),
        (
            Observation(1.0, wrenches={"ff": np.full(6, np.nan)}),
            "wrenches['ff']",
        ),
        (
            Observation(1.0, T_world_palm=np.eye(4)),
            "topics.tf",
        ),
        (Observation(1.0, vision=PoseMeasurement(np.eye(4))), "topics.vision"),
        (Observation(1.0, depth=np.ones((2, 2), np.float32)), "topics.depth"),
        (Observation(1.0, color=np.ones((2, 2, 3), np.uint8)), "topics.color"),
    ],
)
def test_what_the_rig_has_no_place_for_is_not_written(tmp_path, observation, field):
    robot = rig(tf=None, vision=None, color=None, depth=None, truth=None)
    with RecordingWriter(tmp_path / "a.mcap", robot) as writer, refused(InvalidInput, field):
        writer.write(observation)
    with (
        RecordingWriter(tmp_path / "a.mcap", robot) as writer,
        refused(InvalidInput, "topics.truth"),
    ):
        writer.write_truth(1.0, np.eye(4))


def test_what_was_written_before_an_error_is_kept(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap", rig()) as writer:
        writer.write(Observation(1.0, {"j0": 0.0}))
        with pytest.raises(InvalidInput):
            writer.write(Observation(-1.0))
    reader = McapReader(tmp_path / "a.mcap")
    reader.open()
    assert reader.metadata.message_count == 1
    reader.close()


def test_a_folder_is_not_replaced_by_a_file(tmp_path):
    with refused(InvalidFile, tmp_path.name):
        RecordingWriter(tmp_path, rig())


@pytest.mark.parametrize("write", [write_track_tum, write_track_csv])
def test_a_track_that_does_not_fit_on_the_disk_leaves_no_file_cut_short(tmp_path, write):
    resource = pytest.importorskip("resource")
    rows = [TrackRow(float(k), np.eye(4), np.eye(6), "tracking") for k in range(5000)]
    path = tmp_path / "track"
    path.write_text("the one before\n")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with refused(NotWritten, "track"):
            write(path, rows)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [each.read_text() for each in tmp_path.iterdir()] == ["the one before\n"]
