"""Files that are no robots are refused in one sentence; packages are found, and meshes may be missing."""

import itertools
import re
import sys
from pathlib import Path

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
            "r.xml: expected finite numbers for all links and joints, got xyz='0 0 nan', line 1",
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
            "r.xml: joint 'j': expected a link of the file as child, got 'c', line 1",
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


def chain(links, joints):
    """A URDF of links, and of joints from a parent to a child."""
    elements = [f'<link name="{name}"/>' for name in links]
    elements += [
        f'<joint name="j{k}" type="fixed">\n<parent link="{parent}"/><child link="{child}"/></joint>'
        for k, (parent, child) in enumerate(joints)
    ]
    return "\n".join(["<robot>", *elements, "</robot>"])


MANY = [f"l{k}" for k in range(1001)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (chain("abc", ["ab"]), "expected one link that all others hang on, got 'a' and 'c', line 4"),
        (chain("ab", ["ab", "ba"]), "expected a tree of links, got a circle of joints at 'a', line 2"),
        (chain("abc", ["ab", "cc"]), "expected a tree of links, got a circle of joints at 'c', line 4"),
        (
            chain("abc", ["ab", "ac", "cb"]),
            "joint 'j2': expected one parent for each link, got another for 'b', line 9",
        ),
        (
            chain("ab", ["xb"]),
            "joint 'j0': expected a link of the file as parent, got 'x', line 4",
        ),
        (chain("aba", ["ab"]), "expected each link once, got 'a' twice, line 4"),
        (
            chain("abc", ["ab", "ac"]).replace("j1", "j0"),
            "expected each joint once, got 'j0' twice, line 7",
        ),
        (
            chain(MANY[:300], list(itertools.pairwise(MANY[:300]))),
            "expected elements and links at most 200 deep, got deeper",
        ),
        (chain(MANY, []), "expected a robot of at most 1000 links, got more"),
        ("<robot>" + "<link/>" * 60_000 + "</robot>", "expected a robot of at most 50000 elements, got more"),
        ("<a>" * 500 + "</a>" * 500, "expected elements and links at most 200 deep, got deeper"),
        (BALL % "name='j' axis='0 1e308 0'", "expected axes and rotations of some length"),
        (BALL % "name='j' pos='0 0 1e4'", "expected lengths within 1000 m, got 10000"),
        (
            BALL.replace("<joint", "<include file='r.xml'/><joint") % "name='j'",
            "include: expected each file once, got 'r.xml' again, line 1",
        ),
        (
            BALL.replace("<joint", "<include file='none.xml'/><joint") % "name='j'",
            "include: expected a file, got 'none.xml', line 1",
        ),
        (
            "<mujoco><asset><model name='m' file='r.xml'/></asset></mujoco>",
            "expected a robot in one model with its includes, got <model>, line 1",
        ),
        (
            "<mujoco><worldbody>"
            + "<replicate count='100'>" * 4
            + "<body/>"
            + "</replicate>" * 4
            + "</worldbody></mujoco>",
            "expected a robot of at most 50000 elements, got more",
        ),
        (
            "<mujoco><worldbody><replicate count='-1'><body/></replicate></worldbody></mujoco>",
            "replicate: expected a count below a million, got '-1', line 1",
        ),
    ],
    ids=lambda text: text[-60:] if text.startswith("<") else None,
)
def test_what_would_bring_mujoco_down_is_refused_before_it_gets_it(tmp_path, text, message):
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises(InvalidFile) as caught:
        Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    assert str(caught.value).startswith(f"r.xml: {message}")


@pytest.mark.parametrize(
    "absurd",
    [
        "<size memory='1000G'/>",
        "<size njmax='2000000000' nuser_body='2000000000' nkey='200000000'/>",
        "<asset><texture name='t' type='2d' builtin='flat' width='100000' height='100000'/></asset>",
        "<asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/></asset>",
        "<worldbody><flexcomp name='f' type='grid' count='10000 1000 1000' spacing='1 1 1'/></worldbody>",
    ],
)
def test_what_kinematics_does_not_ask_for_is_not_allocated(tmp_path, absurd):
    (tmp_path / "r.xml").write_text((BALL % "name='j'").replace("<mujoco>", "<mujoco>" + absurd))
    assert Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"}).moving == ("j",)


def test_what_an_mjcf_includes_is_part_of_it_and_errors_name_its_lines(tmp_path):
    (tmp_path / "r.xml").write_text(
        "<mujoco>\n<compiler meshdir='m'/><asset>\n<mesh file='a.obj'/></asset><worldbody>\n"
        "<include file='parts/arm.xml'/></worldbody></mujoco>"
    )
    (tmp_path / "parts").mkdir()
    arm = "<mujocoinclude>\n<body name='palm'><geom type='mesh' mesh='a'/>\n<body name='b'><joint name='j'/><geom size='.1'/></body></body></mujocoinclude>"
    (tmp_path / "parts" / "arm.xml").write_text(arm)
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    hand = Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    assert (hand.moving, hand.missing_meshes) == (("j",), ())
    assert "palm" in hand.surface(50).bodies
    (tmp_path / "parts" / "arm.xml").write_text(arm.replace("size='.1'", "size='x'"))
    with pytest.raises(InvalidFile, match=r"arm\.xml line 3$"):
        Hand.from_file(tmp_path / "r.xml", palm="palm")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="this system has no /dev/zero")
def test_a_device_is_not_read(tmp_path):
    with pytest.raises(InvalidFile, match="expected a file"):
        Hand.from_file("/dev/zero", palm="palm")
    (tmp_path / "r.xml").write_text(
        (BALL % "name='j'").replace(
            "<worldbody>", "<asset><mesh name='z' file='/dev/zero'/></asset><worldbody>"
        )
    )
    assert Hand.from_file(tmp_path / "r.xml", palm="palm").missing_meshes == ("/dev/zero",)


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
def test_a_file_that_is_not_there_is_reported(tmp_path, monkeypatch, name, message):
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


def test_a_mesh_that_mujoco_cannot_read_is_reported(robot_file):
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
    content = data_file("hands/allegro_hand/allegro_hand_right.urdf").read_bytes()
    for share in np.linspace(0.02, 0.98, 12):
        (tmp_path / "cut.urdf").write_bytes(content[: int(share * len(content))])
        with pytest.raises(InvalidFile, match=r"^cut.urdf: expected XML"):
            Hand.from_file(tmp_path / "cut.urdf", palm="palm")
