"""Readings and contacts in the messages of tactile sensors' drivers, live and from recordings that define the types."""

from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from handsight.contact import TactileSurface
from handsight.messages import ObservationStream, RawMessage
from handsight.messages.encode import header, parts
from handsight.messages.read import typestore
from handsight.recording import open_recording
from messages.ros import START, Messages, begun, nanoseconds, raw, rig

M = Messages()
READING = np.arange(1.0, 7.0).reshape(2, 3)
HAND = "aidin_hand2_msgs/msg/HandState"
HAND_DEFINITION = "\n".join(
    [
        "std_msgs/Header header",
        "float64[6] tactile_thumb",
        "CommandState command_state",
        "=" * 80,
        "MSG: aidin_hand2_msgs/CommandState",
        "uint8 SOURCE_NONE=0",
        "uint8 selected_source",
    ]
)


def grid(rows=2, columns=3):
    return TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=rows, columns=columns, pitch=0.004, threshold=0.1
    )


def robot(fields=None, contacts=None, **surfaces):
    """A rig that hears its surfaces on /skin, at these paths; a surface without one is alone there."""
    surfaces = surfaces or {"thumb": grid()}
    listening = rig(
        wrenches={}, skin=dict.fromkeys(surfaces, "/skin"), skin_fields=fields or {}, contacts=contacts or {}
    )
    listening.hand.chains_to = lambda links: None
    return replace(listening, skin=surfaces)


def serialized(kind, message, encoding="cdr", topic="/skin", store=None):
    data = getattr(store or typestore(encoding), f"serialize_{encoding}")(message, kind)
    return RawMessage(topic, kind, encoding, START, bytes(data))


def observed(listening, message):
    """The second of two observations, 10 ms apart, and the report on /skin; the message comes between them."""
    stream = ObservationStream(listening)
    found = []
    for each in (raw("/joint_states", START, M.joints(START)), message, late()):
        found += stream.put(each)
    found += stream.finish()
    return found[1], stream.report.topics[message.topic]


def late():
    return raw("/joint_states", START + 0.01, M.joints(START + 0.01))


def xela(*sensors, time=START, package="xela_server_ros2"):
    """A SensStream of (sensor_pos, forces (n, 3)); counts are a thousand times the forces."""
    full = [
        Message(
            message=7,
            time=time,
            model="uSPa44",
            sensor_pos=position,
            taxels=[parts("xyz", np.abs(1000 * f).astype(np.uint16)) for f in forces],
            forces=[parts("xyz", f.astype(np.float32)) for f in forces],
        )
        for position, forces in sensors
    ]
    return f"{package}/msg/SensStream", Message(sensors=full)


