"""Positions of joints as drivers publish them: at a path, by the rig's names, in counts; recorded and live."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handsight.contact import TactileSurface
from handsight.errors import InvalidInput
from handsight.messages import ObservationStream
from handsight.messages.encode import header
from handsight.recording import RecordingWriter, open_recording
from handsight.rig import JointReading, Rig
from handsight.rig.save import write
from messages.ros import START, Messages, begun, nanoseconds, raw, rig
from rig import rigs
from testbed.refusals import refused

M = Messages()
HAND = "their_hand_msgs/msg/HandsState"
DEFINITION = f"""std_msgs/Header header
their_hand_msgs/HandState[] hand_states
{"=" * 80}
MSG: their_hand_msgs/HandState
string[] name
float32[] position
float32[] pressure
"""
COUNTS = np.array([1000.0, 500.0, 250.0])
COUNTED = JointReading(field="hand_states[0].position", scale=-0.002, offset=1000.0)


def robot(reading, **topics):
    return rig(wrenches={}, joint_reading=reading, **topics)


def recorded(folder, kind, positions=COUNTS, names=("j0", "j1", "j2")):
    """Three messages of a driver whose package nobody has installed here."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DEFINITION, HAND))
    path, writer, serialize = begun(folder, kind, store)
    with writer:
        connection = writer.add_connection("/hand", HAND, typestore=store)
        for k in range(3):
            stamp = START + 0.01 * k
            hand = Message(
                name=list(names), position=np.float32(positions), pressure=np.arange(6, dtype=np.float32)
            )
            message = Message(header=header(stamp), hand_states=[hand])
            writer.write(connection, nanoseconds(stamp), serialize(message, HAND))
    return path


def read(path, robot):
    """The observations of a recording, and what is said of it."""
    with open_recording(path, robot) as recording:
        found = list(recording.observations())
        return found, [*recording.report.sentences(), *recording.lacks()]


def test_a_recording_without_definitions_is_read_by_those_of_the_rig(tmp_path):
    """As those of ROS 2 Humble in SQLite are."""
    package = tmp_path / "their_hand_msgs" / "msg"
    package.mkdir(parents=True)
    own, nested = DEFINITION.split("=" * 80 + "\nMSG: their_hand_msgs/HandState\n")
    (package / "HandsState.msg").write_text(own)
    (package / "HandState.msg").write_text(nested)
    path = recorded(tmp_path, "db3")
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as file, file:
        file.execute("DELETE FROM message_definitions")
    without = robot(COUNTED, joint_states="/hand")
    assert not read(path, without)[0]
    seen, _ = read(path, robot(COUNTED, joint_states="/hand", messages=(str(package),)))
    assert seen[0].joint_positions == pytest.approx({"j0": 0.0, "j1": 1.0, "j2": 1.5})


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_positions_are_at_the_rigs_path_with_the_names_beside_them(tmp_path, kind):
    seen, _ = read(recorded(tmp_path, kind), robot(COUNTED, joint_states="/hand"))
    assert len(seen) == 3
    assert seen[0].stamp == START
    assert seen[0].joint_positions == pytest.approx({"j0": 0.0, "j1": 1.0, "j2": 1.5})


def test_joints_and_taxels_of_one_message_are_both_read(tmp_path):
    topics = {"joint_states": "/hand", "skin": {"pad": "/hand"}}
    listening = robot(COUNTED, **topics, skin_fields={"pad": "hand_states[0].pressure"})
    listening.hand.chains_to = lambda links: None
    pad = TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=2, columns=3, pitch=0.004, threshold=0.1
    )
    seen, said = read(recorded(tmp_path, "mcap"), replace(listening, skin={"pad": pad}))
    assert len(seen) == 3
    assert seen[-1].joint_positions["j1"] == pytest.approx(1.0)
    np.testing.assert_array_equal(seen[-1].skin["pad"], np.arange(6.0).reshape(2, 3))
    assert not any("/hand" in each for each in said)


def test_the_rigs_names_and_factors_of_each_joint_take_the_place_of_a_joint_states(tmp_path):
    """As of a driver that publishes counts, an entry that is of no joint, and names of its own."""
    factors = {"scale": (0.01, 0.02, 1.0, -0.01), "offset": (0.0, 0.0, 0.0, 255.0)}
    listening = robot(JointReading(names=("j0", "j1", None, "j2"), **factors))
    message = M.joints(START)
    counts = replace(message, name=["motor1"], position=np.array([100.0, 50.0, 7.0, 155.0]))
    stream = ObservationStream(listening)
    seen = [*stream.put(raw("/joint_states", START, counts)), *stream.finish()]
    assert seen[0].joint_positions == pytest.approx({"j0": 1.0, "j1": 1.0, "j2": 1.0})


@pytest.mark.parametrize(
    ("reading", "reason"),
    [
        ({"field": "hands[0].position"}, "expected a field of the message (header, hand_states), got hands"),
        ({"field": "hand_states[1].position"}, "expected at least 2 elements, got 1"),
        ({"field": "hand_states[0].position", "names": ("j0", "j1")}, "as many positions as names, got 3 for 2"),
        ({"field": "hand_states[0].pressure"}, "as many positions as names, got 6 for 3"),
        ({"field": "hand_states[0].name"}, "expected numbers"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_message_is_told_with_what_is_there(tmp_path, reading, reason):
    seen, said = read(recorded(tmp_path, "mcap"), robot(JointReading(**reading), joint_states="/hand"))
    assert not seen
    assert any(reason in each for each in said), said


def test_positions_beyond_the_joints_limits_after_a_conversion_are_told(tmp_path):
    wrong = replace(COUNTED, scale=0.002)
    path = recorded(tmp_path, "mcap")
    for reading, told in ((COUNTED, False), (wrong, True)):
        listening = robot(reading, joint_states="/hand")
        listening.hand.limits = np.tile([-0.1, 1.6], (3, 1))
        _, said = read(path, listening)
        assert any("/hand: converted joint 'j2'" in each for each in said) is told, said


@pytest.mark.parametrize("reading", [
    JointReading(field="hand_states[0].position", names=("index", None, "thumb"), scale=(1.0, 2.0, 3.0), offset=255.0),
    JointReading(scale=0.01),
])  # fmt: skip
def test_a_rigs_file_has_the_reading_again(tmp_path, reading):
    known = rigs.full(tmp_path)
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "Hand.msg").write_text("float32[] position")
    topics = replace(known.topics, joint_reading=reading, messages=(str(tmp_path / "msg"),))
    known = replace(known, topics=topics)
    write(known, tmp_path / "a.rig.yaml")
    assert Rig.from_file(tmp_path / "a.rig.yaml").topics == known.topics
    with refused(InvalidInput, "rig.topics.joint_reading"):
        RecordingWriter(tmp_path / "a.mcap", known)
