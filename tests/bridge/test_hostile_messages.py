"""Whatever is sent over DDS is told and survived: broken bytes, other clocks, floods, unknown objects, dead clients."""

import os
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

pytest.importorskip("mujoco")
pytest.importorskip("cyclonedds", reason="the bridge needs cyclonedds")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic

from handsight.bridge import Bridge, Network
from handsight.bridge.bridge import carried, message_type
from handsight.live import LiveTracker
from handsight.messages import OwnTopic, RawMessage, RosType
from handsight.messages.encode import Message, header, pose_with_covariance, transform
from handsight.messages.read import typestore
from tests.live.recorded import model, poses, read, rig, said

DOMAIN = 101 + (os.getpid() + 50) % 100
ALL_OF_IT = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(2000))
CAMERA = {
    "depth": "/depth",
    "color": "/color",
    "camera_info": "/info",
    "mask": "/mask",
    "detections": "/seen",
}
ONCE = settings(
    max_examples=15,
    phases=[Phase.explicit, Phase.generate],  # a lab that has heard something cannot repeat it
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
SLOWEST = 20.0
"""No step takes longer, however busy the machine is [s]."""


def serialized(kind, **fields):
    return bytes(typestore("cdr").serialize_cdr(Message(**fields), kind))


def image(encoding, kind, shape=(4, 5)):
    data = np.full(shape, 1, kind).view(np.uint8).ravel()
    sides = {"height": shape[0], "width": shape[1], "step": len(data) // shape[0]}
    top = header(1000.0, "camera")
    return serialized(RosType.IMAGE, header=top, encoding=encoding, is_bigendian=0, data=data, **sides)


def camera_info():
    roi = Message(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    matrices = {"k": np.array([500.0, 0, 2, 0, 500, 2, 0, 0, 1]), "r": np.eye(3).ravel(), "p": np.zeros(12)}
    size = {"width": 5, "height": 4, "binning_x": 0, "binning_y": 0, "distortion_model": "plumb_bob"}
    top = header(1000.0, "camera")
    return serialized(RosType.INFO, header=top, d=np.zeros(5), roi=roi, **matrices, **size)


def detections():
    top = header(1000.0, "camera")
    pose = pose_with_covariance(np.eye(4), None)
    result = Message(hypothesis=Message(class_id="can", score=0.5), pose=pose)
    center = Message(position=Message(x=2.0, y=2.0), theta=0.1)
    box = Message(center=center, size_x=2.0, size_y=2.0)
    one = Message(header=top, results=[result], bbox=box, id="1")
    return serialized(RosType.DETECTIONS, header=top, detections=[one])


def recorded(topic):
    found = next(each for each in said() if each.topic == topic)
    return topic, found.type, found.data


START = header(0.0, "palm")
GOOD = [
    *map(recorded, ("/joint_states", "/ff/wrench", "/th/wrench", "/vision/object")),
    ("/tf", RosType.TF, serialized(RosType.TF, transforms=[transform(np.eye(4), 1000.0, "world", "palm")])),
    ("/depth", RosType.IMAGE, image("16UC1", np.uint16)),
    ("/color", RosType.IMAGE, image("rgb8", np.uint8, (4, 5, 3))),
    ("/mask", RosType.IMAGE, image("mono8", np.uint8)),
    ("/info", RosType.INFO, camera_info()),
    ("/seen", RosType.DETECTIONS, detections()),
    (
        OwnTopic.START,
        RosType.POSE_COVARIANCE,
        serialized(RosType.POSE_COVARIANCE, header=START, pose=pose_with_covariance(np.eye(4), None)),
    ),
    (OwnTopic.RESET, RosType.EMPTY, b"\0\1\0\0\0"),
]
"""Of each topic a message as it should be: topic, type, bytes."""
STAMP, HEAD = 4, 4
ODD_NUMBERS = st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0, 1e20])
ODD_WORDS = st.sampled_from([b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0" * 4, b"\0\0\1\0"])
ODD_SECONDS = st.sampled_from([-(2**31), -1, 0, 1, 999, 1000, 1001, 1003, 10**9, 2**31 - 1])


def put(data, at, some):
    return data[:at] + some + data[at + len(some) :]


@st.composite
def spoilt(draw, data):
    """A message's bytes with one fault; DDS itself needs the first four."""
    end = len(data)
    place = draw(st.integers(HEAD, max(end - 1, HEAD)))
    kind = draw(st.sampled_from(["cut", "longer", "noise", "byte", "length", "number", "stamp", "endian"]))
    if kind == "cut":
        return data[:place]
    if kind == "longer":
        return data + draw(st.binary(min_size=1, max_size=40))
    if kind == "noise":
        return data[:HEAD] + draw(st.binary(max_size=200))
    if kind == "byte":
        return put(data, place, draw(st.binary(min_size=1, max_size=1)))
    if kind == "length":  # of a string or a list: huge, negative, zero
        return put(data, place - place % 4, draw(ODD_WORDS))[:end]
    if kind == "number":
        return put(data, HEAD + (place - HEAD) // 8 * 8, struct.pack("<d", draw(ODD_NUMBERS)))[:end]
    if kind == "stamp":
        return put(data, STAMP, struct.pack("<i", draw(ODD_SECONDS)))[:end]
    return put(data, 0, b"\0\0")  # big-endian CDR


@st.composite
def hostile(draw):
    topic, kind, data = draw(st.sampled_from(GOOD))
    return topic, kind, draw(spoilt(data)), draw(st.sampled_from([1, 1, 1, 2, 150]))


class Lab:
    """A bridge, and a robot on the same machine."""

    def __init__(self):
        alone = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        topics = replace(rig().topics, **CAMERA)
        self.live = LiveTracker(replace(rig(), topics=topics), model(), encoding="cdr")
        self.said = list[str]()
        self.bridge = Bridge(self.live, Network(alone), self.said.append)
        self.robot = DomainParticipant(DOMAIN)
        self.writers = {}
        self.told = list[str]()
        self.answers = list[object]()
        for topic, kind, _ in GOOD:
            self.writers[topic] = self.writer(self.robot, topic, kind)
        for topic in said_topics():
            self.writers.setdefault(topic, self.writer(self.robot, topic, RosType.WRENCH))
        self.writers[OwnTopic.OBJECT] = self.writer(self.robot, OwnTopic.OBJECT, RosType.TEXT)
        self.wait(lambda: all(each.get_matched_subscriptions() for each in self.writers.values()))
        time.sleep(0.5)  # the other side finds them too

    def writer(self, participant, topic, kind):
        return DataWriter(participant, Topic(participant, carried(topic), message_type(kind)), ALL_OF_IT)

    def send(self, topic, kind, data):
        """Over DDS; what Cyclone's own writer refuses to send is put in where the bridge puts it."""
        try:
            self.writers[topic].write(message_type(kind)(data))
        except DDSException:
            self.live.put(RawMessage(topic, kind, "cdr", time.time(), data))

    def step(self):
        begun = time.monotonic()
        found = self.bridge.step(0.0)
        assert time.monotonic() - begun < SLOWEST
        self.answers += found
        for each in found:
            self.bridge.publish(each)
            if each.topic == OwnTopic.DIAGNOSTICS:
                statuses = read(each).status
                self.told += [value.value for status in statuses for value in status.values]
                self.told += [status.message for status in statuses]

    def wait(self, reached):
        """Steps until something is reached."""
        until = time.monotonic() + 60.0
        while not reached():
            assert time.monotonic() < until, self.told[-20:]
            self.step()
            time.sleep(0.005)

    def tells(self, text):
        del self.told[:]
        self.wait(lambda: any(text in each for each in self.told))

    def play(self):
        """A good grasp, which begins a new track."""
        self.send(OwnTopic.RESET, RosType.EMPTY, b"\0\1\0\0\0")
        self.tells("begun anew")
        del self.answers[:]
        for k, each in enumerate(said()):
            if each.topic in self.writers:
                self.send(each.topic, each.type, each.data)
            if k % 50 == 0:
                self.step()
        self.wait(lambda: max(poses(self.answers), default=0.0) > said()[-1].log_time - 0.3)


def said_topics():
    return {each.topic for each in said() if each.topic.endswith("wrench")}


@pytest.fixture(scope="module")
def lab():
    return Lab()


def test_hostile_messages_are_survived_and_a_good_grasp_is_followed_afterwards(lab):
    """Malformed, cut, of huge lengths, not numbers, of other times, again and again: no step fails or hangs."""
    cut = [(topic, kind, data[: max(len(data) // 2, HEAD)], 1) for topic, kind, data in GOOD]

    @given(st.lists(hostile(), min_size=1, max_size=6))
    @example(cut)
    @ONCE
    def survives(messages):
        for topic, kind, data, times in messages:
            for _ in range(times):
                lab.send(topic, kind, data)
            lab.step()

    survives()
    lab.tells("left out")
    lab.play()


@ONCE
@given(name=st.text(st.characters(exclude_categories=["Cs"]), max_size=30))
@example("")
@example("\0")
@example("spoon")
@example("/dev/zero")
@example("/nowhere/a.ply")
@example("x" * 5000)
def test_a_request_of_an_unknown_object_is_refused_and_the_track_goes_on(lab, name):
    lab.send(OwnTopic.OBJECT, RosType.TEXT, serialized(RosType.TEXT, data=name))
    lab.tells(f"{OwnTopic.OBJECT}: ")
    assert lab.live.tracker.model.name == model().name


def test_two_hands_on_one_topic_are_told_and_one_that_dies_is_outlived(lab):
    other = DomainParticipant(DOMAIN)
    another = lab.writer(other, "/joint_states", RosType.JOINTS)
    lab.wait(another.get_matched_subscriptions)
    _, kind, data = recorded("/joint_states")
    for k in range(20):
        for writer in (lab.writers["/joint_states"], another):
            writer.write(message_type(kind)(put(data, STAMP, struct.pack("<iI", 3000, 10**7 * k))))
        lab.step()

    def told():
        lab.bridge.check_network()
        return any("/joint_states" in each and "publish the same" in each for each in lab.told)

    lab.wait(told)
    del another, other
    lab.play()
