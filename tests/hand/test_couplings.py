"""Coupled joints are where yourdfpy and MuJoCo have them; a position that was measured wins over the law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from hand.hands import ROBOT_TIPS, data_file, within_limits
from handsight.errors import InvalidFile, InvalidInput
from handsight.hand import Hand, HandWarning
from handsight.hand.couplings import Coupling, Couplings
from testbed.refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::handsight.hand.HandWarning")
INSPIRE = {f"{name}_tip": f"{name}_tip" for name in ("thumb", "index", "middle", "ring", "pinky")}
HANDS = {
    "inspire": ("hands/inspire_hand/inspire_hand_right.urdf", "hand_base_link"),
    "ability": ("hands/ability_hand/ability_hand_right.urdf", "thumb_base"),
}
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="palm">
  <geom type="box" size=".02 .02 .01"/>
  <body name="near" pos="0 0 .05"><joint name="driven" axis="0 1 0" ref=".2"/><geom type="sphere" size=".01"/>
    <body name="far" pos="0 0 .04"><joint name="bent" axis="0 1 0" ref="-.1"/><geom type="sphere" size=".01"/>
      <body name="end" pos="0 0 .03"><joint name="last" axis="0 1 0"/><geom type="sphere" size=".01"/></body>
    </body>
  </body></body></worldbody>
  <equality><joint joint1="bent" joint2="driven" polycoef=".05 .8 .3 -.1 .02"/>
    <tendon tendon1="cord"/><joint joint1="last" joint2="driven" polycoef="1 1 0 0 0" active="false"/></equality>
  <tendon><fixed name="cord"><joint joint="bent" coef="2"/><joint joint="last" coef="-3"/></fixed></tendon>
</mujoco>"""


@pytest.fixture(params=["inspire", "ability", "slides"])
def coupled(request, tmp_path):
    """A hand with coupled joints, and yourdfpy's."""
    yourdfpy = pytest.importorskip("yourdfpy")
    if request.param == "slides":
        robot_file = request.getfixturevalue("robot_file")
        path = tmp_path / "fixed.urdf"
        path.write_text(robot_file.read_text().replace("floating", "fixed"))
        palm, tips = "palm", ROBOT_TIPS
    else:
        name, palm = HANDS[request.param]
        path, tips = data_file(name), INSPIRE
    other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    return Hand.from_file(path, palm=palm, tips=tips), other, palm


def test_the_tips_are_where_yourdfpy_has_them(coupled, rng):
    hand, other, palm = coupled
    assert set(hand.needed) < set(hand.moving)
    for _ in range(20):
        every = within_limits(hand, rng)
        driven = {name: every[name] for name in other.actuated_joint_names}
        other.update_cfg(driven)
        expected = [other.get_transform(body, palm) for body in hand.tips.values()]
        needed = {name: every[name] for name in hand.needed}
        np.testing.assert_allclose(hand.Ts_palm_tip(needed), expected, atol=1e-9)


def test_a_driven_joint_moves_what_follows_it(coupled, rng):
    hand, _, _ = coupled
    for _ in range(5):
        positions = {name: value for name, value in within_limits(hand, rng).items() if name in hand.needed}
        pose = hand.kinematics(positions)
        J = pose.jacobians(pose.Ts_palm_tip[:, :3, 3])
        for name in hand.needed:
            step = 1e-6
            ends = [
                hand.Ts_palm_tip(positions | {name: positions[name] + s})[:, :3, 3] for s in (step, -step)
            ]
            column = J[:, :3, hand.moving.index(name)]
            np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * step), atol=1e-8)


def test_what_follows_a_joint_counts_in_the_sensitivity_of_links(coupled, rng):
    hand, _, _ = coupled
    surface = hand.surface(100)
    positions = {name: value for name, value in within_limits(hand, rng).items() if name in hand.needed}
    changes = hand.couplings.changes(surface.joints, positions)
    driven = [name for name in surface.joints if name not in hand.couplings.laws]
    columns = changes[:, [surface.joints.index(name) for name in driven]]
    _, found = surface.points_and_sensitivities(hand.completed(positions), columns)

    def middles(**moved):
        Ts = surface.chains.poses(hand.completed(positions | moved))[0]
        return np.einsum("bij,bj->bi", Ts[:, :3, :3], surface.middles) + Ts[:, :3, 3]

    step = 1e-6
    ends = [[middles(**{name: positions[name] + s}) for s in (step, -step)] for name in driven]
    each = np.array([(more - less) / (2 * step) for more, less in ends])
    np.testing.assert_allclose(found, np.sqrt(np.square(each).sum(axis=(0, 2)) / 3), atol=1e-8)


def test_a_measured_position_wins(coupled, rng):
    hand, _, _ = coupled
    every = within_limits(hand, rng)
    np.testing.assert_array_equal(hand.Ts_palm_tip(every), hand.chains.poses(every)[0])
    pose = hand.kinematics(every)
    points = pose.Ts_palm_tip[:, :3, 3]
    rows = np.arange(len(points))
    np.testing.assert_array_equal(pose.jacobians(points), pose.chains.jacobians(points, rows, pose.axes_palm))


