"""The belief is a Gaussian over pose and vision's constant error, and every step of it is the law it claims to be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.rig import Table
from handsight.tracking.belief import MOST_SIGHTS, Belief, Joint, displaced, grown, positive
from handsight.tracking.table import on_table

SEEDS = st.integers(0, 2**32 - 1)
SIGHT_SIGMAS = np.array([0.005] * 3 + [0.05] * 3)
ERROR_SIGMAS = np.array([0.05] * 3 + [0.1] * 3)
WIDE = np.diag([0.3**2] * 3 + [1.0] * 3)


def some_joint(rng):
    root = rng.normal(size=(12, 12)) * 0.05
    error = np.concatenate([rng.normal(scale=0.05, size=3), rng.normal(scale=0.2, size=3)])
    return Joint(se3.random(rng, spread=0.1), error, root @ root.T + 1e-6 * np.eye(12))


@given(SEEDS)
def test_what_vision_should_see_has_the_derivative_it_claims(seed):
    rng = np.random.default_rng(seed)
    joint, Ts = some_joint(rng), se3.random(rng, 2, spread=0.5)
    belief = Belief(joint, joint, rng.normal(scale=0.3, size=3))
    H, _ = belief._sighting(joint, Ts, Ts)
    expected = displaced(joint.error, belief.pivot, Ts @ joint.T_palm_object)

    def sight(step):
        moved = joint.moved(step)
        return se3.difference(displaced(moved.error, belief.pivot, Ts @ moved.T_palm_object), expected)

    h = 1e-6
    numeric = np.stack([(sight(h * e) - sight(-h * e)) / (2 * h) for e in np.eye(12)], axis=2)
    np.testing.assert_allclose(H, numeric, atol=1e-8)


@given(SEEDS)
def test_a_step_leads_from_one_belief_to_another_and_back(seed):
    rng = np.random.default_rng(seed)
    joint, step = some_joint(rng), rng.normal(scale=0.3, size=12)
    np.testing.assert_allclose(joint.moved(step).less(joint), step, atol=1e-9)


@given(SEEDS)
def test_a_measurement_weighs_as_bayes_says(seed):
    """In information: P⁻¹ + Hᵀ R⁻¹ H."""
    rng = np.random.default_rng(seed)
    joint = some_joint(rng)
    H, R = rng.normal(size=(3, 12)), np.diag(rng.uniform(0.01, 1, 3))
    after = joint.measured(H, rng.normal(scale=0.01, size=3), R)
    expected = np.linalg.inv(np.linalg.inv(joint.covariance) + H.T @ np.linalg.inv(R) @ H)
    np.testing.assert_allclose(after.covariance, expected, atol=1e-9)


@given(SEEDS)
def test_touch_informs_the_error_as_a_measurement_of_the_pose_would(seed):
    rng = np.random.default_rng(seed)
    joint = some_joint(rng)
    R = np.diag(rng.uniform(1e-4, 1e-3, 6))
    expected = joint.measured(np.eye(6, 12), rng.normal(scale=1e-3, size=6), R)
    information = np.linalg.inv(joint.covariance[:6, :6]) + np.linalg.inv(R)
    touched = joint.touched(expected.T_palm_object, information)
    np.testing.assert_allclose(touched.covariance, expected.covariance, atol=1e-8)
    np.testing.assert_allclose(touched.error, expected.error, atol=1e-5)


@given(SEEDS)
def test_one_sight_is_worth_a_measurement(seed):
    """Near the truth, where all is linear, solving for the sights is Kalman's update."""
    rng = np.random.default_rng(seed)
    joint = replace(some_joint(rng), covariance=np.diag([1e-6] * 12))
    belief = Belief(joint, joint, np.zeros(3))
    T, noise = se3.random(rng, spread=0.3), np.diag([1e-6] * 3 + [1e-6] * 3)
    seen = se3.moved(belief.expected(T), rng.normal(scale=1e-3, size=6))
    after = belief.seen(seen, noise, T).now
    H, residual = belief._sighting(joint, T[None], seen[None])
    expected = joint.measured(H[0], residual[0], noise)
    np.testing.assert_allclose(after.covariance, expected.covariance, atol=2e-8)
    np.testing.assert_allclose(after.less(expected), 0, atol=1e-5)