def cloud(columns, height=1, endian="<"):
    """A PointCloud2 of float32 columns by name, in rows with eight spare bytes at the end."""
    data = np.stack(list(columns.values()), axis=1).astype(f"{endian}f4")
    n, step = len(data), 4 * len(columns) + 4
    row = n // height * step + 8
    points = np.zeros((n, step), np.uint8)
    points[:, : 4 * len(columns)] = data.view(np.uint8).reshape(n, -1)
    buffer = np.zeros((height, row), np.uint8)
    buffer[:, :-8] = points.reshape(height, -1)
    fields = [Message(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate(columns)]
    return "sensor_msgs/msg/PointCloud2", Message(
        header=header(START),
        height=height,
        width=n // height,
        fields=fields,
        is_bigendian=endian == ">",
        point_step=step,
        row_step=row,
        data=buffer.ravel(),
        is_dense=True,
    )


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_the_surfaces_of_a_tactile_state_are_found_by_their_names(encoding):
    names = {"thumb": READING, "index": 10 * READING}
    channels = [Message(name=name, values=each.ravel().astype(np.float32)) for name, each in names.items()]
    message = Message(header=header(START), sensors=channels[::-1])
    state = serialized("tactile_msgs/msg/TactileState", message, encoding)
    seen, topic = observed(robot(thumb=grid()), state)
    np.testing.assert_array_equal(seen.skin["thumb"], READING)
    fields = {"thumb": "sensors[name=thumb].values", "index": "sensors[name=index].values"}
    seen, topic = observed(robot(fields, thumb=grid(), index=grid()), state)
    for name, each in names.items():
        np.testing.assert_array_equal(seen.skin[name], each)
    assert (topic.used, topic.messages, topic.unstamped) == (2, 2, False)


def test_an_inspire_hand_has_a_region_of_each_finger_and_the_palm():
    counts = np.arange(1, 97, dtype=np.int16)
    some = {"total_pressure": 0.0, "max_pressure": 0.0, "contact_count": 0}
    finger = Message(name="", tip=counts[:9], nail=counts, pad=counts[:80], middle_section=counts[:0], **some)
    fingers = dict.fromkeys(("little", "ring", "middle", "index", "thumb"), finger)
    message = Message(
        header=header(START),
        **fingers,
        palm=np.arange(112, dtype=np.int16),
        total_contact=0.0,
        fingers_in_contact=0,
        stable_contact=False,
    )
    surfaces = {"tip": grid(3, 3), "pad": grid(10, 8), "palm": grid(8, 14)}
    fields = {"tip": "index.tip", "pad": "thumb.pad", "palm": "palm"}
    seen, _ = observed(
        robot(fields, **surfaces), serialized("inspire_hand_ros2/msg/InspireHandTouch", message)
    )
    np.testing.assert_array_equal(seen.skin["tip"], counts[:9].reshape(3, 3))
    np.testing.assert_array_equal(seen.skin["pad"], counts[:80].reshape(10, 8))
    np.testing.assert_array_equal(seen.skin["palm"], np.arange(112).reshape(8, 14))


@pytest.mark.parametrize(("height", "endian"), [(1, "<"), (2, "<"), (2, ">"), (6, ">")])
def test_a_cloud_has_its_readings_in_a_column(height, endian):
    columns = {"x": np.zeros(6), "fz": READING.ravel(), "fx": -READING.ravel()}
    message = serialized(*cloud(columns, height, endian))
    seen, _ = observed(robot({"thumb": "[fz]"}), message)
    np.testing.assert_array_equal(seen.skin["thumb"], READING)
    _, topic = observed(robot({"thumb": "[force]"}), message)
    assert "skin thumb: field [force]: expected columns of the cloud (x, fz, fx), got force" in topic.reasons


def told(surfaces, message):
    """The only reason for which a surface of a message is left out."""
    seen, topic = observed(surfaces, message)
    assert not seen.skin
    (reason,) = topic.reasons
    return reason


def test_an_organised_cloud_of_another_shape_than_the_grid_is_told():
    columns = {name: READING.ravel() for name in ("fx", "fy", "fz")}
    for field in ("[fz]", "[fx,fy,fz]"):
        assert "3 x 2" in told(robot({"thumb": field}), serialized(*cloud(columns, 3)))


@pytest.mark.parametrize("count", [2, 3])
def test_a_column_of_a_cloud_with_several_numbers_a_point_is_told_by_its_name(count):
    kind, message = cloud({"fx": READING.ravel(), "force": READING.ravel()}, 1)
    message.fields[1].count = count
    assert "force" in told(robot({"thumb": "[force]"}), serialized(kind, message))
    seen, _ = observed(robot({"thumb": "[fx]"}), serialized(kind, message))
    np.testing.assert_array_equal(seen.skin["thumb"], READING)


def test_two_sensors_with_one_number_are_told_with_all_numbers():
    kind, message = xela((4, np.ones((6, 3))), (4, np.zeros((6, 3))), (5, np.ones((6, 3))))
    assert "4, 4, 5" in told(robot({"thumb": "sensors[sensor_pos=4].forces.z"}), serialized(kind, message))
    seen, _ = observed(robot({"thumb": "sensors[sensor_pos=5].forces.z"}), serialized(kind, message))
    np.testing.assert_array_equal(seen.skin["thumb"], np.ones((2, 3)))


@pytest.mark.parametrize("kind", ["Float64", "UInt16", "Int32"])
def test_every_array_of_numbers_is_one(kind):
    data = READING.ravel().astype(kind.lower())
    message = Message(layout=Message(dim=[], data_offset=0), data=data)
    seen, _ = observed(robot(), serialized(f"std_msgs/msg/{kind}MultiArray", message))
    np.testing.assert_array_equal(seen.skin["thumb"], READING)
    seen, _ = observed(
        robot({"thumb": "data[2:4]"}, thumb=grid(1, 2)), serialized(f"std_msgs/msg/{kind}MultiArray", message)
    )
    np.testing.assert_array_equal(seen.skin["thumb"], [[3, 4]])


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        ("sensors[2].forces.z", "field sensors[2]: expected at least 3 elements, got 2"),
        (
            "sensors[sensor_pos=7].forces.z",
            "field sensors[sensor_pos=7]: expected one with that sensor_pos, got 4, 9",
        ),
        (
            "sensors[0].force",
            "field sensors[0].force: expected a field of the message (message, time, model, sensor_pos",
        ),
        ("sensors[0].forces", "expected 2 x 3 taxels, got 6 x 3"),
        ("sensors[0].forces[0:5].z", "expected 2 x 3 taxels, got 5 numbers"),
        ("sensors[0].forces[0:7].z", "field sensors[0].forces[0:7]: expected at least 7 elements, got 6"),
        ("sensors[0].model", "expected numbers, got str"),
        ("sensors[0].model[0]", "field sensors[0].model[0]: expected a list, got str"),
        (
            "sensors[1].forces.z",
            "expected 2 x 3 taxels, got none, as drivers send them without a calibration",
        ),
    ],
)
def test_a_path_that_leads_nowhere_is_told_with_the_step(field, reason):
    kind, message = xela((4, np.ones((6, 3))), (9, np.ones((0, 3))))
    seen, topic = observed(robot({"thumb": field}), serialized(kind, message))
    assert not seen.skin
    (told,) = topic.reasons
    assert told.startswith(f"skin thumb: {reason}")


