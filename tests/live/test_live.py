"""A running robot is heard as its recording is read; what is wrong is said, and nothing ends it."""

import threading
import time
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.live import LiveTracker
from handsight.live.live_tracker import Inbox
from handsight.messages import RawMessage, Report, RosType, TopicReport, pair
from handsight.messages.decode import Measurement
from handsight.messages.encode import Message, header, pose_with_covariance
from handsight.messages.pair import PromptBuffer
from handsight.messages.read import typestore
from handsight.messages.topics import Topic
from handsight.tracking import TrackerSettings
from tests.live.recorded import START, answered, in_ros1, live, model, poses, read, rig, said, tracked


def sentences(tracker, encoding="cdr"):
    """All that the diagnostics say now."""
    tracker.health._judged_at = tracker.health._published_at = -np.inf
    found = [read(each, encoding) for each in tracker.step(0.0) if each.topic == "/diagnostics"]
    return [value.value for status in found[-1].status for value in status.values] + [
        status.message for status in found[-1].status
    ]


def agree(answers, expected, encoding="cdr"):
    found = poses(answers, encoding)
    assert set(found) == set(expected)
    for stamp, T in expected.items():
        np.testing.assert_allclose(found[stamp][0][:3], T[:3, 3], atol=1e-12)


def jittered(messages, rng, most=0.08):
    """As a network would bring them: each later by up to `most` [s], and in that order."""
    late = [each._replace(log_time=each.log_time + rng.uniform(0, most)) for each in messages]
    return sorted(late, key=lambda each: each.log_time)


@pytest.fixture(scope="module")
def expected():
    return tracked(said())


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_live_and_track_give_the_same_poses_on_the_same_bytes(expected, encoding):
    messages = said() if encoding == "cdr" else in_ros1(said())
    agree(answered(live(encoding, equal=True), messages, at_once=7), expected, encoding)


def test_shuffled_and_doubled_messages_change_nothing(expected):
    rng = np.random.default_rng(0)
    doubled = [each for each in said() for _ in range(1 + (rng.random() < 0.2))]
    tracker = live(equal=True)
    agree(answered(tracker, jittered(doubled, rng), at_once=3), expected)
    assert any("came twice with one stamp" in sentence for sentence in sentences(tracker))


def followed(tracker):
    """The observations that the tracker was given."""
    given, update = [], tracker.tracker.update
    tracker.tracker.update = lambda seen: (given.append(seen), update(seen))[1]
    return given


def test_a_late_tracker_answers_the_newest_joint_state_and_all_with_vision_and_counts_the_others():
    tracker = live()
    given = followed(tracker)
    answers = answered(tracker, said(), at_once=10**6)
    # One of the last instant waits for the next joint states.
    sights = sum(each.topic == "/vision/object" for each in said() if each.log_time < said()[-1].log_time)
    assert sum(seen.vision is not None for seen in given) == sights
    assert len(given) + tracker.skipped == sum(each.topic == "/joint_states" for each in said())
    assert len(given) <= sights + 2
    assert max(poses(answers)) == pytest.approx(said()[-1].log_time, abs=1e-6)


def test_without_waiting_an_observation_has_all_of_its_stamp_and_nothing_later(monkeypatch):
    """Each instant's messages come in any order, joint states before their wrenches too."""
    monkeypatch.setattr(pair, "MAX_WAIT", 10.0)  # however busy the machine is
    rng, tracker = np.random.default_rng(1), live()
    given = followed(tracker)
    stamps = sorted({each.log_time for each in said()})
    for stamp in stamps:
        now = [each for each in said() if each.log_time == stamp]
        answered_now = [now[k] for k in rng.permutation(len(now))]
        for each in answered_now:
            tracker.put(each)
        tracker.step(0.0)
    after_first_second = [seen for seen in given if seen.stamp > START + 1.02]
    assert len(after_first_second) >= 55
    assert all(set(seen.wrenches) == {"ff", "mf", "rf", "lf", "th"} for seen in after_first_second)
    by_stamp = {seen.stamp: seen for seen in given}
    for each in said():
        if each.topic == "/ff/wrench" and each.log_time in by_stamp:
            exact = read_wrench(each)
            np.testing.assert_array_equal(by_stamp[each.log_time].wrenches["ff"], exact)


