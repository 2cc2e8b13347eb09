"""Files that are no robots are refused in one sentence; packages are found, and meshes may be missing."""

import itertools
import sys
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh

from hand.hands import ROBOT, ROBOT_TIPS, data_file
from handsight.errors import InvalidFile, InvalidInput, MissingExtra
from handsight.hand import Hand, HandWarning, find_file
from testbed.refusals import refused

pytest.importorskip("mujoco")

ONE_JOINT = '<robot name="r"><link name="palm"/><link name="b"/><joint name="j" type="revolute"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
BALL = "<mujoco><worldbody><body name='palm'><geom size='.1'/><body name='b'><joint %s/><geom size='.1'/></body></body></worldbody></mujoco>"


NO_HANDS = [
    ("", "empty"),
    (" \n", "empty"),
    ("palm: 1\n", "XML"),
    (ROBOT[:1000].rpartition("<")[0], "XML"),
    ("<html/>", "<html>"),
    ("<robot/>", "links"),
    ("<mujoco/>", "links"),
    ('<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>', "DOCTYPE"),
    ('<robot xmlns:x="http://www.ros.org/wiki/xacro"><x:include filename="a"/></robot>', "`xacro r.xml`"),
    ("<robot><link/></robot>", "a name for each link"),
    ('<robot><link name="a"/><joint name="j" type="fixed"/></robot>', "joint 'j'"),
    (ONE_JOINT.replace("revolute", "hinge"), "'hinge'"),
    (ONE_JOINT.replace("0 0 1", "0 0 nan"), "xyz='0 0 nan'"),
    (ONE_JOINT.replace("0 0 1", "0 0 x"), "MuJoCo"),
    (ONE_JOINT.replace("0 0 1", "0 0 0"), "MuJoCo"),
    (ONE_JOINT.replace('child link="b"', 'child link="c"'), "'c'"),
    ("<mujoco><worldbody><bod/></worldbody></mujoco>", "MuJoCo"),
    (BALL % "name='j' type='ball'", "more than one direction"),
    (BALL % "type='hinge'", "a name for each joint"),
]
"""Files, and what is said of each, beside its name."""


@pytest.mark.parametrize(("text", "said"), NO_HANDS)
def test_files_that_are_no_hands_are_refused(tmp_path, monkeypatch, text, said):
    monkeypatch.chdir(tmp_path)  # where MuJoCo leaves its log
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises((InvalidFile, InvalidInput)) as caught:
        Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    assert str(caught.value).startswith("r.xml: ")
    assert said in str(caught.value)


def chain(links, joints):
    """A URDF of links, and of joints from a parent to a child."""
    elements = [f'<link name="{name}"/>' for name in links]
    elements += [
        f'<joint name="j{k}" type="fixed">\n<parent link="{parent}"/><child link="{child}"/></joint>'
        for k, (parent, child) in enumerate(joints)
    ]
    return "\n".join(["<robot>", *elements, "</robot>"])


MANY = [f"l{k}" for k in range(1001)]


REPLICATED = "<replicate count='100'>" * 4 + "<body/>" + "</replicate>" * 4
TURNED = (
    chain("ab", ["ab"]).replace("fixed", "continuous").replace("/></joint>", '/><axis xyz="1 0 0"/></joint>')
)
TOO_MUCH = [
    (chain("abc", ["ab"]), "'a' and 'c', line 4"),
    (chain("ab", ["ab", "ba"]), "circle of joints at 'a', line 2"),
    (chain("abc", ["ab", "cc"]), "circle of joints at 'c', line 4"),
    (chain("abc", ["ab", "ac", "cb"]), "joint 'j2'"),
    (chain("ab", ["xb"]), "joint 'j0'"),
    (chain("aba", ["ab"]), "'a' twice, line 4"),
    (chain("abc", ["ab", "ac"]).replace("j1", "j0"), "'j0' twice, line 7"),
    (TURNED.replace("1 0 0", "0 0 0"), "axis"),
    (chain(MANY[:300], list(itertools.pairwise(MANY[:300]))), "200 deep"),
    (chain(MANY, []), "1000 links"),
    ("<robot>" + "<link/>" * 60_000 + "</robot>", "50000 elements"),
    ("<a>" * 500 + "</a>" * 500, "200 deep"),
    (BALL % "name='j' axis='0 1e308 0'", "some length"),
    (BALL % "name='j' pos='0 0 1e4'", "1000 m"),
    (BALL.replace("<joint", "<include file='r.xml'/><joint") % "name='j'", "'r.xml' again"),
    (BALL.replace("<joint", "<include file='none.xml'/><joint") % "name='j'", "'none.xml'"),
    ("<mujoco><asset><model name='m' file='r.xml'/></asset></mujoco>", "<model>"),
    (f"<mujoco><worldbody>{REPLICATED}</worldbody></mujoco>", "50000 elements"),
    ("<mujoco><worldbody><replicate count='-1'><body/></replicate></worldbody></mujoco>", "replicate: "),
]
"""Files, and what is said of each, beside its name."""