def contact(name="", frame="", force=(0.0, 0.0, -2.0), point=(0.001, 0.002, 0.003)):
    return Message(
        header=header(START, frame),
        name=name,
        position=parts("xyz", np.array(point)),
        normal=parts("xyz", np.array([0.0, 0.6, -0.8])),
        wrench=Message(force=parts("xyz", np.array(force)), torque=parts("xyz", np.zeros(3))),
    )


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_a_tactile_contact_is_the_fingers_with_its_normal_force(encoding):
    kind = "tactile_msgs/msg/TactileContact"
    message = serialized(kind, contact(), encoding, topic="/th/contact")
    seen, _ = observed(touching({"th": "/th/contact"}), message)
    found = seen.contacts["th"]
    np.testing.assert_array_equal(found.point, [0.001, 0.002, 0.003])
    assert (found.frame, found.force) == ("tip", pytest.approx(1.6))


def touching(contacts):
    return rig(wrenches={}, contacts=contacts)


def test_tactile_contacts_are_given_to_the_fingers_they_name_and_the_others_touch_nothing():
    kind = "tactile_msgs/msg/TactileContacts"
    listening = touching({"ff": "/contacts", "th": "/contacts"})
    several = Message(contacts=[contact("else"), contact("th")])
    seen, topic = observed(listening, serialized(kind, several, topic="/contacts"))
    assert seen.contacts["ff"] is None
    assert seen.contacts["th"].force == pytest.approx(1.6)
    assert topic.used == 2
    by_frame = Message(contacts=[contact(frame="ff")])
    seen, _ = observed(listening, serialized(kind, by_frame, topic="/contacts"))
    assert (seen.contacts["ff"].frame, seen.contacts["th"]) == ("ff", None)


