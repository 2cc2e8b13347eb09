"""The smoother is a Gaussian over pose and vision's constant bias; each of its steps is compared with its equation."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.gaussian_pose import GaussianPose
from handsight.tracking.smoother import Motion, PoseBiasSmoother
from oracles import pose_bias as oracle

SEEDS = st.integers(0, 2**32 - 1)
VISION_SIGMAS = np.array([0.005] * 3 + [0.05] * 3)
NOISE = np.diag(VISION_SIGMAS**2)
BIAS_SIGMAS = np.array([0.05] * 3 + [0.1] * 3)
WIDE = np.diag([0.3**2] * 3 + [1.0] * 3)


@cache
def turned(seed, turn, measurements=30, drift=None, period=0.1):
    """A smoother after a palm that went 20 cm and turned so far about the vertical, and the object's true pose.

    Vision has a `drift` (position's and rotation's variance, time); None: none, and the smoother assumes none.
    """
    rng = np.random.default_rng(seed)
    T_palm_object = se3.compose(se3.rotation_exp(rng.normal(size=3)), np.array([0.0, -0.09, 0.1]))
    bias, smoother, pivot = se3.moved(np.eye(4), rng.normal(size=6) * BIAS_SIGMAS), None, None
    sigmas = np.zeros(6) if drift is None else np.sqrt(np.repeat(drift[:2], 3))
    now, left = rng.normal(size=6) * sigmas, 0.0 if drift is None else np.exp(-period / drift[2])
    given_ = () if drift is None else (np.array(drift),)
    for part in np.linspace(0, 1, measurements):
        R = se3.rotation_exp(np.array([0, 0, turn * part]))
        T = se3.compose(R, np.array([0.1 + 0.2 * part, 0.2, 0.3]))
        true = T @ T_palm_object
        pivot = true[:3, 3] if pivot is None else pivot
        measured = se3.moved(oracle.biased(true, bias, pivot), rng.normal(size=6) * VISION_SIGMAS + now)
        now = left * now + np.sqrt(1 - left**2) * sigmas * rng.normal(size=6)
        if smoother is None:
            start = se3.inverse(T) @ measured
            bias_covariance = np.diag(BIAS_SIGMAS**2)
            smoother = PoseBiasSmoother.from_prior(start, WIDE, bias_covariance, measured[:3, 3], *given_)
        smoother = smoother.inflated(np.zeros(6), period).updated(GaussianPose(measured, NOISE), T)
    return smoother, T_palm_object


@pytest.mark.parametrize("turn", [0, np.pi / 3, np.pi / 2])
def test_pose_and_bias_can_be_told_apart_only_if_the_palm_turns(turn):
    """The mean of χ² over 20 worlds of six numbers each is 6 ± 0.8: 3.6 to 8.4 is three of that."""
    chi2, across = [], []
    for seed in range(20):
        smoother, T_true = turned(seed, turn)
        now = smoother.now
        off, C = se3.difference(now.T_palm_object, T_true), now.covariance[:6, :6]
        chi2.append(off @ np.linalg.solve(C, off))
        across.append(np.sqrt(np.linalg.eigvalsh(C[:2, :2]).max()))
    assert 3.6 < np.mean(chi2) < 8.4
    if turn:
        assert np.mean(across) < 0.02
    else:
        assert np.mean(across) > 0.045


DRIFT = (0.01**2, 0.1**2, 2.0)


def test_a_drift_of_vision_is_in_the_pose_s_covariance():
    """As above: 3.6 to 8.4. Taken for independent, the measurements promise four times the information."""
    chi2 = []
    for seed in range(20):
        now, T_true = (
            (smoother := turned(seed, np.pi / 2, 60, DRIFT)[0]).now,
            turned(seed, np.pi / 2, 60, DRIFT)[1],
        )
        off = se3.difference(now.T_palm_object, T_true)
        chi2.append(off @ np.linalg.solve(now.covariance[:6, :6], off))
    assert 3.6 < np.mean(chi2) < 8.4
    independent = turned(0, np.pi / 2, 60)[0].now.covariance
    assert (
        np.linalg.eigvalsh(smoother.now.covariance[:3, :3])[0]
        > 4 * np.linalg.eigvalsh(independent[:3, :3])[0]
    )


@pytest.mark.parametrize("count", [1, 10, 100, 300])
def test_more_measurements_from_one_palm_are_as_certain_as_their_drift_allows(count):
    """Their variance is 5 % below the optimum's at most, which has the full exponential covariance, and a fifth above."""
    T, tiny = np.eye(4), np.diag([1e-12] * 6)
    smoother = PoseBiasSmoother.from_prior(T, WIDE, tiny, np.zeros(3), np.array(DRIFT))
    for _ in range(count):
        smoother = smoother.inflated(np.zeros(6), 0.1).updated(GaussianPose(T, NOISE), T)
    t = 0.1 * np.arange(count)
    C = DRIFT[0] * np.exp(-np.abs(t[:, None] - t) / DRIFT[2]) + NOISE[0, 0] * np.eye(count)
    optimum = 1 / (np.linalg.inv(C).sum() + 1 / WIDE[0, 0])
    assert 0.95 * optimum < smoother.now.covariance[0, 0] < 1.2 * optimum


