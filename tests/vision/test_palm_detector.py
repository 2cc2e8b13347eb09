"""The hand that is seen says where the palm is in the camera, and nothing where it is not seen."""

import functools
import importlib
import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.vision import STRUCTURED_LIGHT, HandAppearance
from handsight.vision.palm.hand_in_image import HandInImage
from handsight.vision.palm.palm_detector import SEARCH_ROTATION, _shifts, _turns
from testbed.refusals import refused
from testbed.sight_scenes import SQUARE, WIDE, hand_scene, moved_palm, palm_error

if find_spec("gymnasium_robotics") is None:  # it is not imported: only its files are used
    pytest.skip("the Shadow hand's files come with handsight[sim]", allow_module_level=True)

from handsight.simulation import Scenario, rig_of

detect_palm = importlib.import_module("handsight.vision.palm.palm_detector")
ALLEGRO = (
    Path(os.environ.get("HANDSIGHT_DATA", "../shared/data")) / "hands/allegro_hand/allegro_hand_right.urdf"
)
DEFAULT = {"sigma_position": 0.025, "sigma_rotation": np.deg2rad(2.5)}


@functools.cache
def shadow():
    hand = rig_of(Scenario(object="can")).hand
    return hand, hand.shape(), HandAppearance.of(hand)


def clean(depth, _):
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32)


def scene(seed, hand_and_shape=None, *, held=True, noise=clean, sigma_joint=0.0):
    """A picture of a hand that holds a box, with its joints as they are believed to be."""
    hand, shape = hand_and_shape or shadow()[:2]
    box = hs.ObjectModel.box((0.05, 0.07, 0.12))
    rng = np.random.default_rng(seed)
    return hand_scene(
        hand, (shape, (box.vertices, box.faces), None), rng, held=held, noise=noise, sigma_joint=sigma_joint
    )


def off(hand, T, rng, length, angle):
    """A belief that is off by so much at the hand's middle."""
    shift, turn = palm_error(rng, length, angle)
    return moved_palm(T, shift + T[:3, :3] @ hand.middle - turn @ T[:3, :3] @ hand.middle, turn)


def away(hand, T, other):
    """Of the hand's middle [m], and the angle [rad]."""
    middles = [se3.apply(each, hand.middle[None])[0] for each in (T, other)]
    turn = np.linalg.norm(se3.rotation_log(T[:3, :3] @ other[:3, :3].T))
    return float(np.linalg.norm(middles[0] - middles[1])), float(turn)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_without_noise_the_truth_is_recovered(seed):
    picture = scene(seed, held=False)
    hand = shadow()[2].placed(picture.joints)
    believed = off(hand, picture.T_camera_palm, np.random.default_rng(seed), 0.04, np.deg2rad(4))
    seen = detect_palm.detect_palm(WIDE, picture.depth, hand, believed, **DEFAULT)
    assert seen
    shift, turn = away(hand, seen.T_camera_palm, picture.T_camera_palm)
    assert shift < 0.0005
    assert turn < np.deg2rad(0.5)
    assert np.linalg.eigvalsh(seen.covariance).min() > 0
    np.testing.assert_array_equal(seen.covariance, seen.covariance.T)


@pytest.mark.slow
def test_another_hand_is_detected_too():
    if not ALLEGRO.exists():
        pytest.skip(f"no {ALLEGRO}")
    names = (("first", "3.0"), ("middle", "7.0"), ("ring", "11.0"), ("thumb", "15.0"))
    tips = {finger: f"link_{name}_tip" for finger, name in names}
    hand = Hand.from_file(ALLEGRO, palm="palm", tips=tips)
    look, right = HandAppearance.of(hand), 0
    for seed in range(6):
        picture = scene(seed, (hand, hand.shape()))
        placed = look.placed(picture.joints)
        believed = off(placed, picture.T_camera_palm, np.random.default_rng(seed), 0.04, np.deg2rad(4))
        seen = detect_palm.detect_palm(WIDE, picture.depth, placed, believed, **DEFAULT)
        right += bool(seen) and away(placed, seen.T_camera_palm, picture.T_camera_palm)[0] < 0.002
    assert right >= 5


@settings(max_examples=30, deadline=None)
@given(st.floats(0.001, 0.15), st.floats(0.01, 0.5), st.integers(0, 2**32 - 1))
@example(0.021484375, 0.5, 101)
def test_whatever_a_belief_is_off_by_something_near_is_tried(reach, angle, seed):
    rng = np.random.default_rng(seed)
    shift, turn = palm_error(rng, reach * rng.random() ** (1 / 3), angle * rng.random() ** (1 / 3))
    tried = np.abs(_shifts(reach) - shift)
    assert (tried <= np.array([0.0125, 0.0125, 0.05]) + 1e-9).all(axis=1).any()
    turns = [np.linalg.norm(se3.rotation_log(each.T @ turn)) for each in _turns(angle, SEARCH_ROTATION)]
    assert min(turns) < np.deg2rad(12)


def believed(z=0.8):
    return se3.compose(se3.rotation_exp(np.array([0.4, 2.6, 0.3])), np.array([0.0, 0.0, z]))


@functools.cache
def open_hand():
    hand, _, look = shadow()
    return look.placed(dict.fromkeys(hand.joint_names, 0.1))


def asked(depth, T=None, **sigmas):
    T = believed() if T is None else T
    return detect_palm.detect_palm(WIDE, depth, open_hand(), T, **{**DEFAULT, **sigmas})


