"""`handsight rig new`, as a user runs it: the first rig of a hand, guessed from its file and from a recording."""

from types import SimpleNamespace

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import handsight as hs
from cli.commands import called
from handsight.hand.guess import finger_name, guess_hand
from handsight.messages import encode
from handsight.messages.match import match_topics
from handsight.recording import open as opening
from handsight.recording import open_recording

LINK = """<link name="{name}"><visual><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></visual></link>
"""
JOINT = """<joint name="{name}_joint" type="{type}"><parent link="{parent}"/><child link="{name}"/><origin xyz="{at}"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
"""
TYPES = {
    "/hand/joint_states": "sensor_msgs/msg/JointState",
    "/right/index/wrench": "geometry_msgs/msg/WrenchStamped",
    "/right/th/wrench": "geometry_msgs/msg/WrenchStamped",
    "/object/truth": "geometry_msgs/msg/PoseStamped",
    "/object/pose": "geometry_msgs/msg/PoseStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
}


@pytest.fixture
def hand(tmp_path):
    """A hand on an arm: two fingers along +y of their last links, 16 mm wide, one of them with a link called a tip."""
    pytest.importorskip("mujoco")
    parts = [LINK.format(name=n, at="0 0 0", size="0.08 0.08 0.02") for n in ("base", "hand")]
    parts.append(JOINT.format(name="hand", type="revolute", parent="base", at="0 0 0.3"))
    for name, x in (("index_distal", -0.03), ("thumb_distal", 0.03)):
        parts.append(LINK.format(name=name, at="0 0.02 0", size="0.016 0.04 0.016"))
        parts.append(JOINT.format(name=name, type="revolute", parent="hand", at=f"{x} 0 0.05"))
    parts.append('<link name="thumb_tip"/>')
    parts.append(JOINT.format(name="thumb_tip", type="fixed", parent="thumb_distal", at="0 0.04 0"))
    path = tmp_path / "two.urdf"
    path.write_text(f'<robot name="two">{"".join(parts)}</robot>')
    return path


def test_the_palm_is_the_last_link_that_all_fingers_hang_on_and_tips_are_spheres_at_their_ends(hand):
    palm, tips = guess_hand(hand)
    assert palm == "hand"
    assert {name: tip.link for name, tip in tips.items()} == {"index": "index_distal", "thumb": "thumb_tip"}
    for name, end in (("index", 0.04), ("thumb", 0.0)):
        assert tips[name].radius == pytest.approx(0.008)
        np.testing.assert_allclose(tips[name].T_link_surface[:3, 3], [0, end - 0.008, 0], atol=1e-6)
        np.testing.assert_allclose(tips[name].T_link_surface[:3, 2], [0, 1, 0], atol=1e-9)


@pytest.mark.parametrize(("link", "finger"), [
    ("robot0:ffdistal", "index"), ("rh_thdistal", "thumb"), ("th_ds", "thumb"), ("pinky_intermediate", "little"),
    ("ring_middle", "ring"), ("mf_ds", "middle"), ("index_middle", "index"), ("link_3.0_tip", "finger1"),
])  # fmt: skip
def test_a_link_s_name_says_whose_finger_it_is(link, finger):
    assert finger_name([link]) == finger


def test_topics_are_matched_by_type_and_name_and_the_truth_is_never_vision():
    topics, used = match_topics(TYPES, ["thumb", "index"])
    assert topics.joint_states == "/hand/joint_states"
    assert dict(topics.wrenches) == {"thumb": "/right/th/wrench", "index": "/right/index/wrench"}
    assert (topics.vision, topics.truth, topics.tf) == ("/object/pose", "/object/truth", "/tf")
    assert used.keys() == TYPES.keys()