def test_the_latency_of_vision_is_estimated_while_the_palm_moves():
    """The palm of each measurement is that of the latency estimated before, as a tracker takes it from its history."""
    scores = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        axis, T_palm_object = rng.normal(size=3), se3.compose(np.eye(3), np.array([0.0, -0.09, 0.1]))

        def palm(t, axis=axis):
            return se3.compose(
                se3.rotation_exp(0.5 * np.sin(t) * axis), np.array([0.1 * np.sin(1.3 * t), 0.1 * t, 0])
            )

        start = palm(0) @ T_palm_object
        bias = se3.moved(np.eye(4), rng.normal(size=6) * BIAS_SIGMAS)
        smoother = PoseBiasSmoother.from_prior(
            T_palm_object,
            WIDE,
            np.diag(BIAS_SIGMAS**2),
            start[:3, 3],
            np.array([0.005**2, 0.05**2, 5.0]),
            (0.0, 0.1),
        )
        for t in 0.1 * np.arange(80):
            true = oracle.biased(palm(t - 0.2) @ T_palm_object, bias, start[:3, 3])
            measured = GaussianPose(se3.moved(true, rng.normal(size=6) * VISION_SIGMAS), NOISE)
            then = t - smoother.latency
            twist = se3.difference(palm(then + 0.01), palm(then - 0.01)) / 0.02
            motion = Motion(twist, smoother.latency)
            smoother = smoother.inflated(np.zeros(6), 0.1).updated(measured, palm(then), motion)
        sigma = np.sqrt(smoother.now.covariance[18, 18])
        assert sigma < 0.02
        scores.append((smoother.latency - 0.2) / sigma)
    assert np.abs(scores).max() < 3


def test_old_measurements_count_less_if_the_object_moves_in_the_palm():
    fixed, _ = turned(1, np.pi / 2)
    moving = fixed.inflated(np.array([0.02**2] * 3 + [0.1**2] * 3))
    T = fixed.measurements["T_mount_palm"][-1]
    pose = GaussianPose(se3.moved(fixed.expected(T), np.array([0.0, 0, 0.05, 0, 0, 0])), NOISE)
    step_fixed, step_moving = (
        np.linalg.norm((each.updated(pose, T).now.T_palm_object - fixed.now.T_palm_object)[:3, 3])
        for each in (fixed, moving)
    )
    assert step_moving > 1.5 * step_fixed


def test_the_random_walk_is_in_the_posterior_at_once_and_in_steps_as_at_once():
    smoother, _ = turned(1, np.pi / 2)
    variance = np.array([0.02**2] * 3 + [0.1**2] * 3)
    stepped = smoother.inflated(0.25 * variance).inflated(0.75 * variance)
    expected = smoother.now.inflated(variance)
    np.testing.assert_allclose(stepped.now.covariance, expected.covariance, atol=1e-15)
    np.testing.assert_array_equal(np.diagonal(expected.covariance - smoother.now.covariance)[6:], 0)


def test_the_mahalanobis_distance_is_zero_where_vision_should_measure_and_great_far_off():
    smoother, _ = turned(2, np.pi / 2)
    T = smoother.measurements["T_mount_palm"][-1]
    expected = smoother.expected(T)
    assert smoother.mahalanobis2(GaussianPose(expected, NOISE), T) == pytest.approx(0, abs=1e-9)
    far = se3.moved(expected, np.array([0.3, 0, 0, 0, 0, 0]))
    assert smoother.mahalanobis2(GaussianPose(far, NOISE), T) > 100


@given(SEEDS)
def test_the_object_stays_in_the_world_when_the_palm_moves(seed):
    rng = np.random.default_rng(seed)
    smoother, _ = turned(seed % 7, 0.5, measurements=4)
    T_old, T_new = se3.random(rng), se3.random(rng)
    transformed = smoother.transformed(se3.inverse(T_new) @ T_old)
    before, after = smoother.now, transformed.now
    np.testing.assert_allclose(T_new @ after.T_palm_object, T_old @ before.T_palm_object, atol=1e-12)
    covariances_world = [
        se3.rotate_covariance(T[:3, :3], state.covariance[:6, :6])
        for T, state in ((T_old, before), (T_new, after))
    ]
    np.testing.assert_allclose(*covariances_world, atol=1e-12)
    Ts = zip(smoother.measurements["T_mount_palm"], transformed.measurements["T_mount_palm"], strict=True)
    for T_before, T_after in Ts:
        expected = smoother.expected(T_before)
        np.testing.assert_allclose(transformed.expected(T_after), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_restart_tells_pose_and_bias_no_better_apart_than_measurements_without_one(seed):
    """The palm moves along a line and never turns: whatever the bias is, no measurement tells the pose from it. After a
    restart, the prior and later measurements must have one direction in which they can be exchanged."""
    rng = np.random.default_rng(seed)
    bias = se3.moved(np.eye(4), np.concatenate([0.06 * rng.normal(size=3), np.deg2rad([20.0, 5.0, 0.0])]))
    wide = np.diag(np.repeat([0.3**2, 1.0], 3))
    of_bias = np.diag(np.repeat([0.06**2, np.deg2rad(8) ** 2], 3))
    noise = np.diag(np.repeat([0.003**2, np.deg2rad(1) ** 2], 3))
    smoother = PoseBiasSmoother.from_prior(np.eye(4), wide, of_bias, np.zeros(3))
    for k in range(12):
        T_mount_palm = se3.compose(np.eye(3), np.array([0.0, 0.02 * max(k - 3, 0), 0.0]))
        seen = se3.moved(bias @ T_mount_palm, rng.normal(size=6) * np.sqrt(noise.diagonal()))
        smoother = smoother.updated(GaussianPose(seen, noise), T_mount_palm)
        if k in (2, 7):
            smoother = smoother.restarted(smoother.now.inflated(np.full(6, 1e-6)))
    sigma = np.sqrt(smoother.now.covariance[:3, :3].diagonal())
    assert (sigma > 0.9 * 0.06).all()
    off = smoother.now.T_palm_object[:3, 3]
    assert off @ np.linalg.solve(smoother.now.covariance[:3, :3], off) < 16.3  # 99.9 % of three numbers
