"""A tracker's messages over DDS, as ROS 2 publishes and subscribes to them: bytes in, bytes out."""

import time
from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, DDSStatus, WaitSet
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from handsight.bridge.message_types import message_type, ros_name
from handsight.bridge.network import Network
from handsight.live import LiveTracker
from handsight.live.answers import MARKERS_TOPIC, Answer
from handsight.live.node import NODE, PublishedTypes
from handsight.messages import RawMessage
from handsight.messages.decode import typestore
from handsight.messages.prompt import WAIT
from handsight.tracking import Tracker


class BridgeOptions(NamedTuple):
    """`BridgeOptions` say how many messages wait, and for how long."""

    max_taken: int = 100  # messages taken at once
    quiet: float = 0.1  # after so long without a message nothing waits for another one [s]
    max_blocked: int = 10_000_000  # the longest that a reader that does not keep up holds up an answer [ns]
    max_waiting: int = 100  # messages of a topic that wait to be taken
    max_waiting_all: int = 2000  # the same where every message is answered


BRIDGE = BridgeOptions()

LASTING = Qos(
    Policy.Reliability.Reliable(BRIDGE.max_blocked),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(100),
)
"""Of what is said once, for whoever comes later."""


def carried(topic: str) -> str:
    """Returns what DDS calls a topic of ROS 2."""
    return f"rt/{topic.lstrip('/')}"


class Bridge:
    """A `Bridge` receives what a tracker listens to, and publishes what it answers."""

    def __init__(self, live: LiveTracker, network: Network, say: Callable[[str], None]) -> None:
        """`say`: is told what cannot be published, once for each topic. Raises InvalidInput."""
        self._live, self._network, self._say = live, network, say
        self._types, self._mute = PublishedTypes(live), set[str]()
        self._heard = time.monotonic()
        answers = Qos(
            Policy.Reliability.Reliable(BRIDGE.max_blocked),
            Policy.History.KeepLast(NODE.max_answers_all if live.equal else NODE.max_answers),
        )
        self._writers: dict[str, Any] = {
            topic: DataWriter(network.participant, self._topic(topic, kind), qos=answers)
            for topic, kind in live.publications.items()
        }
        live.markers_wanted = lambda: bool(self._writers[MARKERS_TOPIC].get_matched_subscriptions())
        known = typestore("cdr").fielddefs
        self._readers = [
            (topic, kind, self._reader(topic, kind))
            for topic, kinds in live.subscriptions.items()
            for kind in kinds
            if kind in known  # others are ROS 1's
        ]
        self._filled = WaitSet(network.participant)
        for _, _, reader in self._readers:
            reader.set_status_mask(DDSStatus.DataAvailable)
            self._filled.attach(reader)
        self._published = BuiltinDataReader(network.participant, BuiltinTopicDcpsPublication)

    @property
    def tracker(self) -> Tracker:
        """Of the object that is followed now."""
        return self._live.tracker

    def step(self, timeout: float) -> list[Answer]:
        """Returns what is to be published now; waits at most `timeout` [s] for something to come. From one thread.

        The thread that hears is the one that works: two would wait for each other's hold on Python. One of DDS' that
        called into Python would wait for it with a lock of DDS held.
        """
        now = time.monotonic()
        self._filled.wait(round(1e9 * (min(timeout, WAIT) if now - self._heard < BRIDGE.quiet else timeout)))
        if self._take():
            self._heard = now
        return self._live.step(0.0)

    def _take(self) -> bool:
        """Hands over what has come, in the order that it was sent in: after a pause topics are far apart."""
        taken = list[tuple[int, RawMessage]]()
        now = time.time()
        for topic, kind, reader in self._readers:
            dds_type, samples = message_type(kind), [None] * BRIDGE.max_taken
            while len(samples) == BRIDGE.max_taken:
                samples = reader.take(BRIDGE.max_taken)
                taken += [
                    (sample.sample_info.source_timestamp, RawMessage(topic, kind, "cdr", now, sample.data))
                    for sample in samples
                    if isinstance(sample, dds_type)  # else it says that a publisher is gone
                ]
        for _, message in sorted(taken, key=itemgetter(0)):
            self._live.put(message)
        return bool(taken)

    def publish(self, answer: Answer) -> None:
        """Writes an answer; where that cannot be done, it is said once."""
        writer = self._writers[answer.topic]
        try:
            writer.write(message_type(answer.type)(answer.data))
        except DDSException as error:
            if answer.topic not in self._mute:
                self._mute.add(answer.topic)
                self._say(f"{answer.topic}: an answer could not be published: {error}")

    def check_network(self) -> None:
        """Looks who publishes; to be called about once a second, so that wrong types are named."""
        for each in self._published.take(BRIDGE.max_taken):
            name = getattr(each, "topic_name", "") or ""
            if name.startswith("rt/"):
                self._types.on_topic(name[2:], ros_name(each.type_name))

    def _topic(self, topic: str, kind: str) -> Topic:
        return Topic(self._network.participant, carried(topic), message_type(kind))

    def _reader(self, topic: str, kind: str) -> Any:
        """Returns a reader of a topic. Best effort is what every publisher can give."""
        waiting = BRIDGE.max_waiting_all if self._live.equal else BRIDGE.max_waiting
        passing = Qos(
            Policy.Reliability.BestEffort,
            Policy.History.KeepLast(waiting),
            Policy.IgnoreLocal.Participant,  # its own /tf
        )
        return DataReader(
            self._network.participant,
            self._topic(topic, kind),
            qos=LASTING if topic.endswith("/tf_static") else passing,
        )
