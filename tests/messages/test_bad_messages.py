"""A message that cannot be used is counted, with a sentence that says why; the others are used."""

import numpy as np
import pytest

from handsight import se3
from messages.ros import FINGERS, JOINTS, START, Messages, heard, rig, touched

M = Messages()


def reading_with(*extra, robot=None):
    """Observations and report of a good recording with more messages in it, at 0.305 s."""
    rows = touched(100) + [(topic, START + 0.305, message) for topic, message in extra]
    observations, stream = heard(sorted(rows, key=lambda row: row[1]), robot)
    report = stream.report
    for topic in report.topics.values():
        parts = topic.used, topic.duplicated, topic.nan, topic.late, topic.bad, topic.stale, topic.stuck
        assert sum(parts) == topic.messages
    return observations, report


def at(offset=0.305):
    return START + offset


@pytest.mark.parametrize(
    ("topic", "message", "reason"),
    [
        (
            "/joint_states",
            M.joints(at(), JOINTS, (0.1, np.nan, 0.3)),
            "expected a position of joint j1 within 1e+06, got nan",
        ),
        (
            "/ff/wrench",
            M.wrench(at(), [1, 2, 3, np.inf, 5, 6]),
            "expected a force [N] and torque [N m] within 100000, got inf",
        ),
        ("/joint_states", M.joints(at(), JOINTS, (1, 2)), "expected as many positions as names, got 2 for 3"),
        ("/joint_states", M.joints(at(), ("a", "a"), (1, 2)), "expected each joint once, got one name twice"),
        (
            "/vision/object",
            M.pose(at(), np.eye(4), xyzw=(0, 0, 0, 0)),
            "expected an orientation, got a quaternion of length 0",
        ),
        (
            "/vision/object",
            M.pose(at(), np.eye(4), frame="cam"),
            "unknown frame 'cam'; valid: 'camera' (camera), 'world' (world), 'palm' (palm)",
        ),
        (
            "/vision/object",
            M.pose(at(), np.eye(4), covariance=-np.eye(6)),
            "vision.covariance: expected a positive semidefinite covariance, got a negative eigenvalue",
        ),
        (
            "/truth",
            M.pose(at(), np.eye(4), frame="world"),
            "expected the truth in the palm ('palm'), got it in the world",
        ),
        (
            "/tf",
            M.tf(at(), ("world", "palm", np.full((4, 4), np.nan))),
            "transform to 'palm': expected a position [m] within 1000, got nan",
        ),
        (
            "/vision/object",
            M.wrench(at(), np.ones(6)),
            "expected geometry_msgs/msg/PoseStamped or geometry_msgs/msg/PoseWithCovarianceStamped, "
            "got geometry_msgs/msg/WrenchStamped",
        ),
    ],
)
def test_a_message_that_is_no_measurement_is_counted_with_the_reason(topic, message, reason):
    observations, report = reading_with((topic, message))
    assert len(observations) == 100
    counted = report.topics[topic]
    assert counted.nan + counted.bad == 1
    assert f"{topic}: 1 of {counted.messages} messages left out: {reason}" in report.sentences()


def test_poses_with_nan_are_counted_as_such():
    nowhere = np.eye(4)
    nowhere[0, 3] = np.nan
    covariance = np.full((6, 6), np.nan)
    _, report = reading_with(("/vision/object", M.pose(at(), nowhere, covariance=np.eye(6))))
    assert report.topics["/vision/object"].nan == 1
    _, report = reading_with(("/vision/object", M.pose(at(), np.eye(4), covariance=covariance)))
    assert report.topics["/vision/object"].nan == 1


@pytest.mark.parametrize("frame", ["camera", "world", "palm", "/palm"])
def test_frames_are_known_by_the_rigs_names(frame):
    T = se3.random(np.random.default_rng(0))
    observations, _ = reading_with(("/vision/object", M.pose(at(), T, frame=frame)))
    (seen,) = (each.vision for each in observations if each.vision)
    assert seen.frame == frame.strip("/")
    np.testing.assert_allclose(seen.T_frame_object, T, atol=1e-12)
    assert seen.covariance is None


def test_a_covariance_of_zeros_is_none():
    given, zeros = np.diag([1.0, 2, 3, 4, 5, 6]), np.zeros((6, 6))
    observations, _ = reading_with(("/vision/object", M.pose(at(), np.eye(4), covariance=zeros)))
    assert [each.vision.covariance for each in observations if each.vision] == [None]
    observations, _ = reading_with(("/vision/object", M.pose(at(), np.eye(4), covariance=given)))
    (seen,) = (each.vision for each in observations if each.vision)
    np.testing.assert_array_equal(seen.covariance, given)


