"""The fast readers agree with rosbags, and refuse what is out of the ordinary."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.messages.read import OTHER_BYTES, FastReader
from messages.ros import START, Messages

M, M1 = Messages(), Messages(ros=1)
NAMES = st.lists(
    st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9), max_size=6, unique=True
)


def encoded_ros1(message):
    return bytes(M1.store.serialize_ros1(message, message.__msgtype__))


def encoded(message, little=True):
    return bytes(M.store.serialize_cdr(message, message.__msgtype__, little_endian=little))


@given(NAMES, st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9), st.data())
def test_joint_states_are_what_rosbags_reads(names, frame, draw):
    lengths = st.integers(0, 5)
    counts = [draw.draw(lengths) for _ in range(3)]
    for made, encode, quick in ((M, encoded, FastReader("cdr")), (M1, encoded_ros1, FastReader("ros1"))):
        position, velocity, effort = (np.arange(count, dtype=np.float64) for count in counts)
        message = made.make(
            "sensor_msgs/msg/JointState",
            header=made.header(START + 0.25, frame),
            name=names,
            position=position,
            velocity=velocity,
            effort=effort,
        )
        for _ in range(2):  # the second by the names it remembers
            stamp, found, positions = quick.joints(encode(message))
            assert (stamp, list(found)) == (START + 0.25, names)
            np.testing.assert_array_equal(positions, position)


@given(
    st.lists(st.floats(), min_size=6, max_size=6),
    st.text(st.characters(codec="ascii", min_codepoint=32), max_size=9),
)
def test_wrenches_are_what_rosbags_reads(six, frame):
    for made, encode, quick in ((M, encoded, FastReader("cdr")), (M1, encoded_ros1, FastReader("ros1"))):
        message = made.wrench(START + 0.25, six)
        message = made.make(
            message.__msgtype__, header=made.header(START + 0.25, frame), wrench=message.wrench
        )
        stamp, values = quick.wrench(encode(message))
        assert stamp == START + 0.25
        np.testing.assert_array_equal(values, six)


def test_big_endian_is_refused():
    quick = FastReader("cdr")
    for read, message in ((quick.joints, M.joints(1.0)), (quick.wrench, M.wrench(1.0, np.ones(6)))):
        with pytest.raises(OTHER_BYTES):
            read(encoded(message, little=False))


@pytest.mark.parametrize("kind", ["joints", "wrench"])
@pytest.mark.parametrize("ros", [1, 2])
@settings(max_examples=150, derandomize=True)
@given(data=st.data())
def test_what_is_damaged_is_refused_or_is_well_formed(ros, kind, data):
    made, encode, quick = ((M1, encoded_ros1, FastReader("ros1")), (M, encoded, FastReader("cdr")))[ros - 1]
    spoilt = bytearray(encode(made.joints(1.0) if kind == "joints" else made.wrench(1.0, np.ones(6))))
    for _ in range(data.draw(st.integers(1, 4))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    spoilt = bytes(spoilt[: data.draw(st.integers(0, len(spoilt)))])
    with suppress(*OTHER_BYTES):
        assert all(isinstance(name, str) for name in quick.joints(spoilt)[1])
    with suppress(*OTHER_BYTES):
        assert len(quick.wrench(spoilt)[1]) == 6


FRAMES = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)


@pytest.mark.parametrize("ros", [1, 2])
@given(st.lists(st.tuples(FRAMES, FRAMES, st.lists(st.floats(), min_size=7, max_size=7)), max_size=4))
def test_transforms_are_what_rosbags_reads(ros, links):
    made, encode, quick = ((M1, encoded_ros1, FastReader("ros1")), (M, encoded, FastReader("cdr")))[ros - 1]
    transforms = [
        made.make(
            "geometry_msgs/msg/TransformStamped",
            header=made.header(START + 0.25, parent),
            child_frame_id=child,
            transform=made.make(
                "geometry_msgs/msg/Transform",
                translation=made.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", seven, strict=False))),
                rotation=made.make(
                    "geometry_msgs/msg/Quaternion", **dict(zip("xyzw", seven[3:], strict=True))
                ),
            ),
        )
        for parent, child, seven in links
    ]
    data = encode(made.make("tf2_msgs/msg/TFMessage", transforms=transforms))
    found = quick.transforms(data)
    assert [(each.stamp, each.parent, each.child) for each in found] == [
        (START + 0.25, parent, child) for parent, child, _ in links
    ]
    np.testing.assert_array_equal(
        [each.numbers for each in found], [seven for _, _, seven in links] or np.zeros(0)
    )
    for spoilt in (*(data[:end] for end in range(len(data))), data + b"\0"):
        with pytest.raises(OTHER_BYTES):
            quick.transforms(spoilt)