def read_wrench(message):
    wrench = typestore("cdr").deserialize_cdr(message.data, message.type).wrench
    return np.array([*(getattr(wrench.force, k) for k in "xyz"), *(getattr(wrench.torque, k) for k in "xyz")])


def test_joint_states_wait_so_long_and_no_longer(monkeypatch):
    assert pair.MAX_WAIT == 0.002
    monkeypatch.setattr(pair, "MAX_WAIT", 0.3)  # however busy the machine is
    tracker = live()
    for each in said():
        tracker.put(each)
    tracker.step(0.0)
    joints = next(each for each in said() if each.topic == "/joint_states")
    stamp = said()[-1].log_time + 0.01
    late = typestore("cdr").deserialize_cdr(joints.data, joints.type)
    late.header.stamp.sec, late.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    data = bytes(typestore("cdr").serialize_cdr(late, joints.type))
    tracker.put(joints._replace(log_time=stamp, data=data))
    first = tracker.step(0.0)  # its wrenches have not come
    assert not poses(first)
    begun, second = time.monotonic(), tracker.step(10.0)
    assert round(stamp, 6) in poses(second)
    assert time.monotonic() - begun < 5.0


def spoilt(messages, rng):
    """What no robot should send, among what it should."""
    for each in messages:
        yield each
        kind = rng.integers(0, 40)
        if kind == 0:
            yield each._replace(data=each.data[: rng.integers(0, len(each.data))])
        elif kind == 1:
            yield each._replace(type="std_msgs/msg/String")
        elif kind == 2:
            yield each._replace(encoding="json")
        elif kind == 3:
            data = bytearray(each.data)
            data[rng.integers(0, len(data))] ^= 0xFF
            yield each._replace(data=bytes(data))
        elif kind == 4 and each.topic.endswith("wrench"):
            nan = np.full(6, np.nan).tobytes()
            yield each._replace(data=each.data[: len(each.data) - 48] + nan)
        elif kind == 5:
            yield messages[rng.integers(0, len(messages))]
        elif kind == 6:
            yield RawMessage("/nobody/asked", "a/msg/B", "cdr", each.log_time, b"\0" * 20)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize("seed", range(2))
def test_whatever_comes_is_counted_and_said_and_poses_go_on(encoding, seed):
    messages = said() if encoding == "cdr" else in_ros1(said())
    rng = np.random.default_rng(seed)
    tracker = live(encoding)
    answers = answered(tracker, list(spoilt(messages, rng)), at_once=50)
    assert max(poses(answers, encoding)) > said()[-1].log_time - 0.1
    told = "\n".join(sentences(tracker, encoding))
    assert "left out: expected" in told
    for topic in tracker._stream.report.topics.values():
        counts = topic.used, topic.duplicated, topic.nan, topic.late, topic.bad, topic.stale, topic.stuck
        assert topic.messages >= sum(counts)  # some wait still


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (
            lambda m: m._replace(type="geometry_msgs/msg/Wrench"),
            "expected geometry_msgs/msg/WrenchStamped, got",
        ),
        (lambda m: m._replace(data=m.data[:40]), "expected a geometry_msgs/msg/WrenchStamped, got 40 bytes"),
        (lambda m: m._replace(encoding="protobuf"), "encoded as cdr or ros1, got 'protobuf'"),
        (lambda m: m._replace(data=m.data[:-48] + np.full(6, np.nan).tobytes()), "within 100000, got nan"),
    ],
)
def test_a_wrong_message_is_named(spoil, expected):
    tracker = live()
    wrench = next(each for each in said() if each.topic == "/th/wrench")
    tracker.put(spoil(wrench))
    assert any(said.startswith("/th/wrench: ") and expected in said for said in sentences(tracker))