def test_a_contact_of_no_finger_on_a_shared_topic_is_left_out_and_told():
    listening = touching({"ff": "/contacts", "th": "/contacts"})
    nobody = serialized("tactile_msgs/msg/TactileContact", contact(), topic="/contacts")
    seen, topic = observed(listening, nobody)
    assert not seen.contacts
    assert list(topic.reasons) == ["expected the name or frame of a finger on this topic (ff, th), got none"]


def test_contacts_of_its_are_in_millimetres():
    zero = {"Ft": parts("xyz", np.zeros(3)), "T": 0.0, "D": 0.1, "convergence_time": 1.0}
    message = Message(
        header=header(START),
        PoC=parts("xyz", np.array([1.0, 2, 3])),
        n=parts("xyz", np.array([0, 0.6, 0.8])),
        Fn=1.5,
        **zero,
    )
    kind = "its_msgs/msg/SoftContactSensingProblemSolution"
    seen, _ = observed(touching({"th": "/th/contact"}), serialized(kind, message, topic="/th/contact"))
    np.testing.assert_allclose(seen.contacts["th"].point, [0.001, 0.002, 0.003], atol=1e-15)
    assert seen.contacts["th"].force == 1.5


def recorded(folder, kind, definition=HAND_DEFINITION, name=HAND):
    """A recording of joint states and one message of a driver whose package nobody has installed here."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(definition, name))
    joints = Messages(1 if kind == "bag" else 2)
    rows = [
        ("/joint_states", START, joints.joints(START), "sensor_msgs/msg/JointState"),
        ("/skin", START + 0.005, None, name),
        ("/joint_states", START + 0.01, joints.joints(START + 0.01), "sensor_msgs/msg/JointState"),
    ]
    path, writer, serialize = begun(folder, kind, store)
    with writer:
        connections = {}
        for topic, stamp, message, type_name in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=store)
            if message is None:
                top = header(stamp)
                hand = {"tactile_thumb": READING.ravel(), "command_state": Message(selected_source=3)}
                message = Message(header=top, **hand)
            writer.write(connections[topic], nanoseconds(stamp), serialize(message, type_name))
    return path


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_a_recordings_own_definition_is_enough(tmp_path, kind):
    with open_recording(recorded(tmp_path, kind), robot({"thumb": "tactile_thumb"})) as recording:
        seen = list(recording.observations())[1]
        assert recording.report.sentences() == ["skin thumb: no reading in 1 of 2 observations"]
        assert not any("skin" in each for each in recording.lacks())
    np.testing.assert_array_equal(seen.skin["thumb"], READING)


def test_without_a_path_an_unknown_type_is_told(tmp_path):
    with open_recording(recorded(tmp_path, "mcap"), robot()) as recording:
        list(recording.observations())
        assert any(f"got {HAND}" in each for each in recording.report.sentences())


STEPS = st.sampled_from(
    [
        "sensors",
        ".forces",
        ".taxels",
        "[0]",
        "[1]",
        "[0:2]",
        "[sensor_pos=4]",
        ".x",
        "[x,y,z]",
        "[z]",
        ".time",
    ]
)


@given(st.lists(STEPS, min_size=1, max_size=5).map("".join), st.binary(max_size=12), st.integers(0, 200))
def test_any_path_into_any_message_gives_finite_readings_or_a_reason(path, wrong, at):
    kind, message = xela((4, np.ones((6, 3))), (9, np.ones((6, 3))))
    good = serialized(kind, message)
    spoilt = good._replace(data=good.data[:at] + wrong + good.data[at + len(wrong) :])
    for each in (good, spoilt):
        seen, topic = observed(robot({"thumb": path.removeprefix(".")}), each)
        assert topic.messages == 1 == topic.used + topic.bad + topic.nan + topic.late
        assert all(np.isfinite(each).any() for each in seen.skin.values())
