"""`handsight rig new`, as a user runs it: the first rig of a hand, guessed from its file and from a recording."""

from types import SimpleNamespace

import numpy as np
import pytest

import handsight as hs
from cli.commands import called
from handsight.hand.guess import finger_name, guess_hand
from handsight.messages.match import match_topics
from handsight.recording import open as opening

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
    assert "# Guessed: palm: hand, the last link that all fingers hang on" in text
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
        opening, "open_files", lambda path: [SimpleNamespace(topics=types, close=lambda: None)]
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