def test_too_many_messages_are_dropped_the_oldest_first_and_counted():
    box = Inbox(max_waiting=100)
    for k in range(130):
        box.put(RawMessage("/a" if k < 20 else "/b", "", "cdr", float(k), b"x"), 0.0)
    assert [message.log_time for _, message in box.take(0.0)] == list(map(float, range(30, 130)))
    assert box.dropped == {"/a": 20, "/b": 10}


def test_what_the_messages_hold_is_bounded_too():
    box = Inbox(max_bytes=1000)
    for k in range(30):
        box.put(RawMessage("/image", "", "cdr", float(k), bytes(100)), 0.0)
    assert len(box.take(0.0)) == 10
    assert box.dropped == {"/image": 20}


def test_a_covariance_is_never_certain_where_nothing_is_known(expected):
    """Once it is touched, the can's spin is open; before, the pose is vision's."""
    answers = answered(live(equal=True), said(), at_once=100)
    for stamp, (_, covariance) in poses(answers).items():
        values = np.linalg.eigvalsh(covariance.reshape(6, 6))
        assert values.min() > 0
        if stamp > START + 1.5:
            assert values.max() >= 1


def test_what_is_lost_has_no_transform_but_a_pose_and_a_reason():
    quiet = [each for each in said() if each.topic != "/vision/object" or each.log_time < START + 0.2]
    quiet = [each for each in quiet if not each.topic.endswith("wrench")]
    tracker = live(equal=True, settings=TrackerSettings(lost_after=0.5))
    answers = answered(tracker, quiet, at_once=20)
    transforms = [read(each).transforms[0] for each in answers if each.topic == "/tf"]
    stamps = [each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in transforms]
    assert {(each.header.frame_id, each.child_frame_id) for each in transforms} == {("palm", "object")}
    assert max(stamps) == pytest.approx(START + 0.6, abs=0.2)
    assert max(poses(answers)) > START + 1.5
    assert any("nothing touched and nothing seen" in sentence for sentence in sentences(tracker))


def test_a_clock_that_goes_back_begins_a_new_track_and_says_so():
    again = [each._replace(log_time=each.log_time + 2.0) for each in said(seconds=0.8)]
    tracker, played = live(equal=True), [*said(), *again]
    given = followed(tracker)
    answered(tracker, played, at_once=50)
    assert len(given) == sum(each.topic == "/joint_states" for each in played)
    assert "the clock went back by 1.6 s: a new track" in tracker.tracker.reason
    assert any("stamps went back" in sentence for sentence in sentences(tracker))


def asked(topic, kind, **fields):
    data = b"" if kind.endswith("Empty") else bytes(typestore("cdr").serialize_cdr(Message(**fields), kind))
    return RawMessage(topic, kind, "cdr", 0.0, data)


def wait_for(tracker, text):
    for _ in range(200):
        if any(text in sentence for sentence in sentences(tracker)):
            return
        tracker.step(0.01)
    raise AssertionError(f"{text!r} was never said: {sentences(tracker)}")