def turned_belief(seed, turn, sights=60):
    """A belief after sights from a palm that goes 20 cm and turns so far about the vertical, and the truth."""
    rng = np.random.default_rng(seed)
    T_palm_object = se3.compose(se3.rotation_exp(rng.normal(size=3)), np.array([0.0, -0.09, 0.1]))
    error, belief, pivot = rng.normal(size=6) * ERROR_SIGMAS, None, None
    for part in np.linspace(0, 1, sights):
        R = se3.rotation_exp(np.array([0, 0, turn * part]))
        T = se3.compose(R, np.array([0.1 + 0.2 * part, 0.2, 0.3]))
        true = T @ T_palm_object
        pivot = true[:3, 3] if pivot is None else pivot
        seen = se3.moved(displaced(error, pivot, true), rng.normal(size=6) * SIGHT_SIGMAS)
        if belief is None:
            belief = Belief.begun(se3.inverse(T) @ seen, WIDE, np.diag(ERROR_SIGMAS**2), seen[:3, 3])
        belief = belief.seen(seen, np.diag(SIGHT_SIGMAS**2), T)
    return belief, T_palm_object


@pytest.mark.parametrize("turn", [0, np.pi / 3, np.pi / 2])
def test_pose_and_constant_error_come_apart_just_as_far_as_the_palm_turns(turn):
    """The mean of χ² over 20 worlds of six numbers each is 6 ± 0.8: 3.6 to 8.4 is three of that."""
    chi2, across = [], []
    for seed in range(20):
        belief, T_true = turned_belief(seed, turn)
        off, C = se3.difference(belief.T_palm_object, T_true), belief.pose_covariance
        chi2.append(off @ np.linalg.solve(C, off))
        across.append(np.sqrt(np.linalg.eigvalsh(C[:2, :2]).max()))
    assert 3.6 < np.mean(chi2) < 8.4
    if turn:
        assert np.mean(across) < 0.02
    else:
        assert np.mean(across) > 0.045


def test_many_sights_are_kept_as_few():
    still, _ = turned_belief(0, 0.0, sights=5)
    many, _ = turned_belief(0, np.pi, sights=300)
    assert len(many.sights) == MOST_SIGHTS
    T = still.sights.Ts_mount_palm[-1]
    again = still.seen(still.expected(T), np.diag(SIGHT_SIGMAS**2), T)
    assert len(again.sights) == len(still.sights)
    merged = again.sights.covariances[-1]
    np.testing.assert_allclose(merged, np.diag(SIGHT_SIGMAS**2) / 2, atol=1e-12)


def test_old_sights_say_less_of_an_object_that_creeps():
    belief, _ = turned_belief(1, np.pi / 2)
    crept = belief.walked(np.array([0.02**2] * 3 + [0.1**2] * 3))
    T = belief.sights.Ts_mount_palm[-1]
    seen = se3.moved(belief.expected(T), np.array([0.0, 0, 0.05, 0, 0, 0]))
    both = [b.seen(seen, np.diag(SIGHT_SIGMAS**2), T) for b in (belief, crept)]
    moved = [np.linalg.norm((b.T_palm_object - belief.T_palm_object)[:3, 3]) for b in both]
    assert moved[1] > 1.5 * moved[0]


def test_a_sight_that_cannot_be_true_surprises():
    belief, T_true = turned_belief(2, np.pi / 2)
    T = belief.sights.Ts_mount_palm[-1]
    noise = np.diag(SIGHT_SIGMAS**2)
    assert belief.surprise(belief.expected(T), noise, T) == pytest.approx(0, abs=1e-9)
    assert belief.surprise(se3.moved(belief.expected(T), np.array([0.3, 0, 0, 0, 0, 0])), noise, T) > 100


