"""What a hand's links look like and where they are, against MuJoCo and yourdfpy."""

import numpy as np
import pytest
import trimesh

from hand.hands import ALLEGRO_TIPS, allegro_file, shadow_file, within_limits
from handsight import se3
from handsight.hand import Hand


def corners(mesh, T=None):
    """(m, 3, 3) a link's triangles, moved by T."""
    vertices = mesh.vertices if T is None else se3.apply(T, mesh.vertices)
    return vertices[mesh.faces]


def test_the_shadow_hands_links_are_where_mujoco_has_them(shadow_hand, rng):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(shadow_file()))
    data = mujoco.MjData(model)
    positions = within_limits(shadow_hand, rng)
    for name, value in positions.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)

    def pose(name):
        body = data.body(name)
        return se3.compose(body.xmat.reshape(3, 3).copy(), body.xpos.copy())

    T_palm_world = se3.inverse(pose("robot0:palm"))
    found = shadow_hand.link_poses(positions)
    assert {*shadow_hand.link_meshes()} <= {*found}
    for name, T_palm_link in found.items():
        np.testing.assert_allclose(T_palm_link, T_palm_world @ pose(name), atol=1e-9)


def test_the_allegro_hands_links_have_the_meshes_of_yourdfpy(rng):
    yourdfpy = pytest.importorskip("yourdfpy")
    path = allegro_file()
    other, hand = yourdfpy.URDF.load(str(path)), Hand.from_file(path, palm="palm", tips=ALLEGRO_TIPS)
    positions = within_limits(hand, rng)
    other.update_cfg(positions)
    meshes, poses = hand.link_meshes(), hand.link_poses(positions)
    expected = dict.fromkeys(meshes, 0.0)
    for name, geometry in other.scene.geometry.items():
        link = other.scene.graph.transforms.parents[other.scene.graph.geometry_nodes[name][0]]
        T = other.get_transform(other.scene.graph.geometry_nodes[name][0], "palm")
        mine = corners(meshes[link], poses[link]).reshape(-1, 3)
        theirs = se3.apply(T, geometry.vertices)
        np.testing.assert_allclose([mine.min(0), mine.max(0)], [theirs.min(0), theirs.max(0)], atol=1e-6)
        expected[link] += geometry.area
    for link, mesh in meshes.items():
        assert trimesh.Trimesh(*mesh).area == pytest.approx(expected[link], rel=1e-4)


def test_a_link_has_its_visual_shapes_else_its_collision_shapes(robot):
    meshes = robot.link_meshes()
    assert set(meshes) == {"mount", "turning", "sliding"}  # the palm's only mesh is not there
    sizes = {name: np.ptp(mesh.vertices, axis=0) for name, mesh in meshes.items()}
    np.testing.assert_allclose(sizes["mount"], [0.06, 0.04, 0.02], atol=1e-8)  # its visual mesh is not there
    np.testing.assert_allclose(
        sizes["turning"], 2.0, atol=1e-6
    )  # a sphere to the eye, a cylinder to the touch


def test_a_links_faces_point_outward(robot, shadow_hand):
    for hand in (robot, shadow_hand):
        for mesh in hand.link_meshes().values():
            assert trimesh.Trimesh(*mesh).volume > 0


def test_links_on_joints_that_nobody_hears_of_are_left_out(robot, shadow_hand, rng):
    assert set(robot.link_poses({"knuckle": 0.3, "jaw": 0.01})) == {"mount", "palm", "turning", "sliding"}
    assert set(robot.link_poses({"knuckle": 0.3})) == {"mount", "palm", "turning", "sliding"}  # it follows
    assert set(robot.link_poses({"jaw": 0.01})) == {"mount", "palm", "sliding"}
    positions = within_limits(shadow_hand, rng)
    all_poses = shadow_hand.link_poses(positions)
    del positions["robot0:LFJ4"]
    rest = shadow_hand.link_poses(positions)
    assert {name[:9] for name in set(all_poses) - set(rest)} == {"robot0:lf"}
    for name, T in rest.items():
        np.testing.assert_array_equal(T, all_poses[name])
