"""The belief is a Gaussian over pose and vision's constant error, and every step of it is the law it claims to be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.rig import Table
from handsight.tracking.belief import Belief, begun, grown, positive
from handsight.tracking.gaps import gaps as gaps_plain
from handsight.tracking.table import on_table

SEEDS = st.integers(0, 2**32 - 1)


def some_belief(rng):
    root = rng.normal(size=(12, 12)) * 0.05
    error = np.concatenate([rng.normal(scale=0.05, size=3), rng.normal(scale=0.2, size=3)])
    T = se3.random(rng, spread=0.1)
    return Belief(T, error, root @ root.T + 1e-6 * np.eye(12), rng.normal(scale=0.3, size=3), T)


@given(SEEDS)
def test_what_vision_should_see_has_the_derivative_it_claims(seed):
    rng = np.random.default_rng(seed)
    belief, T_mount_palm = replace(some_belief(rng), error=np.zeros(6)), se3.random(rng, spread=0.5)
    H, _ = belief._sighting(np.eye(4), T_mount_palm)
    predicted = belief.displaced(T_mount_palm @ belief.T_palm_object)

    def sight(step):
        T, error = se3.moved(belief.T_palm_object, step[:6]), belief._error_after(step[6:])
        moved = replace(belief, T_palm_object=T, error=error)
        return se3.difference(moved.displaced(T_mount_palm @ T), predicted)

    h = 1e-6
    numeric = np.stack([(sight(h * e) - sight(-h * e)) / (2 * h) for e in np.eye(12)], axis=1)
    np.testing.assert_allclose(H, numeric, atol=1e-8)


@given(SEEDS)
def test_a_measurement_weighs_as_bayes_says(seed):
    """In information: P⁻¹ + Hᵀ R⁻¹ H."""
    rng = np.random.default_rng(seed)
    belief = some_belief(rng)
    H, R = rng.normal(size=(3, 12)), np.diag(rng.uniform(0.01, 1, 3))
    after = belief.measured(H, rng.normal(scale=0.01, size=3), R)
    expected = np.linalg.inv(np.linalg.inv(belief.covariance) + H.T @ np.linalg.inv(R) @ H)
    np.testing.assert_allclose(after.covariance, expected, atol=1e-9)


@given(SEEDS)
def test_touch_informs_the_error_as_a_measurement_of_the_pose_would(seed):
    rng = np.random.default_rng(seed)
    belief = some_belief(rng)
    R = np.diag(rng.uniform(1e-4, 1e-3, 6))
    residual = rng.normal(scale=1e-3, size=6)
    expected = belief.measured(np.eye(6, 12), residual, R)
    information = np.linalg.inv(belief.pose_covariance) + np.linalg.inv(R)
    touched = belief.with_touch(expected.T_palm_object, information)
    np.testing.assert_allclose(touched.covariance, expected.covariance, atol=1e-8)
    np.testing.assert_allclose(touched.error, expected.error, atol=1e-5)


@pytest.mark.parametrize("turn_deg", [0, 90])
def test_a_constant_error_comes_apart_from_the_pose_only_as_the_palm_turns(turn_deg):
    rng = np.random.default_rng(1)
    T_palm_object = se3.compose(np.eye(3), np.array([0.0, -0.09, 0.1]))
    error = np.array([0.06, -0.05, 0.0, 0.0, 0.0, 0.1])
    wide = np.diag([0.3**2] * 3 + [1.0] * 3)
    belief = begun(
        se3.moved(T_palm_object, np.array([0.05, 0.05, 0, 0, 0, 0])),
        wide,
        np.diag([0.05**2] * 3 + [0.1**2] * 3),
        np.zeros(3),
    )
    truth = replace(belief, T_palm_object=T_palm_object, error=error)
    noise = np.diag([0.002**2] * 3 + [0.02**2] * 3)
    for k in range(200):
        turn = np.array([0, 0, np.deg2rad(turn_deg) * k / 199])
        T_world_palm = se3.compose(se3.rotation_exp(turn), np.array([0.1, 0.2, 0.3]))
        seen = truth.displaced(T_world_palm @ T_palm_object)
        seen = se3.moved(seen, rng.normal(size=6) * np.sqrt(np.diag(noise)))
        belief = belief.seen(seen, noise, T_world_palm)
    off = np.linalg.norm((belief.T_palm_object @ np.linalg.inv(T_palm_object))[:3, 3][:2])
    said = np.sqrt(np.linalg.eigvalsh(belief.pose_covariance[:2, :2]).max())
    if turn_deg:
        assert said < 0.01
        assert off < 3 * said
        np.testing.assert_allclose(belief.error[:2], error[:2], atol=0.02)
    else:
        assert said > 0.04


@given(SEEDS)
def test_a_palm_that_goes_elsewhere_leaves_the_object_in_the_world(seed):
    rng = np.random.default_rng(seed)
    belief, T_old, T_new = some_belief(rng), se3.random(rng), se3.random(rng)
    carried = belief.carried(se3.inverse(T_new) @ T_old)
    np.testing.assert_allclose(T_new @ carried.T_palm_object, T_old @ belief.T_palm_object, atol=1e-12)
    for T, b in ((T_old, belief), (T_new, carried)):
        turned = se3.rotate_covariance(T[:3, :3], b.pose_covariance)
        if T is T_old:
            before = turned
    np.testing.assert_allclose(turned, before, atol=1e-12)


@given(SEEDS)
def test_a_walk_adds_to_the_covariance_though_it_is_told_as_information(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    information, variance = root @ root.T + 0.1 * np.eye(6), rng.uniform(0.01, 1, 6)
    expected = np.linalg.inv(np.linalg.inv(information) + np.diag(variance))
    np.testing.assert_allclose(grown(information, variance), expected, atol=1e-9)
    open_along = np.diag([1.0, 1, 1, 1, 1, 0])
    assert grown(open_along, variance)[5, 5] == 0
    np.testing.assert_array_equal(grown(information, np.zeros(6)), information)


def test_the_nearest_positive_information_leaves_a_positive_one_alone():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    np.testing.assert_allclose(positive(root @ root.T), root @ root.T, atol=1e-10)
    mixed = np.diag([4.0, 1, 1, -3, 1, 1])
    np.testing.assert_allclose(positive(mixed), np.diag([4.0, 1, 1, 0, 1, 1]), atol=1e-10)


BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])


@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0, np.pi / 2, 0]), np.array([np.pi, 0, 0])])
def test_a_table_fixes_height_and_tilt_of_whatever_side_is_down(turn):
    up = np.abs(se3.rotation_exp(turn)[2]).argmax()
    side = [0.03, 0.045, 0.07][up]
    table = Table(height=0.4)
    T_world_palm = se3.compose(se3.rotation_exp(np.array([0.3, -0.7, 1.0])), np.array([0.1, 0.0, 0.6]))
    T_world_true = se3.compose(se3.rotation_exp(turn), np.array([0.2, 0.1, 0.4 + side]))
    off = np.array([0.03, -0.02, 0.04, 0.05, -0.04, 0.2])
    T_believed = se3.inverse(T_world_palm) @ se3.moved(T_world_true, off)
    belief = begun(T_believed, np.diag([0.05**2] * 3 + [0.15**2] * 3), np.eye(6), np.zeros(3))
    after = on_table(belief, BOX, table, T_world_palm)
    delta = se3.difference(T_world_palm @ after.T_palm_object, T_world_true)
    np.testing.assert_allclose(delta[[2, 3, 4]], 0, atol=2e-3)
    np.testing.assert_allclose(delta[:2], off[:2], atol=2e-3)


def test_an_object_in_the_air_is_not_put_on_the_table():
    T = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.5]))
    belief = begun(T, np.diag([0.02**2] * 3 + [0.1**2] * 3), np.eye(6), np.zeros(3))
    assert on_table(belief, BOX, Table(height=0.0), np.eye(4)) is None


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_the_gap_between_tips_is_their_distance(seed):
    """Against a dense sampling of both surfaces, which can only be too far."""
    from handsight._kernels import tips

    rng = np.random.default_rng(seed)
    axes = rng.uniform(0.005, 0.015, size=(2, 3))
    Ts = se3.random(rng, 2, spread=0.015)
    fast, plain = tips.gaps(Ts, axes), gaps_plain(Ts, axes)
    np.testing.assert_allclose(fast, plain, atol=1e-12)
    u = rng.normal(size=(3000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    clouds = [se3.apply(T, u * a) for T, a in zip(Ts, axes, strict=True)]
    from scipy.spatial import cKDTree

    sampled = cKDTree(clouds[0]).query(clouds[1])[0].min()
    if fast[0] > 0:
        assert sampled - 1.5e-3 < fast[0] < sampled + 1e-9
    assert fast[0] == fast[1]


def test_a_tip_alone_is_near_none():
    from handsight._kernels import tips

    assert tips.gaps(np.eye(4)[None], np.full((1, 3), 0.01))[0] == np.inf
    assert gaps_plain(np.eye(4)[None], np.full((1, 3), 0.01))[0] == np.inf
