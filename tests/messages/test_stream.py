"""Messages put in one at a time give what a recording of them gives."""

import numpy as np
import pytest

from handsight.errors import HandsightError
from handsight.messages import ObservationStream, RawMessage
from handsight.observation import Observation
from messages.ros import START, Messages, everything, heard, raw, rig, touched
from recording.bags import read, save

M = Messages()


def test_live_messages_give_the_same_observations_as_their_recording(tmp_path):
    rows = [*everything(M), ("/truth", START + 0.02, M.pose(START + 0.02, np.eye(4), "palm"))]
    live, stream = heard(rows)
    recorded, recording = read(save(tmp_path, rows))
    assert len(live) == len(recorded) == 10
    for a, b in zip(live, recorded, strict=True):
        for field in ("stamp", "joint_positions", "T_world_palm", "color", "depth"):
            np.testing.assert_equal(getattr(a, field), getattr(b, field))
        np.testing.assert_equal(dict(a.wrenches), dict(b.wrenches))
        assert (a.vision is None) == (b.vision is None)
    np.testing.assert_equal(stream.truth, recording.truth)
    assert stream.report.topics == recording.report.topics
    assert (stream.report.sentences(), stream.lacks()) == (recording.report.sentences(), recording.lacks())


def test_a_stream_needs_not_know_the_topics_beforehand():
    rows = touched(50)
    stream = ObservationStream(rig())
    observations = [done for row in rows for done in stream.put(raw(*row))] + stream.finish()
    assert [seen.stamp for seen in observations] == [seen.stamp for seen in heard(rows)[0]]
    assert {topic.type for topic in stream.report.topics.values()} == {
        "sensor_msgs/msg/JointState",
        "geometry_msgs/msg/WrenchStamped",
    }


def test_observations_come_as_soon_as_they_are_in_order():
    """A second to compare clocks; then each 0.2 s behind the newest joint states, at the next ones."""
    stream, newest, delays = ObservationStream(rig()), 0.0, []
    for topic, log, message in touched(300):
        newest = log if topic == "/joint_states" else newest
        found = stream.put(raw(topic, log, message))
        assert all(isinstance(each, Observation) for each in found)
        if newest < START + 1:
            assert found == []
        elif newest > START + 1.1:
            delays += [newest - each.stamp for each in found]
    assert max(delays) == pytest.approx(0.21, abs=0.011)


@pytest.mark.parametrize("encoding", ["cdr", "ros1", "json", ""])
def test_bytes_that_are_no_message_are_counted_and_never_raise(encoding):
    rng, stream = np.random.default_rng(0), ObservationStream(rig())
    kinds = {topic: message.__msgtype__ for topic, _, message in everything(M)}
    for i in range(300):
        for topic, kind in kinds.items():
            try:
                stream.put(RawMessage(topic, kind, encoding, START + i / 100, rng.bytes(rng.integers(200))))
            except HandsightError as error:  # pragma: no cover
                pytest.fail(str(error))
    stream.finish()
    for topic in stream.report.topics.values():
        counts = topic.used, topic.duplicated, topic.nan, topic.late, topic.bad, topic.stale, topic.stuck
        assert sum(counts) == topic.messages
