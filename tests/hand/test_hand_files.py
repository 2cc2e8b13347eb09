"""Files that are no robots are refused in one sentence; packages are found, and meshes may be missing."""

import re
import sys

import numpy as np
import pytest

from hand.hands import ROBOT, ROBOT_TIPS, SHADOW, data_file, shadow_file
from handsight.errors import InvalidFile, InvalidInput, MissingExtra
from handsight.hand import Hand, HandWarning, find_file

pytest.importorskip("mujoco")

ONE_JOINT = '<robot name="r"><link name="palm"/><link name="b"/><joint name="j" type="revolute"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
MUJOCO = "r.xml: MuJoCo cannot make a robot of it: "
BALL = "<mujoco><worldbody><body name='palm'><geom size='.1'/><body name='b'><joint %s/><geom size='.1'/></body></body></worldbody></mujoco>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "r.xml: expected a URDF or an MJCF, got an empty file"),
        (" \n", "r.xml: expected a URDF or an MJCF, got an empty file"),
        ("palm: 1\n", "r.xml: expected XML (URDF or MJCF), got syntax error: line 1, column 0"),
        (ROBOT[:1000].rpartition("<")[0], "r.xml: expected XML (URDF or MJCF), got no element found: line "),
        ("<html/>", "r.xml: expected a URDF (<robot>) or an MJCF (<mujoco>), got <html>"),
        ("<robot/>", "r.xml: expected a robot with links, got none"),
        ("<mujoco/>", "r.xml: expected a robot with links, got none"),
        (
            '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>',
            "r.xml: expected a document without DOCTYPE, got one",
        ),
        (
            '<robot xmlns:x="http://www.ros.org/wiki/xacro"><x:include filename="a"/></robot>',
            "r.xml: expected a URDF, got a xacro file; `xacro r.xml` makes a URDF of it",
        ),
        ("<robot><link/></robot>", "r.xml: expected a name for each link, got none"),
        (
            '<robot><link name="a"/><joint name="j" type="fixed"/></robot>',
            "r.xml: joint 'j': expected a parent, got none",
        ),
        (
            ONE_JOINT.replace("revolute", "hinge"),
            "r.xml: joint 'j': expected a type among revolute, continuous, prismatic, fixed, got 'hinge'",
        ),
        (
            ONE_JOINT.replace("0 0 1", "0 0 nan"),
            "r.xml: expected finite numbers for all links and joints, got NaN",
        ),
        (
            ONE_JOINT.replace("0 0 1", "0 0 x"),
            MUJOCO + "XML Error: bad format in attribute 'xyz' Element 'axis', line 1",
        ),
        (
            ONE_JOINT.replace("0 0 1", "0 0 0"),
            MUJOCO + "Error: axis too small in joint Element name 'j', id 0",
        ),
        (
            ONE_JOINT.replace('child link="b"', 'child link="c"'),
            MUJOCO + "XML Error: URDF joint parent or child missing Element 'joint', line 1",
        ),
        (
            "<mujoco><worldbody><bod/></worldbody></mujoco>",
            MUJOCO + "XML Error: Schema violation: unrecognized element Element 'bod', line 1",
        ),
        (
            BALL % "name='j' type='ball'",
            "r.xml: expected hinges and slides on the way, got joint 'j' of 'b', which moves in more than one direction",
        ),
        (BALL % "type='hinge'", "r.xml: expected a name for each joint on the way, got none at 'b'"),
    ],
)
def test_files_that_are_no_hands_are_refused(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)  # where MuJoCo leaves its log
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises((InvalidFile, InvalidInput)) as caught:
        Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    # MuJoCo's own words are its business, and change.
    assert str(caught.value).startswith(MUJOCO if MUJOCO in message else message)


def test_a_document_type_is_refused_in_any_encoding(tmp_path):
    (tmp_path / "r.urdf").write_bytes(
        '<?xml version="1.0" encoding="utf-16"?><!DOCTYPE r><robot/>'.encode("utf-16")
    )
    with pytest.raises(InvalidFile, match=r"^r.urdf: expected a document without DOCTYPE, got one$"):
        Hand.from_file(tmp_path / "r.urdf", palm="palm")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("not_there.urdf", "not_there.urdf: expected a file, got none of that name"),
        (".", "expected a file, got a folder"),
        ("package://gymnasium_robotics/none.xml", "expected a file of the package, got none of that name"),
        ("package://two_fingers/none.xml", "got none called 'two_fingers'"),
        ("package:///etc/passwd", "got none called ''"),
        ("package://../etc/passwd", "got none called '..'"),
        ("package://a.b/none.xml", "got none called 'a.b'"),
    ],
)
def test_a_file_that_is_not_there_is_told(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidFile, match=re.escape(message) + "$"):
        Hand.from_file(name, palm="palm")


