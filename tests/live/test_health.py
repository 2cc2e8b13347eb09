"""Silence is not health: what a robot no longer says is noticed by a clock, and what is over is no fault any more."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.live import live_tracker
from handsight.live.health import (
    ERROR,
    FAULT_WINDOW,
    MAX_MISSED,
    MIN_SILENCE,
    OK,
    PERIOD,
    STALE,
    WARN,
    Arrivals,
)
from handsight.messages import RosType
from handsight.messages.read import typestore
from handsight.tracking import TrackerSettings
from tests.live.recorded import START, live, read, said

SECONDS = 6.0
"""Of the recording; what is said of a second needs several of them."""


@pytest.mark.parametrize("hertz", [0.5, 5.0, 30.0, 500.0])
def test_an_input_is_silent_after_it_has_missed_several_of_its_own_messages_and_not_before(hertz):
    arrivals, n = Arrivals(), round(20 * hertz) + 10
    for k in range(n):
        now = 100.3 + k / hertz
        arrivals.came(now)
        assert k == 0 or not arrivals.silence(now + 0.9 * max(MIN_SILENCE, 1 / hertz))
    limit = max(MIN_SILENCE, MAX_MISSED / hertz)
    assert arrivals.rate == pytest.approx(hertz)
    assert arrivals.silence(now + 1.1 * limit) == pytest.approx(1.1 * limit)
    assert not arrivals.silence(now + 0.9 * limit)


class Lab:
    """A live tracker that hears a recording at the pace of a clock that the test moves."""

    def __init__(self, monkeypatch, **settings):
        self.now = 5000.0
        clock = SimpleNamespace(monotonic=lambda: self.now)
        monkeypatch.setattr(live_tracker, "time", clock)
        # A short grasp of a can that stands knows its height within 7 mm.
        self.tracker = live(settings=TrackerSettings(uncertain_position=0.015, **settings))
        self.published = []

    def play(self, messages):
        begun, first = self.now, messages[0].log_time
        for each in messages:
            self.now = begun + each.log_time - first
            self.tracker.put(each)
            self.step()

    def wait(self, seconds):
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            self.step()

    def step(self):
        for each in self.tracker.step(0.0):
            if each.topic == "/diagnostics":
                self.published.append((self.now, *read(each).status))

    def last(self):
        """The last statuses of pose and input, each with its level, message and values."""
        return [
            (each.level, each.message, {value.key: value.value for value in each.values})
            for each in self.published[-1][1:]
        ]


def test_with_the_only_publisher_gone_pose_and_input_are_stale_within_a_second_and_then_lost(monkeypatch):
    lab = Lab(monkeypatch, lost_after=3.0)
    lab.play(said(seconds=SECONDS))
    (level, message, _), (heard, sentence, _) = lab.last()
    assert (level, message, heard, sentence) == (OK, "tracking", OK, "all is heard")
    ended = lab.now
    lab.wait(13.0)
    first = next(now for now, pose, heard in lab.published if (pose.level, heard.level) == (STALE, STALE))
    assert first - ended < 0.6
    (level, message, values), (heard, sentence, rates) = lab.last()
    assert (level, values["state"], heard) == (ERROR, "lost", STALE)
    assert message.startswith("no observation for 1")
    assert "silent for" in sentence
    assert rates["/joint_states [Hz]"] == "0"
    lost = next(now for now, pose, _ in lab.published if pose.level == ERROR and now > ended)
    assert lost - ended == pytest.approx(3.0, abs=0.2)
    assert lab.tracker.trust[0] == "lost"
    stamps = [now for now, *_ in lab.published if now > ended]
    assert max(np.diff(stamps)) <= PERIOD + 0.1  # diagnostics go on


def spoilt_joints(message):
    joints = typestore("cdr").deserialize_cdr(message.data, message.type)
    joints.position = np.full_like(joints.position, np.nan)
    return message._replace(data=bytes(typestore("cdr").serialize_cdr(joints, message.type)))


def test_joints_that_are_all_nan_are_silence(monkeypatch):
    lab = Lab(monkeypatch)
    messages, end = said(seconds=SECONDS), START + SECONDS - 1.0
    nan = [spoilt_joints(m) if m.type == RosType.JOINTS and m.log_time >= end else m for m in messages]
    lab.play(nan)
    lab.wait(0.5)
    (level, message, _), (heard, sentence, values) = lab.last()
    assert (level, heard) == (STALE, STALE)
    assert message.startswith("no observation for 1.")
    assert sentence.startswith("/joint_states: silent for")
    assert int(values["/joint_states, left out"]) == pytest.approx(100, abs=2)


def test_one_silent_input_is_named_and_a_detector_that_says_nothing_is_only_a_warning(monkeypatch):
    for topic, expected, pose in (("/th/wrench", STALE, OK), ("/vision/object", WARN, OK)):
        lab = Lab(monkeypatch)
        lab.play([m for m in said(seconds=SECONDS) if m.topic != topic or m.log_time < START + 4.0])
        (level, *_), (heard, sentence, _) = lab.last()
        assert (level, heard) == (pose, expected)
        assert sentence.startswith(f"{topic}: silent for")


def test_warnings_clear_ten_seconds_after_their_cause_and_totals_stay(monkeypatch):
    lab, messages = Lab(monkeypatch), said(seconds=16.0)
    spoilt = [
        m._replace(data=m.data[:40])
        if m.topic == "/th/wrench" and START + 3.0 < m.log_time < START + 3.1
        else m
        for m in messages
    ]
    lab.play(spoilt)
    warned = [
        now
        for now, _, heard in lab.published
        if any("/th/wrench" in value.value and "left out: expected" in value.value for value in heard.values)
    ]
    begun = lab.published[0][0]
    assert FAULT_WINDOW - 1.5 <= warned[-1] - warned[0] <= FAULT_WINDOW + 1.5
    (_, _, _), (heard, sentence, values) = lab.last()
    assert (heard, sentence) == (OK, "all is heard")
    assert int(values["/th/wrench, left out"]) >= 9
    assert begun < warned[0]
