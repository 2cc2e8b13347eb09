"""One clock, one order; what does not fit is counted."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.messages import ObservationStream
from handsight.messages.pair import PromptBuffer
from messages.ros import START, Messages, heard, raw, rig, touched

M = Messages()
WRENCH = np.arange(1.0, 7.0)


def joints(stamps, delay=0.0, names=("j0", "j1", "j2")):
    return [("/joint_states", s + delay, M.joints(s, names, np.full(len(names), s - START))) for s in stamps]


def grid(count, rate=100.0):
    return [START + i / rate for i in range(count)]


def by_log(rows):
    return sorted(rows, key=lambda row: row[1])


def test_messages_that_come_late_within_the_window_are_put_in_order():
    rng = np.random.default_rng(0)
    rows = by_log([(t, log + rng.uniform(0, 0.15), m) for t, log, m in touched(200)])
    observations, stream = heard(rows)
    stamps = [seen.stamp for seen in observations]
    assert stamps == sorted(stamps)
    assert len(stamps) == 200
    assert all(topic.late == 0 for topic in stream.report.topics.values())
    assert all(set(seen.wrenches) == {"ff", "th"} for seen in observations)


def test_messages_beyond_the_window_are_left_out_and_counted():
    late = [("/ff/wrench", START + 1.5, M.wrench(START + 1.2, WRENCH))]
    observations, stream = heard(by_log(touched(200) + late))
    assert stream.report.topics["/ff/wrench"].late == 1
    assert "/ff/wrench: 1 of 201 messages came too late to be put in order of stamp and were left out" in (
        stream.report.sentences()
    )
    assert not any(np.array_equal(seen.wrenches["ff"], WRENCH) for seen in observations)


def test_the_second_of_two_messages_of_one_stamp_is_left_out_and_counted():
    rows = touched(100)
    observations, stream = heard([row for row in rows for _ in range(2)])
    assert len(observations) == 100
    for topic in stream.report.topics.values():
        assert (topic.messages, topic.used, topic.duplicated) == (200, 100, 100)
    assert "/joint_states: 100 of 200 messages came twice with one stamp and were used once" in (
        stream.report.sentences()
    )


def test_a_wrench_older_than_a_twentieth_of_a_second_is_not_taken():
    rows = [*joints(grid(20)), ("/ff/wrench", START, M.wrench(START, WRENCH))]
    observations, stream = heard(by_log(rows))
    assert ["ff" in seen.wrenches for seen in observations] == [True] * 6 + [False] * 14
    assert "finger ff: no wrench in 14 of 20 observations" in stream.report.sentences()


def test_an_observation_has_nothing_from_after_its_stamp():
    rows = [*joints(grid(20)), ("/ff/wrench", START + 0.105, M.wrench(START + 0.105, WRENCH))]
    observations, _ = heard(by_log(rows))
    assert [i for i, seen in enumerate(observations) if seen.wrenches] == [11, 12, 13, 14, 15]


def test_a_pose_is_in_the_first_observation_after_it_and_only_there():
    rows = [*joints(grid(20)), ("/vision/object", START + 0.055, M.pose(START + 0.055, np.eye(4)))]
    observations, _ = heard(by_log(rows))
    assert [i for i, seen in enumerate(observations) if seen.vision is not None] == [6]


def test_a_pose_from_within_a_gap_of_the_joints_is_stale():
    stamps = [*grid(20), *(s + 5 for s in grid(20))]
    rows = [*joints(stamps), ("/vision/object", START + 2, M.pose(START + 2, np.eye(4)))]
    observations, stream = heard(by_log(rows))
    assert len(observations) == 40
    assert not any(seen.vision for seen in observations)
    assert stream.report.topics["/vision/object"].stale == 1
    assert stream.report.topics["/joint_states"].gaps == 1
    assert "/joint_states: 1 gaps of more than 0.1 s, the longest 4.810 s" in stream.report.sentences()


def of_another_clock(difference, count=100):
    """Joint states and wrenches whose stamps lag behind by the difference (positive) or run ahead of it [s]."""
    rows = [row for row in touched(count) if row[0] != "/ff/wrench"]
    return rows + [
        ("/ff/wrench", s, M.wrench(s - difference, [s - START, 2, 3, 4, 5, 6])) for s in grid(count)
    ]


@pytest.mark.parametrize("difference", [-300.0, -3.0, -0.15, 0.15, 2.5, 1e9])
def test_stamps_of_another_clock_are_told_and_the_rigs_offset_puts_them_right(difference):
    rows = of_another_clock(difference)
    observations, stream = heard(rows)
    report = stream.report.topics["/ff/wrench"]
    assert report.difference == pytest.approx(difference, abs=1e-6)
    assert any("topics.offsets" in s for s in stream.report.sentences())
    assert len(observations) == 100
    for seen in observations:
        if "ff" in seen.wrenches:  # stamps are trusted
            assert seen.wrenches["ff"][0] - difference <= seen.stamp - START + 1e-6

    observations, stream = heard(rows, rig(offsets={"/ff/wrench": difference}))
    assert abs(stream.report.topics["/ff/wrench"].difference) < 1e-6
    assert not any("topics.offsets" in s for s in stream.report.sentences())
    for i, seen in enumerate(observations[1:-1], start=1):
        assert seen.wrenches["ff"][0] == pytest.approx(i / 100, abs=0.0101)


@pytest.mark.parametrize("difference", [-300.0, 1e9])
def test_a_topic_of_another_clock_takes_no_other_measurement_away(difference):
    observations, _ = heard(of_another_clock(difference))
    assert all("th" in seen.wrenches for seen in observations)


def test_messages_without_a_stamp_are_timed_on_the_clock_of_the_joint_states():
    """As of a simulator, or a bag that is played: it is logged much later than it is stamped."""
    later = 1e6
    rows = [("/joint_states", s + later, M.joints(s)) for s in grid(100)]
    rows += [("/ff/wrench", s + later + 0.001, M.wrench(0.0, [s - START, 2, 3, 4, 5, 6])) for s in grid(100)]
    observations, stream = heard(rows)
    assert stream.report.topics["/ff/wrench"].unstamped == 100
    for i, seen in enumerate(observations[1:], start=1):
        assert seen.wrenches["ff"][0] == pytest.approx((i - 1) / 100, abs=1e-6)


def test_what_waits_for_joint_states_is_bounded():
    """A robot whose joint states have gone goes on to say all else."""
    rows = [("/joint_states", START, M.joints(START))]
    rows += [("/ff/wrench", s, M.wrench(s, [1, 2, 3, 4, 5, s - START])) for s in grid(60_000, rate=1000.0)]
    _, stream = heard(rows)
    topic = stream.report.topics["/ff/wrench"]
    assert topic.stale > 0
    assert topic.used < 52_000
    assert topic.used + topic.left_out == topic.messages == 60_000


@pytest.mark.parametrize("latency", [0.15, 0.9])
def test_slow_vision_keeps_its_stamps(latency):
    poses = [
        ("/vision/object", s + latency, M.pose(s, se3.compose(np.eye(3), np.array([s - START, 0, 0]))))
        for s in grid(30, 10.0)
    ]
    observations, stream = heard(by_log([*joints(grid(600)), *poses]))
    found = [(seen.stamp - START, seen.vision.T_frame_object[0, 3]) for seen in observations if seen.vision]
    assert len(found) == 30
    np.testing.assert_allclose(*np.transpose(found), atol=1e-6)
    assert stream.report.topics["/vision/object"].difference == pytest.approx(latency, abs=0.01)


def test_a_topic_without_stamps_is_timed_by_when_it_was_recorded():
    rows = [row for row in touched(100) if row[0] != "/ff/wrench"]
    rows += [("/ff/wrench", s, M.wrench(0.0, [s - START, 2, 3, 4, 5, 6])) for s in grid(100)]
    observations, stream = heard(by_log(rows))
    assert [seen.wrenches["ff"][0] for seen in observations] == pytest.approx(
        [i / 100 for i in range(100)], abs=1e-6
    )
    assert stream.report.topics["/ff/wrench"].duplicated == 0
    assert stream.report.topics["/ff/wrench"].unstamped == 100


def test_a_simulator_at_a_tenth_of_real_time_is_one_clock():
    """Log time runs ten times as fast; vision that begins late must not look like another clock."""
    rows = [("/joint_states", START + i / 10, M.joints(i / 100)) for i in range(1000)]
    rows += [("/vision/object", START + 50 + i, M.pose(5 + i / 10, np.eye(4))) for i in range(50)]
    observations, stream = heard(by_log(rows))
    assert len(observations) == 1000
    assert sum(seen.vision is not None for seen in observations) == 50
    assert stream.report.topics["/vision/object"].used == len(rows) - len(observations)


@pytest.mark.parametrize("first", ["/joint_states", "/vision/object"])
def test_a_recording_that_paused_as_it_was_played_is_one_clock(first):
    """Its stamps stood still; vision that begins after the pause must not look like another clock."""
    pause, wait = 5.0, 1e-4
    rows = joints(grid(200))
    rows += [(topic, log + 2 + pause, M.joints(2 + log)) for topic, log, _ in rows]
    later = wait if first == "/joint_states" else -wait
    for k in range(10):
        stamp = START + 2 + k / 10
        rows.append(("/vision/object", stamp + pause + later, M.pose(stamp, np.eye(4))))
    observations, stream = heard(by_log(rows))
    assert len(observations) == 400
    assert stream.report.topics["/vision/object"].used == len(rows) - len(observations)
    assert sum(seen.vision is not None for seen in observations) == 10


def test_a_recording_played_in_a_loop_begins_anew_each_time_and_says_so():
    """A transform of the end of the first round is none of the second's; a static one holds."""
    rows, static = touched(300), [("/tf_static", START, M.tf(START, ("world", "base", np.eye(4))))]
    moving = [("/tf", s, M.tf(s, ("base", "palm", np.eye(4)))) for s in grid(100)]
    played = by_log(rows + static + moving)
    observations, stream = heard([(topic, log + 3.0 * k, m) for k in range(3) for topic, log, m in played])
    report = stream.report
    assert len(observations) == 900
    for once in (observations[k : k + 300] for k in (0, 300, 600)):
        assert [seen.stamp for seen in once] == pytest.approx(grid(300), abs=1e-6)
        assert all(set(seen.wrenches) == {"ff", "th"} for seen in once[1:])
        placed = [seen.T_world_palm is not None for seen in once]
        assert all(placed[2:109])
        assert not any(placed[111:])
    assert report.topics["/joint_states"].late == report.topics["/joint_states"].duplicated == 0
    assert report.backwards[0] == 2
    (said,) = (s for s in report.sentences() if "went back" in s)
    assert said.startswith(
        "/joint_states: stamps went back 2 times, by up to 2.990 s, first from 1700000002.990 s ("
    )


