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
from scipy.ndimage import distance_transform_edt
from scipy.optimize import least_squares

import handsight as hs
from hand_scenes import CAMERA, SQUARE, error, hand_scene, moved
from handsight import se3
from handsight._kernels.image import depth_covariance, hand_term, palm_scan
from handsight._kernels.image.palm_scan import PALM_SCAN
from handsight._kernels.image.vision_records import DEPTH_ERROR, STAGE
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.vision import STRUCTURED_LIGHT, HandAppearance
from handsight.vision.candidates import candidates_at, poses_of
from handsight.vision.palm.hand_appearance import APPEARANCE
from handsight.vision.palm.hand_in_image import HandInImage
from handsight.vision.palm.palm_detector import PALM_SEARCH, Picture, _shifts, _turns, picture_of

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
    shift, turn = error(rng, length, angle)
    return moved(T, shift + T[:3, :3] @ hand.middle - turn @ T[:3, :3] @ hand.middle, turn)


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
    seen = detect_palm.detect_palm(CAMERA, picture.depth, hand, believed, **DEFAULT)
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
        seen = detect_palm.detect_palm(CAMERA, picture.depth, placed, believed, **DEFAULT)
        right += bool(seen) and away(placed, seen.T_camera_palm, picture.T_camera_palm)[0] < 0.002
    assert right >= 5


def plain_rows(picture: Picture, T, skin, bound):
    """What each point says, in NumPy: its weight, where the image has it, itself and its normal in the camera."""
    P, n = se3.apply(T, skin[0]), skin[1] @ T[:3, :3].T
    columns, rows = np.round(CAMERA.project(P)).astype(int).T
    z = picture.depth[rows, columns].astype(float)
    Q = np.c_[CAMERA.rays[rows, columns] * z[:, None], z]
    i, j = (
        np.floor((P[:, k] / P[:, 2] - picture.corner[k]) / picture.corner[2] + 0.5).astype(int)
        for k in (1, 0)
    )
    seen = picture.cells[i, j, 1:]
    alike = ~seen.any(axis=1) | ((seen * n).sum(axis=1) >= PALM_SCAN.normal_cosine)
    ratio = np.linalg.norm(Q - P, axis=1) / bound
    facing = -(n * P).sum(axis=1) > PALM_SCAN.facing_cosine * np.linalg.norm(P, axis=1)
    weight = np.where(facing & (z > 0) & (ratio < 1) & alike, (1 - np.minimum(ratio, 1) ** 2) ** 2, 0)
    return weight, Q, P, n


def laid(seed, bound=0.012):
    """A picture, the hand in it, the points that are seen, and the pose at which a descent on them ends."""
    drawn = scene(seed, held=False)
    hand = shadow()[2].placed(drawn.joints)
    picture = picture_of(CAMERA, drawn.depth, hand, drawn.T_camera_palm, (0.01, 0.01))
    skin = np.ascontiguousarray(hand.skin[:, hand.visible_from(CAMERA, drawn.T_camera_palm)])
    look = candidates_at(off(hand, drawn.T_camera_palm, np.random.default_rng(seed), 0.003, 0.01)[None])
    stages = np.array([(0, bound, bound, 60, 1)], dtype=STAGE)
    hand_term.refine_hand(CAMERA.record, picture.arrays, skin, hand.middle, hand.radius, stages, look)
    return picture, hand, skin, look