@given(SEEDS)
def test_a_palm_that_goes_elsewhere_leaves_the_object_in_the_world(seed):
    rng = np.random.default_rng(seed)
    belief, _ = turned_belief(seed % 7, 0.5, sights=4)
    T_old, T_new = se3.random(rng), se3.random(rng)
    carried = belief.carried(se3.inverse(T_new) @ T_old)
    np.testing.assert_allclose(T_new @ carried.T_palm_object, T_old @ belief.T_palm_object, atol=1e-12)
    world = [
        se3.rotate_covariance(T[:3, :3], b.pose_covariance) for T, b in ((T_old, belief), (T_new, carried))
    ]
    np.testing.assert_allclose(*world, atol=1e-12)
    assert len(carried.sights) == len(belief.sights)
    for before, after in zip(belief.sights.Ts_mount_palm, carried.sights.Ts_mount_palm, strict=True):
        expected = [b.expected(T) for b, T in ((belief, before), (carried, after))]
        np.testing.assert_allclose(*expected, atol=1e-9)


@given(SEEDS)
def test_a_walk_adds_to_the_covariance_though_it_is_told_as_information(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    information, variance = root @ root.T + 0.1 * np.eye(6), rng.uniform(0.01, 1, 6)
    expected = np.linalg.inv(np.linalg.inv(information) + np.diag(variance))
    np.testing.assert_allclose(grown(information, variance), expected, atol=1e-9)
    assert grown(np.diag([1.0, 1, 1, 1, 1, 0]), variance)[5, 5] == 0
    np.testing.assert_array_equal(grown(information, np.zeros(6)), information)


def test_the_nearest_positive_information_leaves_a_positive_one_alone():
    root = np.random.default_rng(0).normal(size=(6, 6))
    np.testing.assert_allclose(positive(root @ root.T), root @ root.T, atol=1e-10)
    mixed = np.diag([4.0, 1, 1, -3, 1, 1])
    np.testing.assert_allclose(positive(mixed), np.diag([4.0, 1, 1, 0, 1, 1]), atol=1e-10)


BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])


@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0, np.pi / 2, 0]), np.array([np.pi, 0, 0])])
def test_a_table_fixes_height_and_tilt_of_whatever_side_is_down(turn):
    side = [0.03, 0.045, 0.07][np.abs(se3.rotation_exp(turn)[2]).argmax()]
    table = Table(height=0.4)
    T_world_palm = se3.compose(se3.rotation_exp(np.array([0.3, -0.7, 1.0])), np.array([0.1, 0.0, 0.6]))
    T_world_true = se3.compose(se3.rotation_exp(turn), np.array([0.2, 0.1, 0.4 + side]))
    off = np.array([0.03, -0.02, 0.04, 0.05, -0.04, 0.2])
    T_believed = se3.inverse(T_world_palm) @ se3.moved(T_world_true, off)
    belief = Belief.begun(T_believed, np.diag([0.05**2] * 3 + [0.15**2] * 3), np.eye(6), np.zeros(3))
    after = on_table(belief.now, BOX, table, T_world_palm)
    delta = se3.difference(T_world_palm @ after.T_palm_object, T_world_true)
    np.testing.assert_allclose(delta[[2, 3, 4]], 0, atol=4e-3)
    np.testing.assert_allclose(delta[:2], off[:2], atol=2e-3)


def test_an_object_in_the_air_is_not_put_on_the_table():
    T = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.5]))
    belief = Belief.begun(T, np.diag([0.02**2] * 3 + [0.1**2] * 3), np.eye(6), np.zeros(3))
    assert on_table(belief.now, BOX, Table(height=0.0), np.eye(4)) is None
