"""The smoother's kernels against slow and plain oracles."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight import se3
from handsight._kernels.jit import entry
from handsight._kernels.posterior import pose_bias
from handsight._kernels.records import MEASUREMENT
from oracles import pose_bias as oracle

SEEDS = st.integers(0, 2**32 - 1)
SIGMAS = np.array([0.005] * 3 + [0.05] * 3)
DRIFT = np.array([0.01**2, 0.05**2, 2.0])
SAME = np.array([0.01, 0.03, 0.5])


@entry
def rows_of(Ts, latency, pivot, measurement, rows):
    pose_bias.linearize(Ts, latency, (pivot[0], pivot[1], pivot[2]), measurement[0], rows)


def some(rng, count, spread=0.02):
    """A state with its covariance, a pivot, and measurements of it from palms all around, that move."""
    Ts = np.stack([se3.random(rng, spread=0.1), se3.moved(np.eye(4), rng.normal(size=6) * 0.1)])
    root, pivot = 0.02 * rng.normal(size=(19, 19)), rng.normal(scale=0.3, size=3)
    rest = rng.normal(size=7) * np.repeat([0.01, 0.05, 0.05], [3, 3, 1])
    measurements = np.zeros(count, dtype=MEASUREMENT)
    for one in measurements:
        one["T_mount_palm"], one["twist"] = se3.random(rng, spread=0.3), rng.normal(size=6) * 0.3
        one["latency"], one["drift_gain"] = rng.normal() * 0.03, rng.uniform(0.5, 1)
        at = oracle.expected(Ts, pivot, oracle.palm(one, rest[6]))
        L = SIGMAS[:, None] * (np.eye(6) + 0.3 * rng.normal(size=(6, 6)))
        one["T_mount_object"], one["covariance"] = se3.moved(at, spread * rng.normal(size=6)), L @ L.T
    measurements["process_noise"] = np.cumsum(rng.uniform(1e-6, 1e-4, size=(count, 6)), axis=0)
    measurements["time"] = measurements["began"] = np.cumsum(rng.uniform(0.1, 1, size=count))
    return Ts, rest, root @ root.T + 1e-6 * np.eye(19), pivot, measurements


@given(SEEDS)
def test_the_rows_are_the_derivative_of_what_vision_should_measure_and_how_far_it_is_off(seed):
    Ts, rest, _, pivot, measurements = some(np.random.default_rng(seed), 1)
    one, rows, at = measurements[0], np.empty((6, 20)), np.empty((4, 4))
    rows_of(Ts, rest[6], pivot, measurements, rows)
    pose_bias.expect(Ts, pivot, one["T_mount_palm"].copy(), at)
    np.testing.assert_allclose(at, oracle.expected(Ts, pivot, one["T_mount_palm"]), atol=1e-12)
    H, off = oracle.rows(Ts, rest[6], pivot, one)
    np.testing.assert_allclose(rows[:, :19], H, atol=1e-8)
    np.testing.assert_allclose(rows[:, 19], off, atol=1e-12)


@settings(max_examples=10)
@given(SEEDS, st.integers(1, 4))
def test_the_posterior_is_that_of_a_dense_gaussian_with_an_exponential_covariance(seed, count):
    rng = np.random.default_rng(seed)
    Ts_true, rest, prior, pivot, measurements = some(rng, count, spread=0.003)
    prior[18] *= 0.1  # a latency of tens of milliseconds
    prior[:, 18] *= 0.1
    off = np.linalg.cholesky(prior) @ rng.normal(size=19) / 10
    Ts_prior, rest_prior = oracle.moved(Ts_true, off[:12]), rest + off[12:]
    Ts, found, covariance = Ts_prior.copy(), rest_prior.copy(), np.empty((19, 19))
    given_ = Ts_prior, rest_prior, prior, pivot, DRIFT, measurements
    for _ in range(10):  # each goes on from the last answer
        assert pose_bias.smooth(*given_, Ts, found, covariance)
    expected, others, spread = oracle.posterior(*given_, Ts_prior)
    sigmas = np.sqrt(spread.diagonal())
    off = np.concatenate([se3.difference(Ts, expected).reshape(12), found - others]) / sigmas
    np.testing.assert_allclose(off, 0, atol=1e-4)
    scale = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(covariance / scale, spread / scale, atol=1e-5)


def test_measurements_from_palms_apart_or_long_ago_stay_until_they_are_too_many():
    Ts, rest, _, pivot, measurements = some(np.random.default_rng(0), 4)
    given_ = SAME, Ts, rest[6], pivot, DRIFT
    before = measurements.copy()
    assert pose_bias.merge(measurements, 4, *given_) == 4
    measurements["T_mount_palm"][3], measurements["time"][3] = measurements["T_mount_palm"][2], 20.0
    assert pose_bias.merge(measurements, 4, *given_) == 4
    np.testing.assert_array_equal(measurements[:3], before[:3])
    assert pose_bias.merge(measurements, 3, *given_) == 3