def test_numbered_topics_go_to_numbered_fingers_in_order():
    types = dict.fromkeys((f"/ft_{k}/wrench" for k in (10, 2, 1)), "geometry_msgs/msg/WrenchStamped")
    topics, _ = match_topics(types, ["finger1", "finger2", "finger3"])
    assert list(topics.wrenches.values()) == ["/ft_1/wrench", "/ft_2/wrench", "/ft_10/wrench"]


def test_the_rig_can_be_read_says_what_was_guessed_and_is_never_overwritten(
    hand, monkeypatch, tmp_path, capsys
):
    assert called(monkeypatch, tmp_path, "rig", "new", hand, columns=200) == 0
    assert "finger thumb: thumb_tip is its tip, a sphere of 8.0 mm" in capsys.readouterr().err
    text = (tmp_path / "two.rig.yaml").read_text()
    assert "# Guessed: palm: hand, the link that all fingers hang on" in text
    rig = hs.Rig.from_file(tmp_path / "two.rig.yaml")
    assert dict(rig.hand.tips) == {"index": "index_distal", "thumb": "thumb_tip"}
    assert rig.topics.wrenches["thumb"] == "/thumb/wrench"
    assert called(monkeypatch, tmp_path, "rig", "new", hand, columns=200) != 0
    assert "two.rig.yaml: expected a new file, got one that exists" in capsys.readouterr().err
    assert (tmp_path / "two.rig.yaml").read_text() == text


STATE, ARRAY = "tactile_msgs/msg/TactileState", "std_msgs/msg/UInt16MultiArray"


