"""A Gaussian pose changes its frame, its point and its covariance as the perturbation it is defined by does."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.gaussian_pose import GaussianPose, kalman_update

SEEDS = st.integers(0, 2**32 - 1)


def some_covariance(rng, n=6, size=0.05):
    root = size * rng.normal(size=(n, n))
    return root @ root.T + 1e-6 * np.eye(n)


@given(SEEDS, st.integers(1, 6), st.integers(1, 12))
def test_a_measurement_adds_its_information(seed, m, n):
    """Kalman's update against the information form: P⁻¹ + Hᵀ R⁻¹ H, and its mean (P⁻¹ + Hᵀ R⁻¹ H)⁻¹ Hᵀ R⁻¹ r."""
    rng = np.random.default_rng(seed)
    P, R = some_covariance(rng, n), np.diag(rng.uniform(0.01, 1, m))
    H, residual = rng.normal(size=(m, n)), rng.normal(size=m)
    step, covariance = kalman_update(P, H, residual, R)
    expected = np.linalg.inv(np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H)
    np.testing.assert_allclose(covariance, expected, atol=1e-9)
    np.testing.assert_allclose(step, expected @ H.T @ np.linalg.solve(R, residual), atol=1e-7)


@given(SEEDS)
def test_what_is_known_exactly_stays_so_and_the_covariance_semidefinite(seed):
    rng = np.random.default_rng(seed)
    P = np.diag([1e6, 1.0, 0.0])
    step, covariance = kalman_update(P, rng.normal(size=(2, 3)), rng.normal(size=2), 1e-12 * np.eye(2))
    assert step[2] == 0
    assert not covariance[2].any()
    assert np.linalg.eigvalsh(covariance)[0] >= 0


@given(SEEDS)
def test_the_covariance_at_a_point_is_that_of_the_perturbed_pose(seed):
    """By central differences, in another frame as well."""
    rng = np.random.default_rng(seed)
    pose = GaussianPose(se3.random(rng), some_covariance(rng))
    point, T_c_a, h = rng.normal(size=3), se3.random(rng), 1e-6
    there = pose.at_point(point).transformed(T_c_a)
    T_b_point = se3.compose(np.eye(3), point)

    def seen(step):
        return se3.difference(T_c_a @ se3.moved(pose.T_a_b, step) @ T_b_point, there.T_a_b)

    np.testing.assert_allclose(seen(np.zeros(6)), 0, atol=1e-12)
    J = np.column_stack([(seen(h * e) - seen(-h * e)) / (2 * h) for e in np.eye(6)])
    np.testing.assert_allclose(there.covariance, J @ pose.covariance @ J.T, atol=1e-7)


@given(SEEDS)
def test_process_noise_is_added_to_the_covariance(seed):
    rng = np.random.default_rng(seed)
    one = GaussianPose(se3.random(rng), some_covariance(rng))
    np.testing.assert_array_equal(
        one.inflated(np.arange(6.0)).covariance, one.covariance + np.diag(np.arange(6.0))
    )