@pytest.mark.parametrize(
    ("text", "said"), TOO_MUCH, ids=lambda text: text[-60:] if text.startswith("<") else None
)
def test_what_would_bring_mujoco_down_is_refused_before_it_gets_it(tmp_path, text, said):
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises(InvalidFile) as caught:
        Hand.from_file(tmp_path / "r.xml", palm="palm", tips={"f": "b"})
    assert str(caught.value).startswith("r.xml: ")
    assert said in str(caught.value)


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
    with refused(InvalidFile, "r.xml"):
        Hand.from_file(tmp_path / "r.xml", palm="palm")


def test_a_document_type_is_refused_in_any_encoding(tmp_path):
    (tmp_path / "r.urdf").write_bytes(
        '<?xml version="1.0" encoding="utf-16"?><!DOCTYPE r><robot/>'.encode("utf-16")
    )
    with refused(InvalidFile, "r.urdf"):
        Hand.from_file(tmp_path / "r.urdf", palm="palm")


def test_without_mujoco_the_extra_is_named(robot_file, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with refused(MissingExtra, "two_fingers.urdf"):
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


def test_a_link_has_the_same_surface_from_every_format_of_its_mesh(robot_file):
    mesh = trimesh.creation.box((0.06, 0.04, 0.02))
    kinds = ["stl", "obj", "ply", "glb", "stl_ascii", "dae"]
    for kind in kinds[: 5 + (find_spec("collada") is not None)]:
        name = f"{kind}.{kind.removesuffix('_ascii')}"
        data = mesh.export(file_type=kind)
        (robot_file.parent / name).write_bytes(data if isinstance(data, bytes) else data.encode())
        robot_file.write_text(ROBOT.replace('<box size="0.06 0.04 0.02"/>', f'<mesh filename="{name}"/>'))
        hand = Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)
        assert name not in hand.missing_meshes
        vertices = hand.link_meshes()["mount"].vertices
        np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.06, 0.04, 0.02], atol=1e-7)


def test_a_mesh_that_mujoco_cannot_read_is_reported(robot_file):
    robot_file.write_text(ROBOT.replace('<box size="0.06 0.04 0.02"/>', '<mesh filename="bad.obj"/>'))
    (robot_file.parent / "bad.obj").write_text("v 0 0 0\nf 1 2 9\n")
    with refused(InvalidFile, "two_fingers.urdf"):
        Hand.from_file(robot_file, palm="palm")


def test_no_file_of_the_allegro_hand_cut_short_is_taken_for_one(tmp_path):
    content = data_file("hands/allegro_hand/allegro_hand_right.urdf").read_bytes()
    for share in np.linspace(0.02, 0.98, 12):
        (tmp_path / "cut.urdf").write_bytes(content[: int(share * len(content))])
        with refused(InvalidFile, "cut.urdf"):
            Hand.from_file(tmp_path / "cut.urdf", palm="palm")


def test_a_package_is_found_by_the_name_in_its_manifest_and_a_model_of_gazebo_by_its_folder(
    tmp_path, monkeypatch
):
    package = tmp_path / "my-fork-main"
    (package / "meshes").mkdir(parents=True)
    (package / "urdf").mkdir()
    mesh = package / "meshes" / "a b.stl"
    mesh.write_text("")
    (package / "package.xml").write_text("<package format='3'><name>\n  hand_description </name></package>")
    assert find_file("package://hand_description/meshes/a b.stl", package / "urdf") == mesh
    assert find_file(f"file://{str(mesh).replace(' ', '%20')}") == mesh
    with refused(InvalidFile, "package://other/meshes/a b.stl"):
        find_file("package://other/meshes/a b.stl", package / "urdf")
    model = tmp_path / "models" / "gripper" / "m.stl"
    model.parent.mkdir(parents=True)
    model.write_text("")
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path / "models"))
    assert find_file("model://gripper/m.stl", package) == model


@pytest.mark.parametrize(("content", "said"), [(None, "are not there"), (b"broken", "cannot be read")])
def test_collision_meshes_that_are_not_there_and_broken_ones_are_told_apart(robot_file, content, said):
    if content is not None:
        (robot_file.parent / "bad.stl").write_bytes(content)
    robot_file.write_text(ROBOT.replace('<box size="0.06 0.04 0.02"/>', '<mesh filename="bad.stl"/>'))
    with pytest.warns(HandWarning, match=said):
        Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)
