"""Where the tips are and how they move, against yourdfpy, a product of exponentials and central differences."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hand.hands import ALLEGRO_TIPS, SHADOW_TIPS, allegro_file, shadow_file, within_limits
from handsight import se3
from handsight.hand import Hand
from oracles import product_of_exponentials


@pytest.mark.parametrize("palm", ["base_link", "palm", "link_5.0"])
def test_the_allegro_hands_tips_are_where_yourdfpy_has_them(palm, rng):
    # "palm" is no ancestor of the fingers, and "link_5.0" is a link of one of them.
    yourdfpy = pytest.importorskip("yourdfpy")
    path = allegro_file()
    other = yourdfpy.URDF.load(str(path), load_meshes=False)
    hand = Hand.from_file(path, palm=palm, tips=ALLEGRO_TIPS)
    for _ in range(20):
        positions = within_limits(hand, rng)
        other.update_cfg(positions)
        expected = [other.get_transform(body, palm) for body in ALLEGRO_TIPS.values()]
        np.testing.assert_allclose(hand.Ts_palm_tip(positions), expected, atol=1e-9)
        np.testing.assert_allclose(
            hand.T_world_palm(positions), other.get_transform(palm, "base_link"), atol=1e-9
        )


def test_a_robot_with_an_arm_and_slides_is_where_yourdfpy_has_it(robot, robot_file, rng, tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    text = robot_file.read_text().replace('<mimic joint="knuckle" multiplier="0.01"/>', "")
    (tmp_path / "plain.urdf").write_text(text.replace("floating", "fixed"))
    other = yourdfpy.URDF.load(str(tmp_path / "plain.urdf"), load_meshes=False)
    for _ in range(20):
        positions = within_limits(robot, rng)
        other.update_cfg({name: positions[name] for name in other.actuated_joint_names})
        expected = [other.get_transform(body, "palm") for body in robot.tips.values()]
        np.testing.assert_allclose(robot.Ts_palm_tip(positions), expected, atol=1e-9)
        np.testing.assert_allclose(
            robot.T_world_palm(positions), other.get_transform("palm", "base"), atol=1e-9
        )


def test_the_shadow_hands_tips_are_where_mujoco_has_them(shadow_hand, rng):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(shadow_file()))
    data = mujoco.MjData(model)

    def pose(name):
        body = data.body(name)
        return se3.compose(body.xmat.reshape(3, 3).copy(), body.xpos.copy())

    for _ in range(20):
        positions = within_limits(shadow_hand, rng)
        for name, value in positions.items():
            data.joint(name).qpos[:] = value
        mujoco.mj_forward(model, data)
        T_world_palm = pose("robot0:palm")
        Ts = se3.inverse(T_world_palm) @ np.array([pose(body) for body in SHADOW_TIPS.values()])
        np.testing.assert_allclose(shadow_hand.Ts_palm_tip(positions), Ts, atol=1e-9)
        np.testing.assert_allclose(shadow_hand.T_world_palm(positions), T_world_palm, atol=1e-9)


MJCF = """<mujoco><compiler fusestatic="true" discardvisual="true"/><worldbody>
  <body name="palm" pos="1 2 3" euler="10 20 30"><geom size=".01"/>
    <body name="a" pos="0 0 .1" euler="0 40 0">
      <joint name="first" pos=".01 .02 .03" axis="1 2 3" ref="20"/>
      <joint name="second" type="slide" axis="0 1 1" ref=".01"/>
      <joint name="third" pos="0 .01 0" axis="0 0 -2"/>
      <geom size=".01"/>
      <body name="tip" pos="0 0 .05" quat="1 2 3 4"><geom size=".01" contype="0" conaffinity="0"/></body>
    </body>
  </body>
