"""The smoother's kernels against slow and plain oracles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight import se3
from handsight._kernels.posterior import pose_bias
from handsight._kernels.records import MEASUREMENT
from kept_kernels import kept
from oracles import pose_bias as oracle

SEEDS = st.integers(0, 2**32 - 1)
SIGMAS = np.array([0.005] * 3 + [0.05] * 3)
SAME = np.array([0.01, 0.03])


@kept
def rows_of(Ts, pivot, measurement, rows):
    pose_bias.linearize(Ts, (pivot[0], pivot[1], pivot[2]), measurement[0], rows)


def some(rng, count, spread=0.02):
    """A state with its covariance, a pivot, and measurements of it from palms all around."""
    Ts = np.stack([se3.random(rng, spread=0.1), se3.moved(np.eye(4), rng.normal(size=6) * 0.1)])
    root, pivot = 0.02 * rng.normal(size=(12, 12)), rng.normal(scale=0.3, size=3)
    measurements = np.zeros(count, dtype=MEASUREMENT)
    for one in measurements:
        T = se3.random(rng, spread=0.3)
        measured = se3.moved(oracle.expected(Ts, pivot, T), spread * rng.normal(size=6))
        L = SIGMAS[:, None] * (np.eye(6) + 0.3 * rng.normal(size=(6, 6)))
        one["T_mount_palm"], one["T_mount_object"], one["covariance"] = T, measured, L @ L.T
    measurements["process_noise"] = np.cumsum(rng.uniform(1e-6, 1e-4, size=(count, 6)), axis=0)
    return Ts, root @ root.T + 1e-6 * np.eye(12), pivot, measurements


@given(SEEDS)
def test_the_rows_are_the_derivative_of_what_vision_should_measure_and_how_far_it_is_off(seed):
    rng = np.random.default_rng(seed)
    Ts, _, pivot, measurements = some(rng, 1)
    rows, at, T = np.empty((6, 13)), np.empty((4, 4)), measurements["T_mount_palm"][0]
    rows_of(Ts, pivot, measurements, rows)
    pose_bias.expect(Ts, pivot, T, at)
    np.testing.assert_allclose(at, oracle.expected(Ts, pivot, T), atol=1e-12)
    np.testing.assert_allclose(rows[:, :12], oracle.jacobian(Ts, pivot, T), atol=1e-8)
    off = se3.difference(measurements["T_mount_object"][0], at)
    np.testing.assert_allclose(rows[:, 12], off, atol=1e-12)


@given(SEEDS)
def test_the_mahalanobis_distance_is_that_of_the_prediction(seed):
    Ts, covariance, pivot, measurements = some(np.random.default_rng(seed), 1)
    one = measurements[0]
    given_ = one["T_mount_palm"], one["T_mount_object"], one["covariance"]
    expected = oracle.mahalanobis2(Ts, covariance, pivot, *given_)
    assert pose_bias.distance2(Ts, covariance, pivot, measurements) == pytest.approx(expected, rel=1e-6)


@settings(max_examples=10)
@given(SEEDS, st.integers(1, 4))
def test_the_posterior_is_that_of_pose_bias_and_every_step_between_measurements(seed, count):
    rng = np.random.default_rng(seed)
    Ts_true, prior, pivot, measurements = some(rng, count, spread=0.003)
    Ts_prior = oracle.moved(Ts_true, np.linalg.cholesky(prior) @ rng.normal(size=12) / 10)
    Ts, covariance = Ts_prior.copy(), np.empty((12, 12))
    for _ in range(10):  # each goes on from the last answer
        assert pose_bias.smooth(Ts_prior, prior, pivot, measurements, Ts, covariance)
    expected, spread = oracle.posterior(Ts_prior, prior, pivot, measurements, Ts_prior)
    deviations = np.sqrt(spread.diagonal())
    off = se3.difference(Ts, expected).reshape(12) / deviations
    np.testing.assert_allclose(off, 0, atol=1e-4)
    np.testing.assert_allclose(
        covariance / np.outer(deviations, deviations), spread / np.outer(deviations, deviations), atol=1e-5
    )


@given(SEEDS)
def test_measurements_from_nearly_one_palm_become_one_that_says_what_both_did(seed):
    """Innovations weighted by their information, in the older's palm, of when the newer came."""
    rng = np.random.default_rng(seed)
    Ts, _, pivot, measurements = some(rng, 4)
    near = se3.moved(measurements["T_mount_palm"][1], np.array([0.004, 0, 0.003, 0, 0.01, 0]))
    measurements["T_mount_palm"][3] = near
    measurements["T_mount_object"][3] = se3.moved(oracle.expected(Ts, pivot, near), 0.02 * rng.normal(size=6))
    old, new, rows = measurements[1].copy(), measurements[3].copy(), measurements.copy()
    assert pose_bias.merge(rows, 48, SAME, Ts, pivot) == 3
    assert rows[0] == measurements[0]
    assert rows[1] == measurements[2]
    R, grown = old["T_mount_palm"][:3, :3], new["process_noise"] - old["process_noise"]
    A = np.linalg.inv(old["covariance"] + se3.rotate_covariance(R, np.diag(grown)))
    B = np.linalg.inv(new["covariance"])
    at = [oracle.expected(Ts, pivot, one["T_mount_palm"]) for one in (old, new)]
    a, b = (se3.difference(one["T_mount_object"], T) for one, T in zip((old, new), at, strict=True))
    mean = np.linalg.solve(A + B, A @ a + B @ b)
    np.testing.assert_allclose(rows[2]["covariance"], np.linalg.inv(A + B), atol=1e-9)
    np.testing.assert_allclose(rows[2]["T_mount_object"], se3.moved(at[0], mean), atol=1e-9)
    np.testing.assert_array_equal(rows[2]["T_mount_palm"], old["T_mount_palm"])
    np.testing.assert_array_equal(rows[2]["process_noise"], new["process_noise"])


def test_measurements_from_palms_apart_stay_until_they_are_too_many():
    Ts, _, pivot, measurements = some(np.random.default_rng(0), 4)
    before = measurements.copy()
    assert pose_bias.merge(measurements, 4, SAME, Ts, pivot) == 4
    assert (measurements == before).all()
    assert pose_bias.merge(measurements, 3, SAME, Ts, pivot) == 3


def test_a_noise_that_is_no_covariance_is_reported():
    Ts, covariance, pivot, measurements = some(np.random.default_rng(0), 1)
    measurements["covariance"] = -np.eye(6)
    assert pose_bias.distance2(Ts, covariance, pivot, measurements) == np.inf
    assert not pose_bias.smooth(Ts, covariance, pivot, measurements, Ts.copy(), np.empty((12, 12)))
