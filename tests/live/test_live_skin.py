"""A running robot whose fingertips are taxels: its drivers' messages in, poses and contacts out; what is wrong is counted."""

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.live import LiveTracker
from tests.live.recorded import answered, model, poses, read
from tests.live.skin_messages import TYPES, content, raw, skin_messages, skin_rig, tracked_skin


def live(encoding="cdr", **options):
    return LiveTracker(skin_rig(), model(), encoding=encoding, **options)


def reports(tracker):
    """What is counted of each topic of taxels."""
    return {topic: tracker._stream.report.topics[topic] for topic, _, _ in TYPES.values()}


def agree(answers, expected, encoding="cdr"):
    found = poses(answers, encoding)
    assert set(found) == set(expected)
    for stamp, T in expected.items():
        np.testing.assert_allclose(found[stamp][0][:3], T[:3, 3], atol=1e-12)


@pytest.fixture(scope="module")
def expected():
    """Stamps and poses, as `handsight track` has them, and the tracker at the end."""
    return tracked_skin(skin_rig(), skin_messages())


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_live_and_track_give_the_same_poses_and_contacts_of_taxels(expected, encoding):
    tracker = live(encoding, equal=True)
    tracker.markers_wanted = lambda: True
    answers = answered(tracker, skin_messages(encoding), at_once=7)
    agree(answers, expected[0], encoding)
    touched = tracker.tracker.fingertips
    assert len(touched.fingers) >= 3
    assert touched.fingers == expected[1].fingertips.fingers
    assert np.isfinite(touched.loads).all()
    assert all(topic.used > 50 and not topic.bad for topic in reports(tracker).values())
    shown = [read(each, encoding) for each in answers if each.topic == "/handsight/markers"]
    drawn = [marker for each in shown for marker in each.markers if marker.ns == "contacts"]
    assert max(len(marker.points) for marker in drawn) >= 3


WRONG = {
    "/tactile": "expected 30 x 3 taxels, got 87 numbers",
    "/mf/taxels": "expected 30 x 3 taxels, got 87 numbers",
    "/rf/cloud": "expected 30 x 3 taxels, got 29 x 3",
    "/xServTopic": "expected 30 x 3 taxels, got 29 x 3",
}


def test_readings_of_another_size_are_refused_and_counted_and_the_others_are_used(expected):
    tracker, messages = live(equal=True), skin_messages()
    given = []
    for each in messages:
        given.append(each)
        names = [name for name, (topic, _, _) in TYPES.items() if topic == each.topic]
        if names:
            short = content(each.type, each.log_time, dict.fromkeys(names, np.zeros((29, 3))))
            given.append(raw(each.topic, each.type, "cdr", each.log_time, short))
    agree(answered(tracker, given, at_once=7), expected[0])
    for name, topic in reports(tracker).items():
        assert topic.bad >= 50
        assert any(WRONG[name] in reason for reason in topic.reasons), topic.reasons


def test_any_bytes_on_the_taxels_topics_are_refused_or_read_and_never_end_the_tracker():
    rng, tracker, messages = np.random.default_rng(3), live(), skin_messages()
    given = []
    for each in messages:
        given.append(each)
        if any(each.topic == topic for topic, _, _ in TYPES.values()) and rng.random() < 0.3:
            data = bytearray(each.data)
            for _ in range(rng.integers(1, 8)):
                data[rng.integers(4, len(data))] = rng.integers(256)
            cut = len(data) if rng.random() < 0.5 else rng.integers(0, len(data))
            given.append(each._replace(data=bytes(data[:cut])))
    answers = answered(tracker, given, at_once=11)
    assert poses(answers)
    assert sum(topic.bad + topic.nan for topic in reports(tracker).values()) > 10