def test_only_so_many_reasons_are_kept():
    poses = [
        ("/vision/object", START + i / 100, M.pose(START + i / 100, np.eye(4), frame=f"f{i}"))
        for i in range(50)
    ]
    _, stream = heard(sorted(touched(50) + poses, key=lambda row: row[1]))
    reasons = stream.report.topics["/vision/object"].reasons
    assert len(reasons) == 9
    assert reasons["other reasons"] == 42


def dead(six, robot=None, count=150):
    """The thumb reads the same from 0.2 s on."""
    rows = touched(count)
    for i, (topic, log, _) in enumerate(rows):
        if topic == "/th/wrench" and log > START + 0.195:
            rows[i] = (topic, log, M.wrench(log, six))
    return heard(rows, robot)


def test_a_sensor_that_is_stuck_is_named_and_left_out():
    observations, stream = dead([1, 2, 3, 4, 5, 6])
    assert ["th" in seen.wrenches for seen in observations] == [True] * 71 + [False] * 79
    assert all("ff" in seen.wrenches for seen in observations)
    assert stream.report.topics["/th/wrench"].stuck == 79
    said = "left out: the same six numbers for more than 0.5 s while others change: a dead sensor?"
    assert f"/th/wrench: 79 of 150 messages {said}" in stream.report.sentences()


def test_a_sensor_at_full_scale_is_named_and_left_out_at_once():
    observations, stream = dead([1, 2, -50, 0, 0, 0], rig(full_scale=(50, 9)))
    assert ["th" in seen.wrenches for seen in observations] == [True] * 20 + [False] * 130
    said = "left out: at full scale (50 N, 9 N m): a dead sensor, or another unit?"
    assert f"/th/wrench: 130 of 150 messages {said}" in stream.report.sentences()
    observations, stream = dead([0, 0, 0, 0, 9, 0], rig(full_scale=(50, 9)))
    assert stream.report.topics["/th/wrench"].stuck == 130


def test_sensors_that_all_stand_still_are_not_dead():
    rows = touched(1, fingers=FINGERS)
    for i in range(200):
        rows += [
            (f"/{name}/wrench", START + i / 100, M.wrench(START + i / 100, np.ones(6))) for name in FINGERS
        ]
        rows += [("/joint_states", START + i / 100, M.joints(START + i / 100))]
    observations, stream = heard(rows)
    assert all(len(seen.wrenches) == 2 for seen in observations)
    assert stream.report.topics["/th/wrench"].stuck == 0


def test_wrenches_of_no_finger_are_named():
    _, report = reading_with(("/lf/wrench", M.wrench(at(), np.ones(6))))
    assert "/lf/wrench: wrenches of no finger of the rig; not used" in report.sentences()
    assert report.others == {"/lf/wrench": "geometry_msgs/msg/WrenchStamped"}


def test_what_the_rig_lacks_is_named_with_the_nearest():
    rows = [(topic.replace("/th/", "/thumb/"), log, m) for topic, log, m in touched(50)]
    rows += [
        ("/tf", log, M.tf(log, ("world", "hand_palm", np.eye(4))))
        for t, log, _ in touched(50)
        if t == "/joint_states"
    ]
    rows += [("/depth", log, M.wrench(log, np.ones(6))) for _, log, _ in rows[:1]]
    robot = rig(joints=("j0", "j9"))
    _, stream = heard(sorted(rows, key=lambda row: row[1]), robot)
    assert stream.lacks() == [
        "joint 'j9': never on /joint_states; the nearest is 'j2'",
        "finger th: no wrench on /th/wrench; the nearest is '/thumb/wrench'",
        "no vision on /vision/object",
        "no color images on /color",
        "no depth images on /depth: expected sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage, "
        "got geometry_msgs/msg/WrenchStamped",
        "no transform from 'world' to 'palm' on /tf in 50 of 50 observations; 'palm' never came; the nearest is 'hand_palm'",
    ]


def test_frames_that_are_not_connected_are_reported():
    rows = touched(50)
    rows += [("/tf", START, M.tf(START, ("world", "a", np.eye(4)), ("b", "palm", np.eye(4))))]
    _, stream = heard(sorted(rows, key=lambda row: row[1]))
    assert "no transform from 'world' to 'palm' on /tf in 50 of 50 observations" in stream.lacks()


@pytest.mark.parametrize("count", [50, 30])
def test_with_all_transforms_nothing_is_lacking_and_with_some_their_share_is_reported(count):
    stamps = [START + i / 100 for i in range(count)]
    rows = touched(50) + [("/tf", s, M.tf(s, ("world", "palm", np.eye(4)))) for s in stamps]
    rows.append(("/vision/object", START, M.pose(START, np.eye(4))))
    _, stream = heard(sorted(rows, key=lambda row: row[1]), rig(color=None, depth=None, camera_info=None))
    missing = 50 - stream.report.placed
    some = [f"no transform from 'world' to 'palm' on /tf in {missing} of 50 observations"]
    assert stream.lacks() == (some if count == 30 else [])
    assert (missing > 0) == (count == 30)