@pytest.mark.parametrize(
    ("types", "taxels", "field"),
    [
        ({"/xServTopic": "xela_server_ros2/msg/SensStream"}, 30, "sensors[sensor_pos=2].forces"),
        ({"/touch": "inspire_hand_ros2/msg/InspireHandTouch"}, 9, "thumb.tip"),
        ({"/index/taxels": STATE, "/thumb/taxels": STATE}, 16, "sensors[0].values"),
        ({"/taxels": STATE}, 16, "sensors[name=thumb].values"),
        ({"/tactile_1": ARRAY, "/tactile_2": ARRAY}, 16, "data"),
        ({"/skin": ARRAY, "/counts": ARRAY}, 16, "data[16:32]"),
    ],
)
def test_taxels_of_a_driver_are_at_the_ends_of_the_tips_until_they_are_measured(
    hand, types, taxels, field, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(
        opening,
        "open_files",
        lambda path: [SimpleNamespace(topics=types, close=lambda: None, messages=lambda wanted: iter(()))],
    )
    assert called(monkeypatch, tmp_path, "rig", "new", hand, "some.mcap", columns=200) == 0
    rig = hs.Rig.from_file(tmp_path / "two.rig.yaml")
    assert {name: len(surface.points) for name, surface in rig.skin.items()} == {
        "index_tip": taxels,
        "thumb_tip": taxels,
    }
    assert rig.topics.skin_fields["thumb_tip"] == field
    assert set(rig.topics.skin.values()) == types.keys() - {"/counts"}
    for name, surface in rig.skin.items():
        tip = rig.fingers[name.removesuffix("_tip")]
        assert surface.frame == tip.frame
        end = tip.T_frame_surface[:3, 3] + tip.tip.radius * tip.T_frame_surface[:3, 2]
        np.testing.assert_allclose(surface.points.mean(axis=0), end, atol=0.006)
        assert (surface.normals @ tip.T_frame_surface[:3, 2] > 0.3).all()
    assert called(monkeypatch, tmp_path, "rig", "check", "two.rig.yaml", columns=200) == 0
    assert "skin thumb_tip" in capsys.readouterr().out


def test_tactile_sensors_of_a_urdf_are_the_rig_s(hand, monkeypatch, tmp_path):
    sensor = """<sensor name="pad"><parent link="hand"/><origin xyz="0 0 0.01" rpy="0 0 0"/>
    <tactile><array rows="2" cols="3" spacing="0.004 0.004"/></tactile></sensor>"""
    hand.write_text(hand.read_text().replace("</robot>", f"{sensor}</robot>"))
    assert called(monkeypatch, tmp_path, "rig", "new", hand, columns=200) == 0
    rig = hs.Rig.from_file(tmp_path / "two.rig.yaml")
    assert (rig.skin["pad"].frame, len(rig.skin["pad"].points)) == ("hand", 6)


@pytest.mark.parametrize(
    ("types", "topics"),
    [
        (
            {"/thumb/taxels": STATE, "/index/taxels": STATE},
            {"index_pad": "/index/taxels", "th_tip": "/thumb/taxels"},
        ),
        (
            {"/hand/th_tip": STATE, "/hand/index_pad": STATE},
            {"index_pad": "/hand/index_pad", "th_tip": "/hand/th_tip"},
        ),
        ({"/tactile_2": ARRAY, "/tactile_1": ARRAY}, {"index_pad": "/tactile_1", "th_tip": "/tactile_2"}),
        ({"/taxels": STATE}, {"index_pad": "/taxels", "th_tip": "/taxels"}),
    ],
)
def test_each_tactile_sensor_of_a_urdf_has_the_topic_of_its_finger(
    hand, types, topics, monkeypatch, tmp_path
):
    taxels = '<tactile><array rows="2" cols="3" spacing="0.004 0.004"/></tactile>'
    sensors = [f'<sensor name="{name}"><parent link="hand"/>{taxels}</sensor>' for name in topics]
    hand.write_text(hand.read_text().replace("</robot>", f"{''.join(sensors)}</robot>"))
    monkeypatch.setattr(
        opening,
        "open_files",
        lambda path: [SimpleNamespace(topics=types, close=lambda: None, messages=lambda wanted: iter(()))],
    )
    assert called(monkeypatch, tmp_path, "rig", "new", hand, "some.mcap", columns=200) == 0
    found = hs.Rig.from_file(tmp_path / "two.rig.yaml").topics
    assert dict(found.skin) == topics
    if len(types) == 1:
        assert found.skin_fields["th_tip"] == "sensors[name=th_tip].values"


def test_an_example_is_copied_as_it_is_and_an_unknown_one_is_refused(monkeypatch, tmp_path, capsys):
    assert called(monkeypatch, tmp_path, "rig", "new", "--like", "allegro") == 0
    assert "link_3.0_tip" in (tmp_path / "allegro.rig.yaml").read_text()
    assert called(monkeypatch, tmp_path, "rig", "new", "--like", "alegro") != 0
    assert called(monkeypatch, tmp_path, "rig", "new") != 0
    said = capsys.readouterr().err
    assert (
        "--like: expected one of allegro, allegro_xela, dg5f, inspire, leap_xela, shadow, got 'alegro'"
        in said
    )
    assert "expected the hand's file, or --like and the name of an example, got neither" in said


def robot(*, palms=("left", "right")):
    """A robot of a base with feet, a head, and hands of three fingers each on an arm."""
    parts = [LINK.format(name="base", at="0 0 0", size="0.2 0.2 0.2")]

    def add(name, parent, at):
        parts.append(LINK.format(name=name, at="0 0 0.015", size="0.016 0.016 0.03"))
        parts.append(JOINT.format(name=name, type="revolute", parent=parent, at=at))

    for k, name in enumerate(("left_foot", "right_foot", "head")):
        add(name, "base", f"0 {0.1 * k} -0.5")
    for side in palms:
        add(f"{side}_palm", "base", "0.4 0 0")
        for k, finger in enumerate(("index", "medium", "thumb")):
            add(f"{side}_{finger}_proximal", f"{side}_palm", f"0 {0.03 * k} 0.08")
            add(f"{side}_{finger}_distal", f"{side}_{finger}_proximal", "0 0 0.03")
    return f'<robot name="robot">{"".join(parts)}</robot>'


def test_of_a_robot_with_two_hands_one_is_asked_for(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco")
    (tmp_path / "robot.urdf").write_text(robot())
    assert called(monkeypatch, tmp_path, "rig", "new", "robot.urdf", columns=200) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("--palm", "left_palm", "right_palm"))
    assert "foot" not in said
    assert called(monkeypatch, tmp_path, "rig", "new", "robot.urdf", "--palm", "right_palm", columns=200) == 0
    _, tips = guess_hand(tmp_path / "robot.urdf", "right_palm")
    links = {name: tip.link for name, tip in tips.items()}
    assert links == {
        name: f"right_{link}_distal"
        for name, link in (("index", "index"), ("middle", "medium"), ("thumb", "thumb"))
    }


def test_the_only_hand_of_a_robot_is_taken(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "robot.urdf").write_text(robot(palms=("left",)))
    palm, tips = guess_hand(tmp_path / "robot.urdf")
    assert (palm, set(tips)) == ("left_palm", {"index", "middle", "thumb"})


def test_links_of_a_mechanism_are_no_tips(tmp_path):
    """Of a closed chain, a driver and its coupler beside the finger."""
    pytest.importorskip("mujoco")
    parts = [LINK.format(name="base", at="0 0 0", size="0.05 0.1 0.02")]
    for side, y in (("left", 0.03), ("right", -0.03)):
        for name, parent, kind, at in (
            ("outer_knuckle", "base", "revolute", f"0 {y} 0.05"),
            ("inner_knuckle", "base", "revolute", f"0 {y / 2} 0.06"),
            ("inner_finger", f"{side}_outer_knuckle", "revolute", "0 0 0.05"),
            ("finger_pad", f"{side}_inner_finger", "fixed", "0 0 0.03"),
        ):
            above = parent if parent == "base" or parent.startswith(side) else f"{side}_{parent}"
            parts.append(LINK.format(name=f"{side}_{name}", at="0 0 0", size="0.02 0.01 0.03"))
            parts.append(JOINT.format(name=f"{side}_{name}", type=kind, parent=above, at=at))
    (tmp_path / "gripper.urdf").write_text(f'<robot name="gripper">{"".join(parts)}</robot>')
    palm, tips = guess_hand(tmp_path / "gripper.urdf")
    assert (palm, {tip.link for tip in tips.values()}) == ("base", {"left_finger_pad", "right_finger_pad"})


@pytest.mark.parametrize(
    ("link", "finger"),
    [
        ("spring_link", None),
        ("left_ring_tip", "ring"),
        ("RingFinger_3", "ring"),
        ("l_hand_medium_2", "middle"),
        ("forearm", None),
    ],
)
def test_a_finger_s_name_is_a_whole_word(link, finger):
    assert finger_name([link]) == (finger or "finger1")


def test_a_recording_has_the_robot_s_description(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco")
    writer_module = pytest.importorskip("mcap.writer")
    text = robot(palms=("left",)).encode() + b"\0"
    with (tmp_path / "drive.mcap").open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/robot_description", "cdr", schema)
        data = b"\0\1\0\0" + len(text).to_bytes(4, "little") + text
        writer.add_message(channel, log_time=1, publish_time=1, data=data)
        writer.finish()
    assert called(monkeypatch, tmp_path, "rig", "new", "drive.mcap", columns=200) == 0
    assert "wrote drive.urdf" in capsys.readouterr().err
    assert hs.Rig.from_file(tmp_path / "drive.rig.yaml").hand.palm == "left_palm"


DEFINITION = "\n".join([
    "std_msgs/Header header", "their_msgs/HandState[] hand_states", "their_msgs/Finger[] fingers",
    "=" * 80, "MSG: their_msgs/HandState", "string[] name", "float32[] position",
    "=" * 80, "MSG: their_msgs/Finger", "string location", "geometry_msgs/Vector3[] raw_force", "float32[] heat",
])  # fmt: skip
TAXELS = 12


@pytest.fixture
def grasp(hand):
    """A recording of a driver with messages of its own, /tf and poses of a camera, and the maker's table."""
    kind = "their_msgs/msg/Hand"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DEFINITION, kind))
    rows = "".join(f"T{k},{3 * (k % 3)},{3 * (k // 3)},8,0,0,1\n" for k in range(TAXELS))
    (hand.parent / "tip.csv").write_text(f"name,x,y,z,nx,ny,nz\n{rows}")
    path = hand.parent / "grasp"
    types = {"/hand": kind, "/tf": TYPES["/tf"], "/object/pose": TYPES["/object/pose"]}
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store) for topic, name in types.items()
        }
        for k in range(8):
            stamp = 1000 + 0.01 * k
            forces = [encode.parts("xyz", np.array([0.0, 0.0, 0.1 * k * i])) for i in range(TAXELS)]
            fingers = [
                SimpleNamespace(location=name, raw_force=forces, heat=np.zeros(5, np.float32))
                for name in ("thumb", "index")
            ]
            joints = SimpleNamespace(
                name=["r_index_distal_joint", "r_thumb_distal_joint"], position=np.float32([0.1, 0.2])
            )
            links = [
                encode.transform(np.eye(4), stamp, "map", "arm"),
                encode.transform(np.eye(4), stamp, "arm", "r_hand"),
            ]
            messages = {
                "/hand": SimpleNamespace(header=encode.header(stamp), hand_states=[joints], fingers=fingers),
                "/tf": SimpleNamespace(transforms=links),
                "/object/pose": SimpleNamespace(
                    header=encode.header(stamp, "lens"), pose=encode.pose(np.eye(4))
                ),
            }
            for topic, message in messages.items():
                writer.write(connections[topic], int(1e9 * stamp), store.serialize_cdr(message, types[topic]))
    return path