def test_a_users_pose_begins_a_track_without_vision():
    tracker, T = live(equal=True), np.eye(4)
    T[:3, 3] = 0.0, -0.05, 0.1
    pose = pose_with_covariance(T, None)
    tracker.put(asked("/handsight/start", RosType.POSE_COVARIANCE, header=header(0.0, "palm"), pose=pose))
    wait_for(tracker, "begun anew from the user's pose")
    without = [each for each in said(seconds=0.4) if each.topic != "/vision/object"]
    found = poses(answered(tracker, without, at_once=50))
    np.testing.assert_allclose(next(iter(found.values()))[0][:3], T[:3, 3], atol=1e-6)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (asked("/handsight/object", "std_msgs/msg/String", data="spoon"), "object: expected a name of the rig (can)"),
        (asked("/handsight/object", "std_msgs/msg/Empty"), "expected a std_msgs/msg/String, got std_msgs/msg/Empty"),
        (asked("/handsight/reset", "std_msgs/msg/Empty"), "begun anew: vision's next pose starts"),
        (asked("/handsight/object", "std_msgs/msg/String", data="can"), "the object is can"),
        (
            asked("/handsight/start", RosType.POSE_COVARIANCE, header=header(0.0, "moon"), pose=pose_with_covariance(np.eye(4), None)),
            "unknown frame 'moon'; valid: 'camera' (camera), 'world' (world), 'palm' (palm)",
        ),
        (
            asked("/handsight/start", RosType.POSE_COVARIANCE, header=header(0.0, "world"), pose=pose_with_covariance(np.eye(4), None)),
            "expected a pose in the palm, as the palm's pose in the world is not known",
        ),
    ],
)  # fmt: skip
def test_what_is_asked_for_is_done_or_refused_in_a_sentence(message, expected):
    tracker = live()
    tracker.put(message)
    wait_for(tracker, expected)


def test_of_many_requests_at_once_two_are_taken_and_the_others_refused():
    tracker, asked_for, go_on, done = live(), [], threading.Event(), Future()
    done.set_result("done")
    tracker.set_object = lambda name: asked_for.append(name) or (go_on.wait(60.0) and done)
    for _ in range(20):
        tracker.put(asked("/handsight/object", "std_msgs/msg/String", data="can"))
    wait_for(tracker, "refused")
    go_on.set()
    deadline = time.monotonic() + 60.0
    while len(asked_for) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.2)
    assert len(asked_for) == 2


def test_a_type_that_a_transport_does_not_pass_on_is_named_and_no_message_is_counted():
    tracker = live()
    tracker.published("/vision/object", "std_msgs/msg/String")
    tracker.step(0.0)
    assert any("std_msgs/msg/String" in each for each in sentences(tracker))
    assert not any("messages left out" in each for each in sentences(tracker))


def test_an_answer_is_as_late_as_it_has_waited_since_its_joint_states_came():
    order, report = PromptBuffer(Report("/joints")), TopicReport(Topic("/joints", "joints", ()))
    for k in range(200):
        order.now = 0.01 * k
        order.put(Measurement(report, 0.01 * k, 0.01 * k, {"j": 0.0}, "joints"))
    assert order.arrived(1.5) == pytest.approx(1.5)
    assert order.arrived(1.5) is None
    assert order.arrived(1.2) is None


def test_a_rig_without_intrinsics_gets_them_from_the_camera_info():
    topics = replace(rig().topics, depth="/depth", camera_info="/info")
    blind = replace(rig(), topics=topics, camera=replace(rig().camera, intrinsics=None, size=None))
    tracker = LiveTracker(blind, model(), encoding="cdr")
    matrix = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    roi = Message(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    info = {"k": matrix.ravel(), "d": np.zeros(5), "r": np.eye(3).ravel(), "p": np.zeros(12), "roi": roi}
    size = {"width": 640, "height": 480, "binning_x": 0, "binning_y": 0, "distortion_model": "plumb_bob"}
    tracker.put(asked("/info", "sensor_msgs/msg/CameraInfo", header=header(1.0), **info, **size))
    tracker.step(0.0)
    np.testing.assert_array_equal(tracker.tracker.rig.camera.intrinsics, matrix)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_markers_are_published_only_to_subscribers_and_can_be_read(encoding):
    messages = said() if encoding == "cdr" else in_ros1(said())
    tracker = live(encoding, equal=True)
    assert not any(
        each.topic == "/handsight/markers" for each in answered(tracker, messages[:1000], at_once=50)
    )
    tracker.markers_wanted = lambda: True
    answers = answered(tracker, messages[1000:], at_once=50)
    found = [read(each, encoding) for each in answers if each.topic == "/handsight/markers"]
    kinds = {(marker.ns, marker.header.frame_id) for array in found for marker in array.markers}
    assert {("object", "object"), ("contacts", "palm"), ("two sigma", "palm"), ("open", "palm")} <= kinds