def test_without_mujoco_the_extra_is_named(robot_file, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(
        MissingExtra, match=re.escape("two_fingers.urdf: needs MuJoCo: pip install 'handsight[robot]'")
    ):
        Hand.from_file(robot_file, palm="palm")


def test_packages_are_found_above_the_file_and_where_ros_has_them(tmp_path, monkeypatch):
    def put(path):
        path.parent.mkdir(parents=True)
        path.write_text("")
        return path

    beside = tmp_path / "robots" / "urdf"
    own = put(tmp_path / "robots" / "meshes" / "a.stl")
    sister = put(tmp_path / "sister" / "b.stl")
    ros1, ros2 = (
        put(tmp_path / "ros1" / "pack" / "c.stl"),
        put(tmp_path / "ros2" / "share" / "pack" / "d.stl"),
    )
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros1"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros2"))
    assert find_file("package://robots/meshes/a.stl", beside) == own
    assert find_file("package://sister/b.stl", beside) == sister
    assert find_file("package://pack/c.stl", beside) == ros1
    assert find_file("package://pack/d.stl", beside) == ros2
    assert (
        find_file("b.stl", tmp_path / "sister")
        == find_file(sister)
        == find_file(f"file://{sister}")
        == sister
    )
    assert find_file("package://handsight/py.typed").name == "py.typed"


def test_missing_visual_meshes_are_tolerated_and_counted(robot):
    assert robot.missing_meshes == ("package://two_fingers/meshes/not_there.stl", "meshes/palm.dae")


def test_missing_collision_meshes_are_warned_of_once(robot_file):
    text = ROBOT.replace('<box size="0.06 0.04 0.02"/>', '<mesh filename="box.stl"/>')
    text = text.replace('<cylinder radius="0.008" length="0.04"/>', '<mesh filename="ascii.stl"/>')
    robot_file.write_text(text)
    (robot_file.parent / "ascii.stl").write_text("solid\nendsolid\n")
    message = (
        "two_fingers.urdf: 2 collision meshes left out, not there or neither OBJ nor binary STL: box.stl, ..."
    )
    with pytest.warns(HandWarning, match=f"^{re.escape(message)}$") as caught:
        hand = Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert hand.missing_meshes[2:] == ("box.stl", "ascii.stl")


def test_a_mesh_that_mujoco_cannot_read_is_told(robot_file):
    robot_file.write_text(ROBOT.replace('<box size="0.06 0.04 0.02"/>', '<mesh filename="bad.obj"/>'))
    (robot_file.parent / "bad.obj").write_text("v 0 0 0\nf 1 2 9\n")
    with pytest.raises(InvalidFile, match=r"^two_fingers.urdf: MuJoCo cannot make a robot of it: "):
        Hand.from_file(robot_file, palm="palm")


def test_an_mjcf_without_its_meshes_still_has_its_kinematics(tmp_path):
    text = BALL % "name='j'"
    text = text.replace(
        "<worldbody>", "<asset><mesh file='a.stl'/><mesh name='c' file='b.obj'/></asset><worldbody>"
    )
    (tmp_path / "r.xml").write_text(
        text.replace("<geom size='.1'/>", "<geom type='mesh' mesh='a'/><geom type='mesh' mesh='c'/>")
    )
    hand = Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    assert hand.missing_meshes == ("a.stl", "b.obj")
    np.testing.assert_allclose(hand.Ts_palm_tip({"j": 0.5})[0, 0, 0], np.cos(0.5))
    assert len(hand.surface(10).points_body) == 0


def test_the_name_of_the_file_stays_as_it_was_given(robot_file, robot):
    shadow_file()
    assert robot.file == str(robot_file)
    assert Hand.from_file(SHADOW, palm="robot0:palm").file == SHADOW


def test_no_file_of_the_allegro_hand_cut_short_is_taken_for_one(tmp_path):
    whole = data_file("hands/allegro_hand/allegro_hand_right.urdf").read_bytes()
    for share in np.linspace(0.02, 0.98, 12):
        (tmp_path / "cut.urdf").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InvalidFile, match=r"^cut.urdf: expected XML"):
            Hand.from_file(tmp_path / "cut.urdf", palm="palm")