def test_one_stamp_far_back_is_left_out_and_begins_nothing():
    rows = joints(grid(100))
    rows[50] = ("/joint_states", rows[50][1], M.joints(START - 100))
    observations, stream = heard(rows)
    assert len(observations) == 99
    assert stream.report.topics["/joint_states"].bad == 1
    assert stream.report.backwards is None


def test_two_stamps_far_back_begin_anew_and_the_next_two_go_on():
    rows = joints(grid(100))
    for k in (50, 51):
        rows[k] = ("/joint_states", rows[k][1], M.joints(START - 100 + 0.01 * k))
    observations, stream = heard(rows)
    assert len(observations) == 100
    assert stream.report.topics["/joint_states"].bad == 0
    assert stream.report.backwards[0] == 1


def test_a_camera_that_is_more_than_a_second_late_takes_no_wrenches_from_a_live_robot():
    rows = joints(grid(300))
    rows += [("/ff/wrench", s, M.wrench(s, np.full(6, s - START))) for s in grid(75, rate=25.0)]
    pixels = np.zeros((2, 2, 3), np.uint8)
    rows += [("/color", s + 1.5, M.image(s, pixels, "rgb8")) for s in grid(30, rate=20.0)]
    stream, observations = ObservationStream(rig(), order=PromptBuffer), []
    for topic, log, message in by_log(rows):
        stream.order.now = log
        observations += stream.put(raw(topic, log, message))
    assert len(observations) > 280
    assert all("ff" in seen.wrenches for seen in observations[1:])
    assert stream.report.topics["/color"].stale == 30