def test_a_hand_out_of_the_image_is_refused():
    depth = np.full((480, 640), 0.8, np.float32)
    for place in ([0, 0, -1.0], [3.0, 0, 0.8]):
        T = believed()
        T[:3, 3] = place
        refusal = asked(depth, T)
        assert not refusal
        assert refusal.reason == "outside"


@pytest.mark.parametrize("nothing", [np.nan, 0.0, np.inf, -1.0])
def test_an_image_without_depth_is_refused(nothing):
    refusal = asked(np.full((480, 640), nothing, np.float32))
    assert not refusal
    assert refusal.reason == "outside"


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.0])
def test_a_table_alone_is_no_hand(tilt):
    """Nor is it where it passes through the believed hand, at any height."""
    rng = np.random.default_rng(3)
    for distance in (0.7, 0.8, 0.9):
        corners = 2.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        T = se3.compose(se3.rotation_exp(np.array([tilt, 0, 0])), np.array([0, 0, distance]))
        depth = clean(WIDE.draw(se3.apply(T, corners), SQUARE).depth, None)
        depth = np.where(depth > 0, depth + 0.001 * rng.normal(size=depth.shape), 0).astype(np.float32)
        assert not asked(depth, sigma_position=0.06, sigma_rotation=0.1)


@pytest.mark.slow
def test_a_hand_that_is_far_away_is_refused():
    hand = open_hand()
    shape = shadow()[1]
    vertices = shape.vertices_palm(dict.fromkeys(shape.joints, 0.1))
    far = believed(6.0)
    depth = clean(WIDE.draw(se3.apply(far, vertices), shape.faces).depth, None)
    refusal = detect_palm.detect_palm(WIDE, depth, hand, far, **DEFAULT)
    assert not refusal


def test_a_wrong_pose_or_image_is_an_error():
    depth = np.ones((480, 640), np.float32)
    with refused(InvalidInput, "sigma_position"):
        asked(depth, sigma_position=0.0)
    with refused(InvalidInput, "depth"):
        asked(np.ones((240, 320), np.float32))


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_is_followed_from_where_it_was_to_where_a_search_has_it(seed):
    drawn = scene(seed)
    hand, T = shadow()[2].placed(drawn.joints), drawn.T_camera_palm
    near = off(hand, T, np.random.default_rng(seed), 0.006, np.deg2rad(2))
    followed = detect_palm.follow_palm(WIDE, drawn.depth, hand, near)
    searched = detect_palm.detect_palm(
        WIDE, drawn.depth, hand, near, sigma_position=0.01, sigma_rotation=0.03
    )
    assert followed
    assert searched
    shift, turn = away(hand, followed.T_camera_palm, searched.T_camera_palm)
    assert shift < 0.001
    assert turn < np.deg2rad(0.5)


def test_a_hand_that_is_no_longer_there_is_searched():
    drawn, rig = scene(0), rig_of(Scenario(object="can"))
    own, hand = HandInImage(rig), shadow()[2].placed(drawn.joints)
    gone = off(hand, drawn.T_camera_palm, np.random.default_rng(0), 0.06, np.deg2rad(3))
    refusal = detect_palm.follow_palm(WIDE, drawn.depth, hand, gone)
    assert not refusal
    assert refusal.reason == "no_fit"
    asked_for = WIDE, drawn.depth, drawn.joints, gone, (0.04, 0.05)
    found, searched = own.detected(*asked_for, follow=True), own.detected(*asked_for)
    assert found
    assert searched
    np.testing.assert_array_equal(found.T_camera_palm, searched.T_camera_palm)
    assert own.detected(WIDE, drawn.depth, None, gone, (0.04, 0.05), follow=True) is None


def test_a_hand_that_is_followed_out_of_the_image_is_refused():
    T = believed()
    T[:3, 3] = [3.0, 0, 0.8]
    assert detect_palm.follow_palm(WIDE, np.ones((480, 640), np.float32), open_hand(), T).reason == "outside"
    with refused(InvalidInput, "depth"):
        detect_palm.follow_palm(WIDE, np.ones((240, 320), np.float32), open_hand(), believed())


def test_a_noisier_camera_widens_the_covariance():
    drawn = scene(1)
    hand = shadow()[2].placed(drawn.joints)
    covariances = []
    for amount in (1.0, 3.0):
        noise = STRUCTURED_LIGHT.times(amount)
        seen = detect_palm.follow_palm(WIDE, drawn.depth, hand, drawn.T_camera_palm, noise=noise)
        assert seen
        covariances.append(seen.covariance)
    assert np.linalg.eigvalsh(covariances[1] - covariances[0]).min() > -1e-12
    assert np.trace(covariances[1][:3, :3]) > 2 * np.trace(covariances[0][:3, :3])


def test_joints_that_may_be_off_widen_the_covariance():
    hand, _, look = shadow()
    drawn = scene(1)
    one, other = (look.placed(drawn.joints, sigma_joint=sigma) for sigma in (0.0, np.deg2rad(2)))
    small = {"sigma_position": 0.005, "sigma_rotation": 0.02}
    seen = [
        detect_palm.detect_palm(WIDE, drawn.depth, each, drawn.T_camera_palm, **small)
        for each in (one, other)
    ]
    assert all(seen)
    wider = seen[1].covariance - seen[0].covariance
    assert np.linalg.eigvalsh(wider).min() > -1e-12
    assert np.trace(wider[:3, :3]) > 0
    assert len(hand.joint_names) >= 20
