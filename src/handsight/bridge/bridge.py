"""Transport of a live tracker's messages over DDS, compatible with the nodes of ROS 2.

The DDS types of the messages describe every field to other participants, but carry serialised bytes.
"""

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from operator import itemgetter
from types import new_class
from typing import TYPE_CHECKING, Any, Self

from cyclonedds import idl
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, DDSStatus, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from handsight import checks
from handsight.errors import InvalidInput
from handsight.live import LiveTracker
from handsight.live.answers import Answer
from handsight.live.node import queue_lengths, time_to_wait
from handsight.messages import RawMessage
from handsight.messages.read import defined, rosbags_module, typestore
from handsight.messages.topics import MessageRejected, OwnTopic

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

LARGEST_DOMAIN = 232
MAX_TAKEN = 100  # number of messages that are taken from DDS in one call
FAST_DDS_3 = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
"""Turns type comparison off with Fast DDS 3 (ROS 2 Kilted), whose descriptions of equal types may differ."""
LOOPBACK = (
    '<General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
)
"""Restricts communication to this machine, as ROS 2 does for LOCALHOST."""


class Sample:
    """A serialised message that a reader takes or a writer writes; it is not decoded."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, *_: object, **__: object) -> bytes:
        """Returns the bytes."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, /, *_: object, **__: object) -> Self:
        """Returns the message of these bytes."""
        return cls(data)

    deserialize_key = deserialize