def test_joints_taxels_and_frames_are_found_in_messages_of_a_type_that_nobody_knows(
    hand, grasp, monkeypatch, tmp_path, capsys
):
    """The rig reads the recording as it is; what else was found is in comments, and each guess is said."""
    assert called(monkeypatch, tmp_path, "rig", "new", hand, grasp, "--taxels", "tip.csv", columns=200) == 0
    said = capsys.readouterr().err
    text = (tmp_path / "two.rig.yaml").read_text()
    assert "tip.csv: millimetres" in said
    assert "fingers[location=index].heat on /hand: 5 numbers" in text
    found = hs.Rig.from_file(tmp_path / "two.rig.yaml")
    assert found.frames == {"world": "map", "palm": "r_hand", "camera": "lens"}
    assert found.topics.joint_states == "/hand"
    with open_recording(grasp, found) as recording:
        seen = list(recording.observations())[-1]
    assert seen.joint_positions == pytest.approx({"index_distal_joint": 0.1, "thumb_distal_joint": 0.2})
    assert {name: reading.shape for name, reading in seen.skin.items()} == {
        "thumb_tip": (TAXELS, 3),
        "index_tip": (TAXELS, 3),
    }
    assert seen.T_world_palm is not None


def test_a_rig_of_which_no_finger_has_a_sensor_says_so(hand, grasp, monkeypatch, tmp_path, capsys):
    assert called(monkeypatch, tmp_path, "rig", "new", hand, grasp, columns=200) == 0
    assert "no finger has a sensor" in capsys.readouterr().err
    text = (tmp_path / "two.rig.yaml").read_text()
    assert f"fingers[location=thumb].raw_force on /hand: {TAXELS} vectors of 3" in text
    (tmp_path / "two.rig.yaml").write_text(text.replace('"r_hand"', '"hand"'))
    assert called(monkeypatch, tmp_path, "rig", "check", "two.rig.yaml", grasp, columns=200) == 1
    said = capsys.readouterr().out
    assert "no finger has a sensor" in said
    assert "'hand' never came" in said
