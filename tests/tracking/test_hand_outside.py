"""The hand's links bound the object, within the errors of their joints; shapes larger than the hand are noticed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import handsight as hs
import scenes
from handsight import se3
from handsight.correction.correct import corrected, problem_of
from handsight.correction.problem import finished
from handsight.hand import Hand
from handsight.rig import Rig
from handsight.tracking import Tracker
from handsight.tracking.hand_outside import HAND_OUTSIDE, HandOutside, LinkMargins

PLATE = """<mujoco><worldbody><body name="palm"><geom type="box" size=".05 .06 {half}" pos="0 0 {middle}"/>
  <body name="far" pos="0 0 -.3"><joint name="turn" axis="1 0 0"/><geom type="sphere" size=".02" pos="0 .2 0"/></body>
</body></worldbody></mujoco>"""
SHRINK = 0.0015
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


def reconciled(hand, contacts, vision, margins=None):
    """The answer before and after, and the links inside."""
    outside = hand.at(JOINTS, margins or LinkMargins())

    def solve(points):
        return corrected(*problem_of(scenes.box(), contacts, vision, points))

    first = finished(solve(outside))
    return first, *finished(hand.reconciled(first, outside, solve))


@pytest.mark.parametrize("larger", [0.0, 0.002, 0.01])
def test_a_links_sigma_is_that_of_its_joints_and_its_skin(plate, larger):
    hand = plate(larger)
    outside = hand.at(JOINTS, LinkMargins())
    assert hand.links == ("palm", "far")
    rig_sigma = np.hypot(np.deg2rad(1.0), np.deg2rad(0.1))
    sigmas = dict(zip(outside.links.tolist(), outside.sigmas.tolist(), strict=True))
    # The palm hangs on no joint; the sphere on a lever of 0.2 m, which moves along one of three axes.
    assert sigmas[0] == pytest.approx(HAND_OUTSIDE.sigma_surface)
    assert sigmas[1] == pytest.approx(
        np.hypot(HAND_OUTSIDE.sigma_surface, 0.2 * rig_sigma / np.sqrt(3)), rel=0.02
    )


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
    noted, errors = [], []
    for seed in range(12):
        contacts, T = on_plate((scenes.BOX_POINTS, scenes.BOX_NORMALS), seed)
        vision = hs.PosePrior.from_sigmas(se3.compose(T[:3, :3], T[:3, 3] + [0.01, 0, 0.01]), 0.02, 0.1)
        _, estimate, inside = reconciled(plate(larger), contacts, vision)
        assert estimate.consistent
        assert not estimate.outliers
        alone = hs.correct_pose(scenes.box(), contacts, vision=vision)
        errors.append(np.abs(estimate.T_palm_object[2, 3] - alone.T_palm_object[2, 3]))
        noted += [inside["palm"]] if inside else []
        assert set(inside) <= {"palm"}
    if larger < 0.004:
        assert not noted
    if larger > 0.008:
        assert len(noted) == 12
        # Points lie a little within a shape; that deep they are inside what contacts say.
        np.testing.assert_allclose(noted, larger - SHRINK, atol=0.0015)
    assert np.median(errors) < 0.001


def test_a_known_margin_is_subtracted_from_the_shape(plate):
    hand, margins = plate(0.01), LinkMargins()
    contacts, T = on_plate((scenes.BOX_POINTS, scenes.BOX_NORMALS), 0)
    vision = hs.PosePrior.from_sigmas(T, 0.02, 0.1)
    for k in range(HAND_OUTSIDE.min_notes):
        assert not margins.known
        _, _, inside = reconciled(hand, contacts, vision, margins)
        margins = margins.noted(inside, stamp=k * HAND_OUTSIDE.note_period)
    assert margins.known["palm"] == pytest.approx(0.01 - SHRINK, abs=0.0015)
    before, after, inside = reconciled(hand, contacts, vision, margins)
    assert not inside
    np.testing.assert_array_equal(after.T_palm_object, before.T_palm_object)
    alone = hs.correct_pose(scenes.box(), contacts, vision=vision)
    np.testing.assert_allclose(after.T_palm_object[:3, 3], alone.T_palm_object[:3, 3], atol=5e-4)


def test_a_slide_that_only_the_hand_bounds_makes_no_margin(plate):
    """Along a slide that contacts leave open the palm alone keeps the box out, however deep vision has it.

    Likeliest at the palm; the mean is that of a Gaussian 30 mm behind it, of 30 mm, cut off there: 16 mm before it.
    """
    x, y, z = np.array(scenes.BOX) / 2
    points = np.array([[-0.01, y, 0.01], [0.012, y, 0.0], [0.0, -y, 0.005], [0.01, -y, -0.02]])
    normals = np.array([[0, 1.0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0]])
    for seed in range(8):
        contacts, T = on_plate((points, normals), seed)
        vision = hs.PosePrior.from_sigmas(se3.compose(T[:3, :3], T[:3, 3] - [0, 0, 0.03]), 0.03, 0.1)
        _, estimate, inside = reconciled(plate(0.0), contacts, vision)
        assert not inside
        alone = hs.correct_pose(scenes.box(), contacts, vision=vision)
        poses = alone.T_palm_object, estimate.T_palm_object_maximum, estimate.T_palm_object
        below, likeliest, mean = ((pose - T)[2, 3] for pose in poses)
        assert below < -0.02
        assert abs(likeliest) < 0.005
        assert mean == pytest.approx(-0.03 + 0.03 * norm.pdf(1) / norm.sf(1), abs=0.005)


def test_one_bad_pose_makes_no_margin():
    margins = LinkMargins()
    for k in range(100):  # at a hundred corrections a second
        margins = margins.noted({"palm": 0.012}, stamp=1.0 + 0.001 * k)
    assert not margins.known
    for k in range(2 * HAND_OUTSIDE.min_notes):
        margins = margins.noted({"palm": 0.006}, stamp=2.0 + HAND_OUTSIDE.note_period * k)
    assert margins.known == {"palm": 0.006}
    assert margins.noted({}, stamp=9.0) is margins


def test_a_good_hand_has_no_margins_and_a_hand_without_shapes_keeps_nothing_out(can, tmp_path):
    tracker = Tracker(can.rig, can.model)
    for seen in can.observations:
        tracker.update(seen)
    assert "robot0:palm" in tracker.links
    assert not tracker.link_margins
    (tmp_path / "bare.xml").write_text('<mujoco><worldbody><body name="palm"/></worldbody></mujoco>')
    bare = Rig(hand=Hand.from_file(tmp_path / "bare.xml", palm="palm"), fingers={})
    assert Tracker(bare, can.model).links == ()
    flat = replace(can.model, closed=False)
    assert Tracker(can.rig, flat).links == ()