</worldbody></mujoco>"""


def test_joints_with_anchors_references_and_several_to_a_body_are_where_a_product_of_exponentials_has_them(
    tmp_path, rng
):
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "robot.xml").write_text(MJCF)
    hand = Hand.from_file(tmp_path / "robot.xml", palm="palm", tips={"f": "tip"})
    model = mujoco.MjModel.from_xml_string(MJCF.replace('"true"', '"false"'))
    for _ in range(10):
        positions = dict(zip(("first", "second", "third"), rng.uniform(-1, 1, 3), strict=True))
        expected = product_of_exponentials.poses_between(model, positions, "palm", ["tip"])
        np.testing.assert_allclose(hand.Ts_palm_tip(positions), expected, atol=1e-13)
        assert_jacobians_are_derivatives(hand, positions, 0.1 * rng.normal(size=(1, 3)))
    assert hand.limits.tolist() == [[-np.inf, np.inf]] * 3


def assert_jacobians_are_derivatives(hand, positions, points_tip, step=1e-5):
    """Central differences of a point on each tip, and of its rotation, by each joint."""

    def at(positions):
        Ts = hand.Ts_palm_tip(positions)
        return np.array([se3.apply(T, p[None])[0] for T, p in zip(Ts, points_tip, strict=True)]), Ts[
            :, :3, :3
        ]

    pose = hand.kinematics(positions)
    found = pose.jacobians(at(positions)[0])
    assert found.shape == (len(hand.tips), 6, len(hand.moving))
    for column, name in enumerate(pose.moving_joints):
        after, R_after = at({**positions, name: positions[name] + step})
        before, R_before = at({**positions, name: positions[name] - step})
        turn = se3.rotation_log(R_after @ R_before.swapaxes(-1, -2))
        numeric = np.hstack([after - before, turn]) / (2 * step)
        np.testing.assert_allclose(found[:, :, column], numeric, atol=1e-8)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.0, 0.01, 1.0]))
def test_the_jacobians_are_the_derivatives(shadow_hand, seed, reach):
    rng = np.random.default_rng(seed)
    assert_jacobians_are_derivatives(
        shadow_hand, within_limits(shadow_hand, rng), reach * rng.normal(size=(5, 3))
    )


def test_only_the_joints_between_palm_and_tips_are_needed(shadow_hand, rng):
    positions = within_limits(shadow_hand, rng)
    assert set(shadow_hand.joint_names) - set(shadow_hand.moving) == {"robot0:WRJ1", "robot0:WRJ0"}
    alone = {name: positions[name] for name in shadow_hand.moving}
    among_others = {"elbow": np.nan, **dict(reversed(positions.items()))}
    np.testing.assert_array_equal(shadow_hand.Ts_palm_tip(alone), shadow_hand.Ts_palm_tip(among_others))


def test_coupled_joints_are_read_and_not_computed(robot):
    Ts = robot.Ts_palm_tip({"knuckle": 1.0, "jaw": 0.0}) - robot.Ts_palm_tip({"knuckle": 0.0, "jaw": 0.0})
    assert np.abs(Ts[0]).max() > 0.1
    np.testing.assert_array_equal(Ts[1], 0)


def test_a_hand_without_tips_one_of_fixed_links_and_one_of_one_joint_have_poses(robot_file):
    none = Hand.from_file(robot_file, palm="palm")
    assert none.Ts_palm_tip({}).shape == (0, 4, 4)
    fixed = Hand.from_file(robot_file, palm="palm", tips={"m": "mount"})
    assert fixed.moving == ()
    T_mount_palm = se3.compose(
        Rotation.from_euler("xyz", [0.2, 0.3, 0.4]).as_matrix(), np.array([0, 0.01, 0.03])
    )
    np.testing.assert_allclose(fixed.Ts_palm_tip({})[0], se3.inverse(T_mount_palm), atol=1e-15)
    one = Hand.from_file(robot_file, palm="mount", tips={"s": "sliding"})
    np.testing.assert_allclose(one.Ts_palm_tip({"jaw": 0.01})[0, :3, 3], [-0.01, 0, 0.05], atol=1e-15)
    np.testing.assert_array_equal(one.Ts_palm_tip({"jaw": 1}), one.Ts_palm_tip({"jaw": 1.0}))


def test_a_hand_can_be_sent_to_another_process(shadow_hand, rng):
    positions = within_limits(shadow_hand, rng)
    same = pickle.loads(pickle.dumps(shadow_hand))
    np.testing.assert_array_equal(same.Ts_palm_tip(positions), shadow_hand.Ts_palm_tip(positions))
    points = same.surface(20).points_palm(positions)
    np.testing.assert_array_equal(points, shadow_hand.surface(20).points_palm(positions))
