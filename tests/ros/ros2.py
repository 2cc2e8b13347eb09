"""A robot of ROS 2 over DDS on this machine alone, and the processes that follow what it holds."""

import os
import sys
import sysconfig
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from handsight.bridge.bridge import Network, carried, message_type
from handsight.live import Answer
from handsight.messages import OwnTopic, RosType
from handsight.messages.read import typestore
from tests.live.recorded import poses
from tests.ros.ros1 import Graph

ROOT = Path(__file__).parents[2]
NODE = ROOT / "ros" / "handsight_ros2" / "handsight_ros2" / "node.py"
ANSWERED = {
    OwnTopic.POSE: RosType.POSE_COVARIANCE,
    OwnTopic.TF: RosType.TF,
    OwnTopic.MARKERS: RosType.MARKERS,
    OwnTopic.DIAGNOSTICS: RosType.DIAGNOSTICS,
}
DOMAIN = 1 + os.getpid() % 100
"""Of each worker its own."""
ALONE = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}
KNOWN_AFTER = 1.0
"""Two find each other one after the other, and only one side's finding can be seen here: the other has by then [s]."""
BOTH_WAYS = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(2000))


class Processes(Graph):
    """Processes of ROS 2, which know no master."""

    def __init__(self, folder):
        self.folder, self.processes = folder, []
        self.environment = {
            k: v for k, v in os.environ.items() if not k.startswith(("ROS", "CYCLONE"))
        } | ALONE

    def bridge(self, rig, *options):
        """The bridge, ready."""
        process = self.run(sys.executable, "-m", "handsight.cli", "ros2-bridge", str(rig), *options)
        return self.ready(process, "the bridge")

    def node(self, rig, **parameters):
        """The node of rclpy, ready."""
        given = [
            text for key, value in {"rig": rig, **parameters}.items() for text in ("-p", f"{key}:={value}")
        ]
        return self.ready(self.rclpy("jazzy", NODE, "--ros-args", *given), "the node")

    def ready(self, process, what):
        self.wait_for(lambda: "is ready" in process.log.read_text(), what, process)
        return process

    def rclpy(self, release, script, *arguments):
        """A script run by a release's own Python, which finds handsight where this one does; skips where it is not there."""
        python = ROOT / f".ros2-{release}" / "bin" / "python"
        if not python.is_file():
            pytest.skip(f"there is no ROS 2 {release} here: .ci/lab-ros2 {release} makes it")
        found = f"PYTHONPATH={ROOT / 'src'}{os.pathsep}{sysconfig.get_path('purelib')}"
        return self.run("env", found, str(python), str(script), *map(str, arguments))


@contextmanager
def processes(folder):
    running = Processes(folder)
    try:
        yield running
    finally:
        running.close()


class Robot:
    """Says what was recorded, at its own pace, and hears what is answered."""

    def __init__(self, network, messages, *, as_type=None):
        """`as_type`: by topic, the type that its messages are said to be of."""
        self._network, self._heard = network, []
        kinds = {each.topic: each.type for each in messages} | (as_type or {})
        self._writers = {topic: self._writer(topic, kind) for topic, kind in kinds.items()}
        self._readers = [self._reader(topic, kind) for topic, kind in ANSWERED.items()]
        self._messages = messages

    def _topic(self, topic, kind):
        return Topic(self._network.participant, carried(topic), message_type(kind))

    def _writer(self, topic, kind):
        return DataWriter(self._network.participant, self._topic(topic, kind), qos=BOTH_WAYS)

    def _reader(self, topic, kind):
        return DataReader(self._network.participant, self._topic(topic, kind), qos=BOTH_WAYS)

    @property
    def heard(self):
        """All that was answered so far."""
        for reader, (topic, kind) in zip(self._readers, ANSWERED.items(), strict=False):
            taken = [each for each in reader.take(2000) if isinstance(each, message_type(kind))]
            self._heard += [Answer(topic, kind, each.data) for each in taken]
        return self._heard

    def listened_to(self, topic):
        return bool(self._writers[topic].get_matched_subscriptions())

    def play(self):
        begun, first = time.monotonic(), self._messages[0].log_time
        for each in self._messages:
            time.sleep(max(0.0, each.log_time - first - (time.monotonic() - begun)))
            writer = self._writers[each.topic]
            if writer.data_type is message_type(each.type):
                writer.write(message_type(each.type)(each.data))
            else:
                self._say_something_else(writer)

    @staticmethod
    def _say_something_else(writer):
        writer.write(message_type("std_msgs/msg/String")(b"\0\1\0\0\2\0\0\0a\0\0\0"))

    def ask(self, topic, kind, message, wait_for):
        """Says one thing once somebody listens."""
        self._writers[topic] = writer = self._writer(topic, kind)
        wait_for(lambda: self.listened_to(topic), "one who listens")
        time.sleep(KNOWN_AFTER)
        writer.write(message_type(kind)(bytes(typestore("cdr").serialize_cdr(message, kind))))

    def told(self):
        """All that the diagnostics said."""
        read = typestore("cdr").deserialize_cdr
        statuses = [
            s
            for each in self.heard
            if each.type == RosType.DIAGNOSTICS
            for s in read(each.data, each.type).status
        ]
        return {s.message for s in statuses} | {value.value for s in statuses for value in s.values}

    def close(self):
        """It is gone."""
        self._writers, self._readers = {}, []


def same(answers, expected):
    """Positions are those of `handsight track`, to 1e-9 m, at the same stamps."""
    found = poses(answers)
    assert expected
    assert set(found) == set(expected)
    np.testing.assert_allclose(
        [found[stamp][0][:3] for stamp in expected], [T[:3, 3] for T in expected.values()], rtol=0, atol=1e-9
    )


def network():
    return Network(ALONE)
