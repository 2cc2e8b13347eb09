"""The hand's links bound the object, within the errors of their joints; shapes larger than the hand are noticed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import handsight as hs
from handsight import se3
from handsight.correction.correct import corrected, problem_of
from handsight.hand import Hand
from handsight.rig import Rig
from handsight.tracking.hand_outside import HandOutside
from testbed import scenes

PLATE = """<mujoco><worldbody><body name="palm"><geom type="box" size=".05 .06 {half}" pos="0 0 {middle}"/>
  <body name="far" pos="0 0 -.3"><joint name="turn" axis="1 0 0"/><geom type="sphere" size=".02" pos="0 .2 0"/></body>
</body></worldbody></mujoco>"""
JOINTS = {"turn": 0.3}


@pytest.fixture
def plate(tmp_path):
    """A palm whose top is at height 0, and shapes that are larger than it by some [m]."""

    def made(larger):
        file = tmp_path / "plate.xml"
        file.write_text(PLATE.format(half=0.01 + larger, middle=-0.01))
        rig = Rig(hand=Hand.from_file(file, palm="palm"), fingers={})
        return HandOutside(rig, scenes.box(), 200)

    return made


def on_plate(surface, seed):
    """Contacts of a box that stands on the palm, and where it truly is."""
    T = se3.compose(np.eye(3), np.array([0.003, -0.002, scenes.BOX[2] / 2]))
    return scenes.touched(T, surface, (5e-4, np.deg2rad(2)), np.random.default_rng(seed)), T


def reconciled(hand, contacts, vision):
    """The answer before and after."""
    outside = hand.at(JOINTS)

    def solve(points):
        return corrected(*problem_of(scenes.box(), contacts, vision, points))

    first = solve(outside)
    return first, hand.reconciled(first, outside, solve)


def test_links_move_with_random_joint_errors_as_their_lever_arms_predict(box):
    surface = box.rig.hand.surface(100)
    joints, rng = dict(box.held[-1].joint_positions), np.random.default_rng(0)
    _, levers = surface.points_and_sensitivities(joints)
    still = surface.points_palm(joints)
    middles = [still[surface.body_of == k].mean(axis=0) for k in range(len(surface.bodies))]
    moved = np.zeros(len(middles))
    for _ in range(300):
        off = surface.points_palm({name: q + 1e-4 * rng.normal() for name, q in joints.items()})
        for k, middle in enumerate(middles):
            moved[k] += ((off[surface.body_of == k].mean(axis=0) - middle) ** 2).sum() / 3 / 300
    np.testing.assert_allclose(np.sqrt(moved) / 1e-4, levers, rtol=0.15, atol=1e-6)


@pytest.mark.parametrize("larger", [0.0, 0.005, 0.01])
def test_a_shape_larger_than_its_link_does_not_bias_the_pose(plate, larger):
    errors = []
    for seed in range(12):
        contacts, T = on_plate((scenes.BOX_POINTS, scenes.BOX_NORMALS), seed)
        vision = hs.PosePrior.from_sigmas(se3.compose(T[:3, :3], T[:3, 3] + [0.01, 0, 0.01]), 0.02, 0.1)
        _, estimate = reconciled(plate(larger), contacts, vision)
        assert estimate.consistent
        assert not estimate.outliers
        alone = hs.correct_pose(scenes.box(), contacts, vision=vision)
        errors.append(np.abs(estimate.T_palm_object[2, 3] - alone.T_palm_object[2, 3]))
    assert np.median(errors) < 0.001


def test_a_slide_that_only_the_hand_bounds_stays_before_the_hand(plate):
    """Along a slide that contacts leave open the palm alone keeps the box out, however deep vision has it.

    Likeliest at the palm; the mean is that of a Gaussian 30 mm behind it, of 30 mm, cut off there: 16 mm before it.
    """
    x, y, z = np.array(scenes.BOX) / 2
    points = np.array([[-0.01, y, 0.01], [0.012, y, 0.0], [0.0, -y, 0.005], [0.01, -y, -0.02]])
    normals = np.array([[0, 1.0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0]])
    for seed in range(8):
        contacts, T = on_plate((points, normals), seed)
        vision = hs.PosePrior.from_sigmas(se3.compose(T[:3, :3], T[:3, 3] - [0, 0, 0.03]), 0.03, 0.1)
        _, estimate = reconciled(plate(0.0), contacts, vision)
        alone = hs.correct_pose(scenes.box(), contacts, vision=vision)
        poses = alone.T_palm_object, estimate.T_palm_object_maximum, estimate.T_palm_object
        below, likeliest, mean = ((pose - T)[2, 3] for pose in poses)
        assert below < -0.02
        assert abs(likeliest) < 0.005
        assert mean == pytest.approx(-0.03 + 0.03 * norm.pdf(1) / norm.sf(1), abs=0.005)


def test_a_hand_without_shapes_and_an_open_object_keep_nothing_out(can, tmp_path):
    (tmp_path / "bare.xml").write_text('<mujoco><worldbody><body name="palm"/></worldbody></mujoco>')
    bare = Rig(hand=Hand.from_file(tmp_path / "bare.xml", palm="palm"), fingers={})
    assert HandOutside(bare, can.model, 200).links == ()
    assert HandOutside(can.rig, replace(can.model, closed=False), 200).links == ()
    assert "robot0:palm" in HandOutside(can.rig, can.model, 200).links
