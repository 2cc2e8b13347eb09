"""What DDS is told of ROS 2's messages, and where they are looked for."""

import os
import time
from types import SimpleNamespace as Message

import numpy as np
import pytest

from testbed.refusals import refused

pytest.importorskip("rosbags")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic

from handsight.bridge import Bridge, Network
from handsight.bridge.bridge import (
    FAST_DDS_3,
    LOOPBACK,
    carried,
    configuration,
    dds_name,
    domain_id,
    message_type,
    ros_name,
)
from handsight.errors import InvalidInput
from handsight.messages import OwnTopic, RosType
from handsight.messages.definitions import definitions_in
from handsight.messages.encode import header
from handsight.messages.read import defined

ROS2 = [kind for name, kind in vars(RosType).items() if name.isupper() and name != "TF_ROS1"]


@pytest.mark.parametrize("kind", ROS2)
def test_every_type_that_a_rig_may_hear_is_one_of_dds_and_keeps_its_bytes(kind):
    made = message_type(kind)
    made.__idl__.populate()
    made.__idl__.fill_type_data()
    assert made.__idl_typename__.replace(".", "::") == dds_name(kind)
    assert ros_name(dds_name(kind)) == kind
    for received in (made.deserialize(b"bytes", has_header=True), made.deserialize_key(b"bytes")):
        assert received.data == received.serialize(use_version_2=False) == b"bytes"
    assert message_type(kind) is made


def test_types_of_others_keep_their_names_and_unknown_ones_are_refused():
    assert ros_name("company::Thing") == "company::Thing"
    with refused(InvalidInput, ""):
        message_type("tf/msg/tfMessage")


def test_the_users_configuration_comes_last_and_counts():
    assert configuration({}) == FAST_DDS_3
    assert configuration({"CYCLONEDDS_URI": "file:///x.xml,"}) == f"{FAST_DDS_3},file:///x.xml"
    for alone in ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}):
        assert configuration(alone) == f"{FAST_DDS_3},{LOOPBACK}"
    assert configuration({"ROS_LOCALHOST_ONLY": "0"}) == FAST_DDS_3


def test_the_domain_is_the_environments():
    assert domain_id({}) == domain_id({"ROS_DOMAIN_ID": ""}) == 0
    assert domain_id({"ROS_DOMAIN_ID": " 42 "}) == 42
    for wrong in ("-1", "233", "a", "4.5", "²", "9" * 30):
        with refused(InvalidInput, "ROS_DOMAIN_ID"):
            domain_id({"ROS_DOMAIN_ID": wrong})


class Listener:
    """In a tracker's place: keeps what it is given."""

    subscriptions, publications, equal = (
        {"/a": (RosType.TEXT,), "/b": (RosType.TEXT,)},
        {OwnTopic.MARKERS: RosType.MARKERS},
        False,
    )

    def __init__(self):
        self.heard = []
        self.definitions = {}

    def put(self, message):
        self.heard.append((message.topic, message.data))

    def step(self, timeout):
        assert timeout == 0.0  # it is the bridge that waits
        return [len(self.heard)]


def test_a_step_waits_for_messages_and_hands_them_over_in_the_order_that_they_were_sent_in():
    domain = 101 + os.getpid() % 100
    alone = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    network, live = Network(alone), Listener()
    bridge, robot = Bridge(live, network, print), DomainParticipant(domain)
    all_of_it = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(10))
    writers = [
        DataWriter(robot, Topic(robot, carried(name), message_type(RosType.TEXT)), all_of_it) for name in "ab"
    ]
    until = time.monotonic() + 20.0
    while not all(each.get_matched_subscriptions() for each in writers):
        assert time.monotonic() < until
        time.sleep(0.01)
    sent = [
        (f"/{name}", b"\0\1\0\0\2\0\0\0" + digit + b"\0\0\0")
        for name, digit in zip("abba", (b"0", b"1", b"2", b"3"), strict=True)
    ]
    for topic, data in sent:
        writers["ab".index(topic[1])].write(message_type(RosType.TEXT)(data))
    time.sleep(0.2)
    assert bridge.step(60.0) == [4]
    assert live.heard == sent
    begun = time.monotonic()
    assert bridge.step(60.0) == [4]  # soon after a message another one may be waited for in vain
    assert time.monotonic() - begun < 30.0


def test_messages_of_a_type_of_its_own_are_heard_by_the_rigs_definition(tmp_path):
    package = tmp_path / "their_msgs" / "msg"
    package.mkdir(parents=True)
    (package / "Hands.msg").write_text("std_msgs/Header header\nFinger[] fingers # of one hand\n")
    (package / "Finger.msg").write_text("uint8 NONE=0\nstring name\nfloat32[3] force\n")
    found = definitions_in((str(package),))
    kind = "their_msgs/msg/Hands"
    assert set(found) == {kind, "their_msgs/msg/Finger"}
    domain = 1 + os.getpid() % 100  # another one than above, as a process joins each once
    live = Listener()
    live.subscriptions, live.definitions = {"/hand": (kind,)}, found
    network = Network({"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    bridge, robot = Bridge(live, network, print), DomainParticipant(domain)
    made = message_type(kind, found[kind])
    writer = DataWriter(robot, Topic(robot, carried("/hand"), made), Qos(Policy.Reliability.BestEffort))
    until = time.monotonic() + 20.0
    while not writer.get_matched_subscriptions():
        assert time.monotonic() < until
        time.sleep(0.01)
    store = defined("cdr", kind, found[kind])
    fingers = [Message(name="thumb", force=np.ones(3, np.float32))]
    sent = bytes(store.serialize_cdr(Message(header=header(1.0), fingers=fingers), kind))
    writer.write(made(sent))
    bridge.step(20.0)
    assert live.heard == [("/hand", sent)]