def dds_name(kind: str) -> str:
    """Returns the DDS name of the ROS 2 type `package/msg/Name`."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(dds: str) -> str:
    """Returns `package/msg/Name` for the DDS name of a ROS 2 type; any other name is returned unchanged."""
    named = re.fullmatch(r"(\w+)::(\w+)::dds_::(\w+)_", dds)
    return dds if named is None else "/".join(named.groups())


@cache
def message_type(kind: str, definition: str = "") -> Any:
    """Returns the DDS class for messages of the ROS 2 type `package/msg/Name`.

    Its fields only describe the type to other participants, which may compare it with their own before they connect.
    `definition`: of a type that is none of ROS'. Raises InvalidInput, MissingExtra.
    """
    try:
        store = defined("cdr", kind, definition) if definition else typestore("cdr")
    except MessageRejected as error:
        raise InvalidInput(str(error)) from None
    if kind not in store.fielddefs:
        raise InvalidInput(f"expected a message of ROS 2 that is known here, got {kind}")
    return _type(kind, store)


@cache
def _type(kind: str, store: "Typestore") -> Any:
    """Returns the DDS class of a type that the store has."""
    fields = {name: _field(node, store) for name, node in store.fielddefs[kind][1]}

    def fill(namespace: dict[str, Any]) -> None:
        namespace.setdefault("__annotations__", {}).update(fields)
        methods = ("__init__", "serialize", "deserialize", "deserialize_key")
        namespace.update({name: vars(Sample)[name] for name in methods})

    # A plain `type(...)` call would lose the `typename` for the metaclass.
    name = kind.rsplit("/", 1)[1]
    return new_class(name, (idl.IdlStruct,), {"typename": dds_name(kind).replace("::", ".")}, fill)


def _field(node: Any, store: "Typestore") -> Any:
    """Returns the DDS type of a field, from the description in rosbags."""
    nodes = rosbags_module("rosbags.interfaces").Nodetype
    kind, what = node
    if kind == nodes.NAME:
        return _type(what, store)
    if kind == nodes.BASE:
        own = {"bool": bool, "string": str, "octet": types.byte, "byte": types.byte, "char": types.uint8}
        return own.get(what[0]) or getattr(types, what[0])
    element, count = what
    if kind == nodes.ARRAY:
        return types.array[_field(element, store), count]
    return types.sequence[_field(element, store), count] if count else types.sequence[_field(element, store)]


def domain_id(environment: Mapping[str, str]) -> int:
    """Returns ROS_DOMAIN_ID, or 0 if it is not set; raises InvalidInput."""
    declared = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    if declared not in map(str, range(LARGEST_DOMAIN + 1)):
        came = checks.brief(repr(declared))
        raise InvalidInput(f"ROS_DOMAIN_ID: expected a number from 0 to {LARGEST_DOMAIN}, got {came}")
    return int(declared)


def configuration(environment: Mapping[str, str]) -> str:
    """Returns Cyclone DDS' configuration: that for Fast DDS 3, for LOCALHOST if ROS 2 is set so, and the user's own."""
    alone = (
        environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or environment.get("ROS_LOCALHOST_ONLY") == "1"
    )
    # Later parts override earlier ones.
    parts = FAST_DDS_3, LOOPBACK if alone else "", environment.get("CYCLONEDDS_URI", "").strip(", ")
    return ",".join(part for part in parts if part)


class Network:
    """A participant in a DDS domain; a process can have one for each domain."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """Joins the domain; raises InvalidInput where its number or the configuration does not allow that."""
        number = domain_id(environment)
        config = configuration(environment)
        try:
            self._domain: Any = Domain(number, config)
            self.participant: Any = DomainParticipant(number)
        except (DDSException, UnicodeEncodeError) as error:
            of = "CYCLONEDDS_URI and the network"
            raise InvalidInput(f"domain {number}: expected {of} to let it be joined, got: {error}") from None


def carried(topic: str) -> str:
    """Returns the DDS name of a ROS 2 topic."""
    return f"rt/{topic.lstrip('/')}"


class Bridge:
    """Messages of DDS for a live tracker, and its answers."""

    def __init__(self, live: LiveTracker, network: Network, say: Callable[[str], None]) -> None:
        """`say`: called with a sentence when something cannot be published, once per topic. Raises InvalidInput."""
        self._live = live
        self._network = network
        self._say = say
        self._definitions = live.definitions
        self._mute = set[str]()
        self._received = time.monotonic()
        max_blocking = 10_000_000  # how long a slow subscriber may block an answer [ns]
        reliable = Policy.Reliability.Reliable(max_blocking)
        max_messages, max_answers = queue_lengths(live)
        self._most_takes = max(max_messages // MAX_TAKEN, 1)
        answers = Qos(reliable, Policy.History.KeepLast(max_answers))
        self._writers: dict[str, Any] = {
            topic: DataWriter(network.participant, self._topic(topic, kind), qos=answers)
            for topic, kind in live.publications.items()
        }
        live.markers_wanted = lambda: bool(self._writers[OwnTopic.MARKERS].get_matched_subscriptions())
        passing = Qos(
            Policy.Reliability.BestEffort,  # compatible with every publisher
            Policy.History.KeepLast(max_messages),
            Policy.IgnoreLocal.Participant,  # to not receive its own /tf
        )
        lasting = Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(100))
        known = typestore("cdr").fielddefs
        self._readers = list[tuple[str, str, Any]]()
        self._filled = WaitSet(network.participant)
        for topic, kinds in live.subscriptions.items():
            quality = lasting if topic.endswith("/tf_static") else passing
            for kind in kinds:
                if kind in known or kind in self._definitions:  # not a type of ROS 1
                    reader: Any = DataReader(network.participant, self._topic(topic, kind), qos=quality)
                    reader.set_status_mask(DDSStatus.DataAvailable)
                    self._filled.attach(reader)
                    self._readers.append((topic, kind, reader))
        self._published = BuiltinDataReader(network.participant, BuiltinTopicDcpsPublication)

    def step(self, timeout: float) -> list[Answer]:
        """Returns the messages to publish now; waits at most `timeout` [s] for a message. For one thread only.

        The same thread receives and computes. Two would wait for each other's hold on Python's interpreter lock, and a
        callback in a thread of DDS would wait for that lock while holding one of DDS.
        """
        self._filled.wait(round(1e9 * time_to_wait(timeout, self._received)))
        taken = [each for topic, kind, reader in self._readers for each in self._taken(topic, kind, reader)]
        for _, message in sorted(taken, key=itemgetter(0)):  # in the order in which they were sent
            self._live.put(message)
        if taken:
            self._received = time.monotonic()
        return self._live.step(0.0)

    def _taken(self, topic: str, kind: str, reader: Any) -> Iterator[tuple[int, RawMessage]]:
        """Yields what a reader has received, each after when it was sent [ns].

        At most as much as waits at once is taken, as a flood may bring more than can be taken meanwhile.
        """
        now = time.time()
        dds_type = self._type(kind)
        for _ in range(self._most_takes):
            samples = reader.take(MAX_TAKEN)
            for sample in samples:
                if isinstance(sample, dds_type):  # other samples tell that a publisher has gone
                    sent = sample.sample_info.source_timestamp
                    yield sent, RawMessage(topic, kind, "cdr", now, sample.data)
            if len(samples) < MAX_TAKEN:
                return

    def publish(self, answer: Answer) -> None:
        """Publishes an answer; a failure is reported, once per topic."""
        writer = self._writers[answer.topic]
        try:
            writer.write(message_type(answer.type)(answer.data))
        except DDSException as error:
            if answer.topic not in self._mute:
                self._mute.add(answer.topic)
                self._say(f"{answer.topic}: an answer could not be published: {error}")

    def check_network(self) -> None:
        """Reports topics with an unexpected type, or with too many publishers; to be called about once a second."""
        publishers = Counter[str]()
        for topic, _, reader in self._readers:
            publishers[topic] += len(reader.get_matched_publications())
        for topic, count in publishers.items():
            self._live.publishers(topic, count)
        for each in self._published.take(MAX_TAKEN):
            name = getattr(each, "topic_name", "") or ""
            if name.startswith("rt/"):
                self._live.published(name[2:], ros_name(each.type_name))

    def _topic(self, topic: str, kind: str) -> Topic:
        return Topic(self._network.participant, carried(topic), self._type(kind))

    def _type(self, kind: str) -> Any:
        """Returns the DDS class of a type, by the rig's definition where ROS has none."""
        known = typestore("cdr").fielddefs
        return message_type(kind, "" if kind in known else self._definitions.get(kind, ""))