def test_only_driven_joints_are_asked_for(coupled):
    hand, _, _ = coupled
    with pytest.raises(InvalidInput) as error:
        hand.Ts_palm_tip({})
    assert all(name in str(error.value) for name in hand.needed)
    assert not any(name in str(error.value) for name in set(hand.moving) - set(hand.needed))


def test_constraints_of_mujoco_hold(tmp_path, rng):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "finger.xml"
    path.write_text(MJCF)
    hand = Hand.from_file(path, palm="palm", tips={"finger": "end"})
    assert hand.needed == ("driven",)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for angle in rng.uniform(-1, 1, 20):
        positions = hand.completed({"driven": angle})
        for name, value in positions.items():
            data.joint(name).qpos = value
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)
        np.testing.assert_allclose(
            hand.Ts_palm_tip({"driven": angle})[0, :3, 3], data.body("end").xpos, atol=1e-12
        )


numbers = st.floats(-3, 3)


@given(slopes=st.lists(st.tuples(numbers, numbers), min_size=1, max_size=5), position=numbers)
def test_a_chain_of_couplings_is_followed_to_the_driven_joint(slopes, position):
    chain = [Coupling(f"joint{k + 1}", f"joint{k}", Polynomial(law)) for k, law in enumerate(slopes)]
    couplings, left_out = Couplings.of(reversed(chain))
    assert not left_out
    found = couplings.completed({"joint0": position})
    expected = position
    for k, (offset, slope) in enumerate(slopes):
        expected = offset + slope * expected
        np.testing.assert_allclose(found[f"joint{k + 1}"], expected, rtol=1e-9, atol=1e-9)
    assert couplings.leaders(found) == ("joint0",)


@pytest.mark.parametrize(
    ("pairs", "driven"),
    [(["aa"], "a"), (["ab", "ba"], "ab"), (["ab", "ac"], "a"), (["ab", "bc", "cb"], "bc")],
)
def test_joints_in_circles_and_with_two_leaders_count_as_driven_and_are_named(pairs, driven):
    couplings, left_out = Couplings.of([Coupling(*pair, Polynomial([0, 1])) for pair in ["za", *pairs]])
    joints = {"z", *"".join(pairs)}
    assert joints - couplings.laws.keys() >= set(driven)
    (sentence,) = left_out
    assert all(repr(name) in sentence for name in driven)
    # What follows them still does.
    assert couplings.laws["z"][0] in driven


def test_a_hand_whose_joint_follows_two_others_loads_and_asks_for_it(tmp_path):
    path = tmp_path / "finger.xml"
    again = '<joint joint1="bent" joint2="last"/></equality>'
    path.write_text(MJCF.replace("</equality>", again).replace('<tendon tendon1="cord"/>', ""))
    with pytest.warns(HandWarning, match="bent"):
        hand = Hand.from_file(path, palm="palm", tips={"finger": "end"})
    assert hand.needed == ("driven", "bent", "last")


@pytest.mark.parametrize("kind", ["mimic of a fixed joint", "equality of one joint"])
def test_a_joint_that_follows_none_has_a_constant_position(kind, robot_file, tmp_path):
    if kind == "equality of one joint":
        path = tmp_path / "finger.xml"
        one = '<joint joint1="last" polycoef=".3"/><tendon tendon1="other"/>'
        path.write_text(MJCF.replace('<tendon tendon1="cord"/>', one))
        hand = Hand.from_file(path, palm="palm", tips={"finger": "end"})
        name, driven = "last", {"driven": 0.4}
    else:
        mimic = '<mimic joint="bolt" multiplier="2" offset=".3"/>'
        robot_file.write_text(
            robot_file.read_text().replace('<mimic joint="knuckle" multiplier="0.01"/>', mimic)
        )
        hand = Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)
        name, driven = "jaw", {"knuckle": 0.4}
    assert hand.needed == tuple(driven)
    assert hand.completed(driven)[name] == 0.3
    held = hand.kinematics(driven)
    np.testing.assert_array_equal(held.Ts_palm_tip, hand.Ts_palm_tip({**hand.completed(driven), name: 0.3}))
    assert not np.delete(held.changes[hand.moving.index(name)], hand.moving.index(name)).any()


@pytest.mark.parametrize("text", ['multiplier="fast"', 'offset="nan"', 'multiplier="1e999"'])
def test_numbers_of_a_mimic_are_checked(robot_file, tmp_path, text):
    path = tmp_path / "a.urdf"
    path.write_text(robot_file.read_text().replace('multiplier="0.01"', text))
    with refused(InvalidFile, "mimic"):
        Hand.from_file(path, palm="palm", tips=ROBOT_TIPS)