@pytest.mark.parametrize("seed", range(3))
def test_rows_are_the_derivative_of_the_residual(seed):
    picture, _, skin, look = laid(seed)
    T, rows = poses_of(look)[0], np.empty((skin.shape[1], 8))
    hand_term.rows_of(CAMERA.record, picture.arrays, skin, look["pose"].copy(), 0.012, rows)
    weight, Q, P, n = plain_rows(picture, T, skin, 0.012)
    # Where a pixel's border is met, rounding decides.
    same = np.abs(rows[:, 0] - weight) < 1e-9
    assert same.mean() > 0.99
    assert (weight > 0).sum() > 100
    counts = same & (weight > 0)
    np.testing.assert_allclose(rows[counts, 1], (n * (Q - P)).sum(axis=1)[counts], atol=1e-9)

    def residuals(xi):  # what is seen at a pixel, and the plane's direction, stay
        return (n * (Q - (P + xi[:3] + np.cross(xi[3:], P)))).sum(axis=1)

    steps = 1e-6 * np.eye(6)
    numeric = np.stack([(residuals(e) - residuals(-e)) / 2e-6 for e in steps], axis=1)
    np.testing.assert_allclose(-rows[:, 2:], numeric, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_a_descent_ends_where_the_plain_residual_is_least(seed):
    picture, hand, skin, look = laid(seed)
    T = poses_of(look)[0]
    weight, Q, P, n = plain_rows(picture, T, skin, 0.012)
    about = se3.apply(T, hand.middle[None])[0]

    def residuals(xi):
        turned = about + (P - about) @ se3.rotation_exp(xi[3:] / hand.radius).T + xi[:3]
        return np.sqrt(weight) * (n * (Q - turned)).sum(axis=1)

    least = least_squares(residuals, np.zeros(6))
    # Points come and go at pixels' borders, so that a descent does not come to rest altogether.
    assert np.abs(least.x).max() < 2e-4


@settings(max_examples=30, deadline=None)
@given(st.floats(0.001, 0.15), st.floats(0.01, 0.5), st.integers(0, 2**32 - 1))
@example(0.021484375, 0.5, 101)
def test_whatever_a_belief_is_off_by_something_near_is_tried(reach, angle, seed):
    rng = np.random.default_rng(seed)
    shift, turn = error(rng, reach * rng.random() ** (1 / 3), angle * rng.random() ** (1 / 3))
    tried = np.abs(_shifts(reach) - shift)
    assert (tried <= np.array([0.0125, 0.0125, 0.05]) + 1e-9).all(axis=1).any()
    turns = [np.linalg.norm(se3.rotation_log(each.T @ turn)) for each in _turns(angle, PALM_SEARCH.rotation)]
    assert min(turns) < np.deg2rad(12)


def believed(z=0.8):
    return se3.compose(se3.rotation_exp(np.array([0.4, 2.6, 0.3])), np.array([0.0, 0.0, z]))


@functools.cache
def open_hand():
    hand, _, look = shadow()
    return look.placed(dict.fromkeys(hand.joint_names, 0.1))


def asked(depth, T=None, **sigmas):
    T = believed() if T is None else T
    return detect_palm.detect_palm(CAMERA, depth, open_hand(), T, **{**DEFAULT, **sigmas})


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
        depth = clean(CAMERA.draw(se3.apply(T, corners), SQUARE).depth, None)
        depth = np.where(depth > 0, depth + 0.001 * rng.normal(size=depth.shape), 0).astype(np.float32)
        assert not asked(depth, sigma_position=0.06, sigma_rotation=0.1)


@pytest.mark.slow
def test_a_hand_that_is_far_away_is_refused():
    hand = open_hand()
    shape = shadow()[1]
    vertices = shape.vertices_palm(dict.fromkeys(shape.joints, 0.1))
    far = believed(6.0)
    depth = clean(CAMERA.draw(se3.apply(far, vertices), shape.faces).depth, None)
    refusal = detect_palm.detect_palm(CAMERA, depth, hand, far, **DEFAULT)
    assert not refusal


def test_a_wrong_pose_or_image_is_an_error():
    depth = np.ones((480, 640), np.float32)
    with pytest.raises(InvalidInput, match="sigma_position: expected a number above 0, got 0"):
        asked(depth, sigma_position=0.0)
    with pytest.raises(InvalidInput, match="depth: expected 640 x 480 pixels, got 320 x 240"):
        asked(np.ones((240, 320), np.float32))


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_is_followed_from_where_it_was_to_where_a_search_has_it(seed):
    drawn = scene(seed)
    hand, T = shadow()[2].placed(drawn.joints), drawn.T_camera_palm
    near = off(hand, T, np.random.default_rng(seed), 0.006, np.deg2rad(2))
    followed = detect_palm.follow_palm(CAMERA, drawn.depth, hand, near)
    searched = detect_palm.detect_palm(
        CAMERA, drawn.depth, hand, near, sigma_position=0.01, sigma_rotation=0.03
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
    refusal = detect_palm.follow_palm(CAMERA, drawn.depth, hand, gone)
    assert not refusal
    assert refusal.reason == "no_fit"
    asked_for = CAMERA, drawn.depth, drawn.joints, gone, (0.04, 0.05)
    found, searched = own.detected(*asked_for, follow=True), own.detected(*asked_for)
    assert found
    assert searched
    np.testing.assert_array_equal(found.T_camera_palm, searched.T_camera_palm)
    assert own.detected(CAMERA, drawn.depth, None, gone, (0.04, 0.05), follow=True) is None


def test_a_hand_that_is_followed_out_of_the_image_is_refused():
    T = believed()
    T[:3, 3] = [3.0, 0, 0.8]
    assert (
        detect_palm.follow_palm(CAMERA, np.ones((480, 640), np.float32), open_hand(), T).reason == "outside"
    )
    with pytest.raises(InvalidInput, match="depth: expected 640 x 480 pixels, got 320 x 240"):
        detect_palm.follow_palm(CAMERA, np.ones((240, 320), np.float32), open_hand(), believed())


def test_points_beside_a_hand_are_in_the_air_off_its_outline():
    hand, T = open_hand(), believed()
    shape = shadow()[1]
    drawn = CAMERA.draw(
        se3.apply(T, shape.vertices_palm(dict.fromkeys(shape.joints, 0.1))), shape.faces
    ).depth
    air = se3.apply(T, hand.beside(CAMERA, T, 60))
    assert len(air) == 60
    columns, rows = np.round(CAMERA.project(air)).astype(int).T
    apart = distance_transform_edt(~np.isfinite(drawn))[rows, columns] * air[:, 2] / CAMERA.matrix[0, 0]
    # A drawn pixel of a quarter of the size is 4 wide.
    pixel = 4 * air[:, 2] / CAMERA.matrix[0, 0]
    assert (apart > APPEARANCE.beside - 2 * pixel).all()
    assert (apart < np.sqrt(2) * (APPEARANCE.beside + pixel)).all()


def test_what_goes_on_beside_a_hand_speaks_against_it_in_a_scan_and_what_is_behind_does_not():
    """One point on a plane and eight beside it: agreement, unless the plane goes on there."""
    cells = np.zeros((9, 9, 4), dtype=np.float32)
    cells[..., 3] = -1.0
    corner = np.array([-0.4, -0.4, 0.1])
    on = np.tile([0.0, 0.0, 0.0], (12, 1))
    air = np.array([[0.1 * i, 0.1 * j, 0.0] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
    hand = np.stack([np.concatenate([on, air]), np.concatenate([on - [0, 0, 1.0], 0 * air])])
    scores = []
    for behind in (0.0, 0.5, -0.5):
        cells[..., 0] = 1.0 + behind
        cells[4, 4, 0] = 1.0
        found = np.empty((1, 1, 2))
        palm_scan.scan(cells, corner, 0.01, hand, np.array([[0.0, 0, 1]]), np.eye(3)[None], found)
        scores.append(found[0, 0, 0] * (len(on) + palm_scan.PALM_SCAN.visible_slack))
    np.testing.assert_allclose(
        scores, [len(on) - palm_scan.PALM_SCAN.beside_weight * len(air), len(on), len(on)]
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_points_inform_and_pull_as_their_shared_errors_say(seed, count):
    """The plain sums over all points, and over all pairs."""
    rng = np.random.default_rng(seed)
    slopes, z, weights = 0.02 * rng.normal(size=(count, 2)), rng.uniform(0.4, 0.6, count), rng.random(count)
    points, normals = np.c_[slopes * z[:, None], z], rng.normal(size=(count, 3))
    own, near, smooth, constant = rng.random(4)
    error, center, radius = (
        np.array([(own, near, smooth, constant, 1e4, 1e2, 0, 0, 0, 0)], DEPTH_ERROR),
        rng.random(3),
        0.1,
    )
    found = np.empty((2, 6, 6))
    depth_covariance.inform_points(weights, points, normals, center, radius, error, count, found)
    levers = np.hstack([normals, np.cross((points - center) / radius, normals)])
    pulls = (weights * (normals * points).sum(axis=1) / z)[:, None] * levers
    A, S = levers.T @ (weights[:, None] * levers), np.zeros((6, 6))
    for i in range(count):
        for j in range(count):
            apart = ((slopes[i] - slopes[j]) ** 2).sum()
            shared = near * np.exp(-1e4 * apart) + smooth * np.exp(-1e2 * apart) + constant
            S += (shared + own * (i == j)) * np.outer(pulls[i], pulls[j])
    for kind, expected in zip(found, (A, S), strict=True):
        np.testing.assert_allclose(kind, expected, atol=1e-9 * np.trace(expected))


def test_a_noisier_camera_widens_the_covariance():
    drawn = scene(1)
    hand = shadow()[2].placed(drawn.joints)
    covariances = []
    for amount in (1.0, 3.0):
        noise = STRUCTURED_LIGHT.times(amount)
        seen = detect_palm.follow_palm(CAMERA, drawn.depth, hand, drawn.T_camera_palm, noise=noise)
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
        detect_palm.detect_palm(CAMERA, drawn.depth, each, drawn.T_camera_palm, **small)
        for each in (one, other)
    ]
    assert all(seen)
    wider = seen[1].covariance - seen[0].covariance
    assert np.linalg.eigvalsh(wider).min() > -1e-12
    assert np.trace(wider[:3, :3]) > 0
    assert len(hand.joint_names) >= 20


def test_an_outline_goes_on_in_a_wall_and_ends_in_the_air():
    hand, T = open_hand(), believed()
    shape = shadow()[1]
    drawn = CAMERA.draw(
        se3.apply(T, shape.vertices_palm(dict.fromkeys(shape.joints, 0.1))), shape.faces
    ).depth
    there = np.isfinite(drawn)
    air = np.where(there, drawn, 1.5).astype(np.float32)
    nearest = distance_transform_edt(~there, return_distances=False, return_indices=True)
    wall = drawn[tuple(nearest)].astype(np.float32)
    assert hand.outline_continued(CAMERA, air, T) < detect_palm.DETECTOR.max_continued
    assert hand.outline_continued(CAMERA, wall, T) > detect_palm.DETECTOR.max_continued
    assert hand.outline_continued(CAMERA, np.zeros_like(air), T) == 1.0