def test_one_stamp_far_ahead_does_not_silence_what_follows():
    rows = joints(grid(100))
    rows[50] = ("/joint_states", rows[50][1], M.joints(START + 1e6))
    observations, stream = heard(rows)
    assert len(observations) == 99
    assert stream.report.topics["/joint_states"].bad == 1
    assert "/joint_states: 1 of 100 messages left out: stamp far from those before and after" in (
        stream.report.sentences()
    )


def test_joint_states_of_two_publishers_are_joined():
    hand, arm = joints(grid(50)), joints([s + 0.005 for s in grid(50)], names=("arm0", "arm1"))
    observations, stream = heard(by_log(hand + arm))
    assert len(observations) == 100
    assert all(set(seen.joint_positions) == {"j0", "j1", "j2", "arm0", "arm1"} for seen in observations[1:])
    assert stream.report.topics["/joint_states"].duplicated == 0


@pytest.mark.parametrize("world_first", [True, False])
def test_the_palm_in_the_world_is_found_along_any_links(world_first):
    rng = np.random.default_rng(0)
    T_world_base, T_base_arm, T_arm_palm = se3.random(rng, 3)
    down = (
        [("world", "base", T_world_base)] if world_first else [("base", "world", se3.inverse(T_world_base))]
    )
    rows = [("/tf_static", START, M.tf(START, *down, ("arm", "/palm", T_arm_palm)))]
    rows += [
        ("/tf", s, M.tf(s, ("base", "arm", T_base_arm), ("base", "camera", np.eye(4)))) for s in grid(10)
    ]
    observations, stream = heard(by_log([*joints(grid(40)), *rows]))
    placed = [seen.T_world_palm is not None for seen in observations]
    assert placed[:19] == [True] * 19
    assert placed[21:] == [False] * 19
    np.testing.assert_allclose(
        observations[3].T_world_palm, T_world_base @ T_base_arm @ T_arm_palm, atol=1e-12
    )
    assert stream.report.topics["/tf"].messages == 20


def test_a_rig_that_takes_the_world_from_elsewhere_does_not_listen_to_tf():
    rows = [("/tf", s, M.tf(s, ("world", "palm", np.eye(4)))) for s in grid(20)]
    rows += joints(grid(20))
    observations, _ = heard(rows, replace(rig(), world_from="joints"))
    assert all(seen.T_world_palm is None for seen in observations)
    observations, _ = heard(rows)
    assert all(seen.T_world_palm is not None for seen in observations)
