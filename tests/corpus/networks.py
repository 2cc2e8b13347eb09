"""The bridge on DDS' network: a participant that sends corrupted messages, of other types, and datagrams that are none."""

import contextlib
import os
import random
import socket
import struct
import time
from functools import cache
from importlib.util import find_spec
from typing import Any

from handsight.errors import InvalidInput
from handsight.live import LiveTracker
from handsight.live.node import PublishedTypes
from handsight.messages import RawMessage
from handsight.messages.decode import typestore
from tests.corpus.door import Case, Door, check_sentence, spoilt_bytes
from tests.corpus.observations import check_answer
from tests.live.recorded import live, read, said

DOMAIN = 201 + os.getpid() % 30  # none of those that the tests of bridge and nodes join


class Robot:
    """A `Robot` is a participant on this machine that sends messages to a bridge, which is another one."""

    def __init__(self) -> None:
        from cyclonedds.domain import DomainParticipant

        from handsight.bridge import Bridge, Network

        alone = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self.bridge = Bridge(live(), Network(alone), print)
        self.participant = DomainParticipant(DOMAIN)
        self.writers = dict[tuple[str, str], Any]()

    def send(self, topic: str, kind: str, data: bytes) -> None:
        """Sends a message, once the bridge listens to its topic; DDS refuses bytes without a header of its own."""
        from cyclonedds.core import DDSException
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        from handsight.bridge.bridge import carried, message_type

        if (topic, kind) not in self.writers:
            writer = DataWriter(self.participant, Topic(self.participant, carried(topic), message_type(kind)))
            self.writers[topic, kind] = writer
            until = time.monotonic() + 5.0
            while not writer.get_matched_subscriptions() and time.monotonic() < until:
                time.sleep(0.005)
        with contextlib.suppress(DDSException):
            self.writers[topic, kind].write(message_type(kind)(data))

    def hear(self, messages: list[RawMessage]) -> LiveTracker:
        """Sends messages to a new tracker behind the bridge, and returns it when it has answered all of them."""
        self.bridge._live = tracker = live()
        for k, each in enumerate(messages):
            self.send(each.topic, each.type, each.data)
            if k % 10 == 9 or k == len(messages) - 1:
                time.sleep(0.002)
                for answer in self.bridge.step(0.02):
                    read(answer)
        check_answer(tracker.tracker)
        return tracker


robot = cache(Robot)


def refusals(messages: list[RawMessage]) -> None:
    """Sends messages over the network; raises the first complaint of them."""
    sentences = robot().hear(messages)._stream.report.sentences()
    for each in sentences:
        check_sentence(each)
    bad = [each for each in sentences if "messages" in each or "expected" in each]
    if bad:
        raise InvalidInput(bad[0])


def spoilt(message: RawMessage, rng: random.Random) -> RawMessage:
    """Returns a message whose bytes are corrupted, in the other order, cut, repeated, or none at all."""
    data = rng.choice(
        [
            spoilt_bytes(message.data, rng),
            b"\0\0" + message.data[2:],  # big-endian, it says
            message.data[: rng.randrange(len(message.data))],
            message.data[:4] + b"\xff" * (len(message.data) - 4),
            message.data + message.data,
            message.data[:4],
        ]
    )
    return message._replace(data=data)


def sent_spoilt(rng: random.Random) -> None:
    """Sends some messages of a recording, most as they should be, and some corrupted."""
    messages = list(said(seconds=0.12))
    for _ in range(rng.choice([0, 1, 5])):
        k = rng.randrange(len(messages))
        messages[k] = spoilt(messages[k], rng)
    refusals(messages)


def big_endian() -> None:
    """Messages of a participant that writes big-endian numbers are used as those of others are."""
    store, messages = typestore("cdr"), []
    for each in said(seconds=0.12):
        fields = store.deserialize_cdr(each.data, each.type)
        data = bytes(store.serialize_cdr(fields, each.type, little_endian=False))
        assert data[:2] == b"\0\0"
        messages.append(each._replace(data=data))
    heard = robot().hear(messages)
    assert sum(topic.messages for topic in heard._stream.report.topics.values()) > 0.8 * len(messages)
    assert heard.tracker.stamp == robot().hear(list(said(seconds=0.12))).tracker.stamp is not None


def datagrams() -> None:
    """Sends datagrams to the bridge's ports: noise, heads of RTPS without a body, and messages with wrong lengths."""
    rng, _ = random.Random(0), robot()
    ports = [7400 + 250 * DOMAIN + at for at in range(10, 18)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as to:
        for _ in range(100):
            head = b"RTPS\x02\x01" + rng.randbytes(14)
            kind, size = (
                rng.choice([0x06, 0x07, 0x09, 0x0E, 0x12, 0x13, 0x15, 0x16]),
                rng.choice([0, 4, 20, 65535]),
            )
            part = struct.pack("<BBH", kind, rng.randrange(256), size) + rng.randbytes(
                rng.choice([0, 20, 400])
            )
            data = rng.choice([rng.randbytes(rng.randrange(600)), head, head + part, head + 30 * part])
            to.sendto(data, ("127.0.0.1", rng.choice(ports)))
    refusals(list(said(seconds=0.12)))


def another_type(kind: str) -> None:
    """Tells the bridge that a topic is published with another type."""
    bridge = robot().bridge
    bridge._live = tracker = live()
    PublishedTypes(tracker).on_topic("/joint_states", kind)
    bridge.step(0.0)
    raise InvalidInput(tracker._stream.report.sentences()[0])


HERE = find_spec("cyclonedds") is not None
DOORS = [Door("messages over DDS", sent_spoilt, 30)] if HERE else []
CASES = [
    Case("messages over DDS as they should be", lambda: refusals(list(said(seconds=0.12))), None),
    Case("messages over DDS in big-endian order", big_endian, None),
    Case("datagrams that are none of DDS", datagrams, None),
    Case("a DDS topic of another type", lambda: another_type("std_msgs/msg/String"), "expected sensor_msgs/msg/JointState, got"),
    Case("a DDS type whose name a terminal obeys", lambda: another_type(500 * "x\x1b[2J"), "got x\\x1b[2Jx"),
] * HERE  # fmt: skip
